"""Compiled conversions of a free base's state between the caller's coordinates and the workspace.

Callers hold a position and a rotation vector in the world; steps use the frame of
formulations/free_base.py. Conversions run once per call, lane by lane on the flat workspace.
"""

from numba.extending import register_jitable

from dynamics.description.rotations import from_rotation_vector, rotation_matrix, to_rotation_vector
from dynamics.runtime.jit import compiled

quaternion = register_jitable(from_rotation_vector)
matrix = register_jitable(rotation_matrix)
rotation_vector = register_jitable(to_rotation_vector)


@compiled
def enter(w, lanes, q, v, attitude):  # type: ignore[no-untyped-def]
    """Convert position and rotation vector to the frame aligned with the present attitude."""
    three, number = 3 * lanes, w.dtype.type
    for b in range(lanes):
        at = q + three + b
        unit = quaternion((w[at], w[at + lanes], w[at + lanes + lanes]))
        for i in range(4):
            w[attitude + i * lanes + b] = number(unit[i])
        for i in range(3):
            w[at + i * lanes] = number(0.0)
    turn(w, lanes, q, attitude, -1.0)
    turn(w, lanes, v, attitude, -1.0)


@compiled
def leave(w, lanes, q, v, attitude):  # type: ignore[no-untyped-def]
    """Inverse of `enter`."""
    turn(w, lanes, q, attitude, 1.0)
    turn(w, lanes, v, attitude, 1.0)
    for b in range(lanes):
        at = attitude + b
        vector = rotation_vector(
            (w[at], w[at + lanes], w[at + lanes + lanes], w[at + lanes + lanes + lanes])
        )
        for i in range(3):
            w[q + (3 + i) * lanes + b] = w.dtype.type(vector[i])


@compiled
def turn(w, lanes, x, attitude, sense):  # type: ignore[no-untyped-def]
    """Rotate a vector from the base's frame to the world; with `sense` -1 from world to base."""
    two = lanes + lanes
    for b in range(lanes):
        at = attitude + b
        x1, x2, x3 = w[at + lanes], w[at + two], w[at + two + lanes]
        R = matrix((w[at], sense * x1, sense * x2, sense * x3))
        first, second, third = w[x + b], w[x + lanes + b], w[x + two + b]
        for i in range(3):
            turned = R[i][0] * first + R[i][1] * second + R[i][2] * third
            w[x + i * lanes + b] = w.dtype.type(turned)
