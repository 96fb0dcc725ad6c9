"""Flexible scenes in other engines and in ours: error against processor time."""
