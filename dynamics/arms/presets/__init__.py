"""Preset arms, one file each, with ARM, sources and CHECKS."""
