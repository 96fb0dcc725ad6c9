"""States with the attitude of a free base as a quaternion, for solvers with error control.

The quaternion's rate is half its product with the angular velocity and is smooth at every attitude.
The equations of motion take the quaternion scaled to unit length.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dynamics.description.arm import Base
from dynamics.description.rotations import from_rotation_vector, product, to_rotation_vector
from dynamics.types import Array


def with_quaternion(q: Array) -> Array:
    """(n + 1,) coordinates with a quaternion in place of the rotation vector."""
    return np.concatenate([q[:3], from_rotation_vector(q[3:6].tolist()), q[6:]])


def with_rotation_vector(x: Array) -> Array:
    """(n,) inverse of `with_quaternion`, for a quaternion of any length."""
    unit = x[3:7] / np.linalg.norm(x[3:7])
    return np.concatenate([x[:3], to_rotation_vector(unit.tolist()), x[7:]])


def in_space(q: Array, base: Base) -> Array:
    """(N, 6 or more) coordinates that begin with position and rotation vector of the base."""
    if base.type == "planar":  # x, y, angle
        none = np.zeros((len(q), 3))
        return np.hstack([q[:, :2], none, q[:, 2:]])
    return q


def rates(x: Array, v: Array) -> Array:
    """(n + 1,) time derivatives of the coordinates x (n + 1,) under the rates v (n,)."""
    turning = product(x[3:7].tolist(), (0.0, *v[3:6].tolist()))
    return np.concatenate([v[:3], 0.5 * np.array(turning), v[6:]])


def quaternions(q: Array, first: Sequence[float]) -> Array:
    """(N, 4) attitudes of coordinates q (N, n), without jumps of sign, from that of `first` on."""
    result = np.array([from_rotation_vector(row[3:6].tolist()) for row in q])
    flips = [before @ after < 0.0 for before, after in pairwise([np.array(first), *result])]
    signs = np.where(np.cumsum(flips) % 2, -1.0, 1.0)
    return signs[:, None] * result
