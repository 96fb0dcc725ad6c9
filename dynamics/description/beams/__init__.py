"""Shapes of beams: uniform ones, and those of sections."""
