"""Attitudes: unit quaternions [w, x, y, z], rotation vectors, 3-2-1 Euler angles.

`rotation_matrix` and `product` accept floats and symbols. They, `from_rotation_vector` and
`to_rotation_vector` use plain arithmetic that numba compiles. A rotation vector is the rotation
axis times the angle; every attitude has one no longer than pi.
"""

import math
from typing import Any

Numbers = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_TINY = 1e-4  # [rad] limit below which a two-term series is exact to round-off


def rotation_matrix(quaternion: Any) -> Any:
    """(3, 3) rotation matrix of a unit quaternion, from the rotated to the reference frame."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def product(p: Any, q: Any) -> Any:
    """Quaternion product p q: the rotation p followed by q about the rotated axes."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] + p[2] * q[0] + p[3] * q[1] - p[1] * q[3],
        p[0] * q[3] + p[3] * q[0] + p[1] * q[2] - p[2] * q[1],
    )


def from_rotation_vector(vector: Any) -> Quaternion:
    """Unit quaternion of a rotation vector [rad] of any length."""
    x, y, z = vector[0], vector[1], vector[2]
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    scale = 0.5 - half * half / 12.0 if half < _TINY else 0.5 * math.sin(half) / half
    return math.cos(half), scale * x, scale * y, scale * z


def to_rotation_vector(quaternion: Any) -> Numbers:
    """Shortest rotation vector [rad] of a unit quaternion."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)  # of half the angle
    scale = 2.0 + sine * sine / 3.0 if sine < _TINY else 2.0 * math.atan2(sine, w) / sine
    return scale * x, scale * y, scale * z


def from_euler(angles: Any) -> Quaternion:
    """Quaternion of 3-2-1 Euler angles (theta, phi, psi) [rad] about axes 3, 2 and 1 in turn."""
    theta, phi, psi = angles
    turns = ((0.0, 0.0, theta), (0.0, phi, 0.0), (psi, 0.0, 0.0))
    first, second, third = (from_rotation_vector(turn) for turn in turns)
    result: Quaternion = product(product(first, second), third)
    return result


def to_euler(quaternion: Any) -> Numbers:
    """3-2-1 Euler angles (theta, phi, psi) [rad] of a unit quaternion, |phi| <= pi/2.

    At |phi| = pi/2 theta and psi rotate about the same axis, and psi is set to zero.
    """
    R = rotation_matrix(quaternion)
    level = math.hypot(R[0][0], R[1][0])  # cosine of phi
    phi = math.atan2(-R[2][0], level)
    if level < 1e-12:
        return math.atan2(-R[0][1], R[1][1]), phi, 0.0
    return math.atan2(R[1][0], R[0][0]), phi, math.atan2(R[2][1], R[2][2])
