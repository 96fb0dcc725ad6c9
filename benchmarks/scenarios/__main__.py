"""`python -m benchmarks.scenarios.run`: see run.py."""

from benchmarks.scenarios.run import main

main()
