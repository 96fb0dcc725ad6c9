"""Slots of an integrator's values in the flat workspace."""

from typing import NamedTuple


class Slots(NamedTuple):
    """First slot of each group of `n` values that a method works on."""

    n: int  # number of coordinates, times `lanes`
    q: int  # coordinates
    v: int  # rates of the coordinates
    a: int  # accelerations, written by `evaluate`
    implicit: int  # 3 n values: weights of stiffness, weights of damping, guess
    s: int  # scratch space, `Integrator.scratch` values per lane
    tau: int = 0  # torques
    lanes: int = 1  # environments in one workspace; 1 unless numba compiles the method's loops
