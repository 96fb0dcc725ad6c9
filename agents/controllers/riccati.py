"""Discrete Riccati equation of gains and filters."""

import numpy as np
from scipy.linalg import solve_discrete_are

from dynamics.types import Array


def riccati(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Solution of the discrete Riccati equation; a LinAlgError where the weights allow none."""
    try:
        return np.asarray(solve_discrete_are(A, B, Q, R), dtype=np.float64)
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from None
