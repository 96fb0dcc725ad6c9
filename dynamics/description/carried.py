"""Links beyond a tip, and how much of them turns with it when its link bends.

Links that are welded to a tip turn with it. A joint about the axis of the bending couples those
behind it to the tip in series with its rotor alone; a joint about any other axis, or along one,
does as a weld. The arm is taken at zero joint angles, and only its first such joint as free.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.types import Array

BENDING_AXIS = {"y": 2, "z": 1}  # direction of bending -> axis about which the tip turns


class Carried(NamedTuple):
    """Links beyond a tip, in its end frame. Masses are int (1, x, y, z, r^2) dm about the tip."""

    whole: Array  # (5,) [kg, kg m, kg m^2]
    welded: Array  # (5,) of those that no joint or spring separates from the tip
    joint: Joint | None  # the first that moves or gives
    axis: Array  # (3,) [-] of that joint

    def before(self, link: Link) -> "Carried":
        """Links that the one before carries: `link`, and these at its tip."""
        own, reach, joint = _masses(link), np.array([link.length, 0.0, 0.0]), link.joint
        root, turn, offset = (np.array(x) for x in (joint.root, joint.rotation, joint.offset))
        whole, welded = (
            _moved(_turned(_moved(own + _moved(masses, reach), root), turn), offset)
            for masses in (self.whole, self.welded)
        )
        if joint.welds:
            return Carried(whole, welded, self.joint, turn @ self.axis)
        return Carried(whole, np.zeros(5), joint, turn @ [0.0, 0.0, 1.0])

    def turned_inertia(self) -> dict[str, float]:
        """[kg m^2] that turns with the tip, by the direction along which its link bends."""
        welded, behind = self.welded[4], self.whole[4] - self.welded[4]
        if self.joint is None or self.joint.parallel:
            return dict.fromkeys(BENDING_AXIS, welded)
        rotor = self.joint.rotor_inertia
        series = rotor * behind / (rotor + behind) if rotor else 0.0
        about = self.axis**2 if self.joint.type != "prismatic" else np.zeros(3)
        return {
            direction: welded + (1.0 - about[axis]) * behind + about[axis] * series
            for direction, axis in BENDING_AXIS.items()
        }


def carried(links: Sequence[Link]) -> list[Carried]:
    """Links that each link carries beyond its tip."""
    result = [Carried(np.zeros(5), np.zeros(5), None, np.zeros(3))]
    for link in reversed(links[1:]):
        result.append(result[-1].before(link))
    return result[::-1][: len(links)]


def _masses(link: Link) -> Array:
    """(5,) int (1, x, y, z, r^2) dm of a link about its root, in its frame."""
    line, tip = link.beam.line_mass, link.tip_mass
    first, second = line.first + tip * link.length, line.second + tip * link.length**2
    total = np.array([line.mass + tip, first, 0.0, 0.0, second + _polar(link.tip_inertia)])
    if link.body is not None:
        body = np.array([link.body.mass, 0.0, 0.0, 0.0, _polar(link.body.inertia)])
        total += _moved(body, np.array(link.body.com))
    return total


def _polar(inertia: Sequence[Sequence[float]]) -> float:
    """Int r^2 dm [kg m^2] about the point to which an inertia belongs."""
    return 0.5 * float(np.trace(inertia))


def _moved(masses: Array, place: Array) -> Array:
    """The masses about a point from which the present one is at `place`."""
    mass, first, second = masses[0], masses[1:4], masses[4]
    moved = second + 2.0 * (place @ first) + mass * (place @ place)
    return np.array([mass, *(first + mass * place), moved])


def _turned(masses: Array, rotation: Array) -> Array:
    return np.array([masses[0], *(rotation @ masses[1:4]), masses[4]])
