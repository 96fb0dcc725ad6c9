"""`python -m benchmarks.work_precision.run`: see run.py."""

from benchmarks.work_precision.run import main

main()
