"""`python -m benchmarks.work_precision`: see run.py."""

from benchmarks.work_precision.run import main

if __name__ == "__main__":
    main()
