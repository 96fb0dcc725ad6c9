"""`python -m benchmarks.validation`: see run.py."""

import sys

from benchmarks.validation.run import main

if __name__ == "__main__":
    sys.exit(main())
