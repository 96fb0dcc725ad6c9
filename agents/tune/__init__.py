"""Searches of parameters and keywords on tuning episodes, `python -m agents.tune`."""
