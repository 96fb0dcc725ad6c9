"""Inertia of bodies whose principal axes are those of their frame, as presets state it."""

from dynamics.types import Matrix3


def about_axes(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Matrix3:
    """(3, 3) [kg m^2] inertia from its principal moments."""
    return ((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z))
