"""Measured data of a rig beside a simulation: logs from files, and parameters fitted to them."""
