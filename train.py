"""Train a policy on a flexible arm: `python train.py --help`."""

import sys

from agents.training import main
from dynamics.command import completed

if __name__ == "__main__":
    sys.exit(completed("train.py", main))
