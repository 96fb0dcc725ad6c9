"""`python -m benchmarks.peers.run`: see run.py."""

from benchmarks.peers.run import main

main()
