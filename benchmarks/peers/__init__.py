"""Flexible scenes in other engines and in flexarm: error against processor time."""
