"""Errors of methods and models, and agreement between independent computations."""
