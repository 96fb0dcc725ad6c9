"""Targets that traced functions are compiled for, one package each."""
