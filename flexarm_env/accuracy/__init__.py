"""Measured errors of the environments, and models chosen by their error."""
