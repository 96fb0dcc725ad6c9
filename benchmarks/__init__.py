"""Benchmarks, charts and tables of the documentation: `python -m benchmarks.ROOM.NAME`."""
