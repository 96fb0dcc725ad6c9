"""`python -m benchmarks.validation.run`: see run.py."""

from benchmarks.validation.run import main

main()
