"""`python -m agents.sweep CONFIG --trials N`: search over an experiment's agent keywords."""

import sys

from agents.sweep.command import main
from dynamics.command import completed

if __name__ == "__main__":
    sys.exit(completed("agents.sweep", main))
