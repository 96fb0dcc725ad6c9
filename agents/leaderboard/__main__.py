"""`python -m agents.leaderboard`: see run.py."""

import sys

from agents.leaderboard.run import main
from dynamics.command import completed

if __name__ == "__main__":
    sys.exit(completed("agents.leaderboard", main))
