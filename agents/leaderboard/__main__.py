"""`python -m agents.leaderboard`: see run.py."""

import sys

from agents.leaderboard.run import main

if __name__ == "__main__":
    sys.exit(main())
