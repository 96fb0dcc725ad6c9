"""Measured errors of an environment over whole episodes: `python -m flexarm_env.certify`."""
