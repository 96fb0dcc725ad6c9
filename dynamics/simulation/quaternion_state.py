"""States of a free base as methods with error control integrate them: with a quaternion.

Its rate is half the quaternion times the angular velocity, smooth at every attitude; what the
equations of motion see of it has unit length.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dynamics.description.rotations import from_rotation_vector, product, to_rotation_vector
from dynamics.types import Array


def with_quaternion(q: Array) -> Array:
    """(n + 1,) coordinates with the attitude as a quaternion in place of a rotation vector."""
    return np.concatenate([q[:3], from_rotation_vector(q[3:6].tolist()), q[6:]])


def with_rotation_vector(x: Array) -> Array:
    """(n,) inverse of `with_quaternion`, for a quaternion of any length."""
    unit = x[3:7] / np.linalg.norm(x[3:7])
    return np.concatenate([x[:3], to_rotation_vector(unit.tolist()), x[7:]])


def rates(x: Array, v: Array) -> Array:
    """(n + 1,) derivatives of such coordinates under the rates v (n,)."""
    turning = product(x[3:7].tolist(), (0.0, *v[3:6].tolist()))
    return np.concatenate([v[:3], 0.5 * np.array(turning), v[6:]])


def quaternions(q: Array, first: Sequence[float]) -> Array:
    """(N, 4) of coordinates (N, n), each with the sign nearer to the one before, or to `first`."""
    result = np.array([from_rotation_vector(row[3:6].tolist()) for row in q])
    flips = [before @ after < 0.0 for before, after in pairwise([np.array(first), *result])]
    signs = np.where(np.cumsum(flips) % 2, -1.0, 1.0)
    return signs[:, None] * result
