"""Train a policy on a flexible arm: `python train.py --help`."""

import sys

from agents.training import main

if __name__ == "__main__":
    sys.exit(main())
