"""The motion of one arm over time."""

from dataclasses import dataclass

from dynamics.types import Array


@dataclass(frozen=True)
class Trajectory:
    """A motion as `simulate` returns it, one row per time."""

    t: Array  # (N,) [s]
    q: Array  # (N, n) [rad, m]
    v: Array  # (N, n) [rad/s, m/s]
    tip: Array  # (N, 3) [m]
    base_position: Array | None = None  # (N, 3) [m] in the world; None for a fixed base
    base_quaternion: Array | None = None  # (N, 4) w, x, y, z, without jumps of sign
    integrator: str = ""  # the one used, also after "auto"
