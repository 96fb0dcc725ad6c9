"""Links and payload beyond a tip, and how much of them turns with it when its link bends.

A payload and links on fixed joints turn with a tip. A joint about the axis of the bending couples
its hub and those behind it to the tip in series with its rotor alone; a joint about any other axis,
or along one, does as a weld. The arm is taken at zero joint angles, and only the first joint beyond
the tip as free.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dynamics.description.joint import Joint
from dynamics.description.link import Body, Link, Payload, about_origin
from dynamics.description.mode_rule import TipLoad
from dynamics.types import Array

BENDING_AXIS = {"y": 2, "z": 1}  # direction of bending -> axis about which the tip turns


class Carried(NamedTuple):
    """Bodies beyond a tip, in its end frame. Masses are int (1, x, y, z, r^2) dm about the tip."""

    whole: Array  # (5,) [kg, kg m, kg m^2]
    welded: Array  # (5,) of those that no moving joint separates from the tip
    joint: Joint | None  # the first that moves
    axis: Array  # (3,) [-] of that joint

    def before(self, link: Link) -> "Carried":
        """Links that the one before carries: `link`, and these at its tip."""
        own, reach, joint = _masses(link), np.array([link.length, 0.0, 0.0]), link.joint
        root, turn, offset = (np.array(x) for x in (joint.root, joint.rotation, joint.offset))
        whole, welded = (
            _moved(_turned(_moved(own + _moved(masses, reach), root), turn), offset)
            for masses in (self.whole, self.welded)
        )
        if not joint.moves:
            return Carried(whole, welded, self.joint, turn @ self.axis)
        return Carried(whole, np.zeros(5), joint, turn @ [0.0, 0.0, 1.0])

    def turned_inertia(self) -> dict[str, float]:
        """[kg m^2] that turns with the tip, by the direction along which its link bends."""
        welded, behind = self.welded[4], self.whole[4] - self.welded[4]
        if self.joint is None or self.joint.parallel:
            return dict.fromkeys(BENDING_AXIS, welded)
        rotor, driven = self.joint.rotor_inertia, behind + self.joint.hub_inertia
        series = rotor * driven / (rotor + driven) if rotor else 0.0
        about = self.axis**2 if self.joint.type != "prismatic" else np.zeros(3)
        return {
            direction: welded + (1.0 - about[axis]) * behind + about[axis] * series
            for direction, axis in BENDING_AXIS.items()
        }


def carried(links: Sequence[Link], payload: Payload | None = None) -> list[Carried]:
    """Links that each link carries beyond its tip, and the payload of the last."""
    last = np.zeros(5) if payload is None else _of_body(payload)
    result = [Carried(last, last, None, np.zeros(3))]
    for link in reversed(links[1:]):
        result.append(result[-1].before(link))
    return result[::-1][: len(links)]


def tip_loads(links: Sequence[Link], payload: Payload | None) -> list[TipLoad]:
    """Load of each link's tip, which chooses its modes by rule."""
    last = len(links) - 1
    about_x = 0.0 if payload is None else float(about_origin(payload)[0][0])
    return [
        TipLoad(beyond.welded[0], beyond.turned_inertia(), about_x * (i == last), i < last)
        for i, beyond in enumerate(carried(links, payload))
    ]


def _masses(link: Link) -> Array:
    """(5,) int (1, x, y, z, r^2) dm of a link about its root, in its frame."""
    line, tip = link.beam.line_mass, link.tip_mass
    first, second = line.first + tip * link.length, line.second + tip * link.length**2
    total = np.array([line.mass + tip, first, 0.0, 0.0, second + _polar(link.tip_inertia)])
    return total if link.body is None else total + _of_body(link.body)


def _of_body(body: Body | Payload) -> Array:
    """(5,) int (1, x, y, z, r^2) dm of a body about the origin of its frame."""
    masses = np.array([body.mass, 0.0, 0.0, 0.0, _polar(body.inertia)])
    return _moved(masses, np.array(body.com))


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
