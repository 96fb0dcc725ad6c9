"""A beam cut into cubic finite elements: frequencies from an algebra of its own."""

from typing import Any

import numpy as np
import scipy.linalg


def beam_frequencies(
    length: float, rho_A: float, EI: float, *, hinged: bool = False, **bodies: Any
) -> np.ndarray:
    """[rad/s] of a uniform beam, clamped or hinged at its root, tip free; rigid motion left out.

    bodies : `hub` [kg m^2] on a hinged root, `tip_mass` [kg], `tip_inertia` [kg m^2].
    """
    count = 40
    h = length / count
    n = 2 * (count + 1)  # deflection and slope at every node
    M, K = np.zeros((n, n)), np.zeros((n, n))
    inertia = np.array([
        [156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ]) * (rho_A * h / 420.0)  # fmt: skip
    bending = np.array([
        [12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
        [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2],
    ]) * (EI / h**3)  # fmt: skip
    for k in range(count):
        at = slice(2 * k, 2 * k + 4)
        M[at, at] += inertia
        K[at, at] += bending
    M[1, 1] += bodies.get("hub", 0.0)
    M[-2, -2] += bodies.get("tip_mass", 0.0)
    M[-1, -1] += bodies.get("tip_inertia", 0.0)
    first = 1 if hinged else 2
    squares = scipy.linalg.eigh(K[first:, first:], M[first:, first:], eigvals_only=True)
    return np.sqrt(np.abs(squares[1:] if hinged else squares))
