"""Places of an integrator's values in the workspace."""

from typing import NamedTuple


class Slots(NamedTuple):
    """First slots of the values that a method works on, `n` of each unless said otherwise."""

    n: int  # number of coordinates, times lanes where a method is compiled as it stands
    q: int  # coordinates
    v: int  # rates
    a: int  # accelerations, written by `evaluate`
    implicit: int  # weight of stiffness, weight of damping, then the guess: 2 + n values
    s: int  # scratch space of the method
    lanes: int = 1
