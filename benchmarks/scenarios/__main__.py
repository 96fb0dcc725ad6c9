"""`python -m benchmarks.scenarios`: see run.py."""

import sys

from benchmarks.scenarios.run import main

if __name__ == "__main__":
    sys.exit(main())
