"""Compiled parts of an environment: episodes, control steps, signals and actuation."""
