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
from dynamics.description.link import Link, Payload, about_origin
from dynamics.description.mode_rule import TipLoad
from dynamics.description.mode_shapes import BENDING_AXIS
from dynamics.types import Array, Matrix3, Vector3


class Carried(NamedTuple):
    """Bodies beyond a tip, in its end frame.

    Masses are int p p^T dm with p = (x, y, z, 1) from the tip: a place T moves them to T m T^T.
    """

    whole: Array  # (4, 4) [kg m^2, kg m, kg]
    welded: Array  # (4, 4) of those that no moving joint separates from the tip
    joint: Joint | None  # the first that moves
    axis: Array  # (3,) [-] of that joint

    def before(self, link: Link) -> "Carried":
        """Links that the one before carries: `link`, and these at its tip."""
        own, tip, joint = _masses(link), _place((link.length, 0.0, 0.0)), link.joint
        root = _place(joint.offset, joint.rotation) @ _place(joint.root)
        whole, welded = (
            root @ (own + tip @ masses @ tip.T) @ root.T for masses in (self.whole, self.welded)
        )
        turn = root[:3, :3]
        if not joint.moves:
            return Carried(whole, welded, self.joint, turn @ self.axis)
        return Carried(whole, np.zeros((4, 4)), joint, turn @ [0.0, 0.0, 1.0])

    def turned_inertia(self) -> dict[str, float]:
        """[kg m^2] that turns with the tip, by the direction along which its link bends."""
        return {direction: self._turned(axis) for direction, axis in BENDING_AXIS.items()}

    def welded_inertia(self) -> dict[str, float]:
        """[kg m^2] welded to the tip about the axis that a mode along a direction turns it about.

        Along "axial", which moves the tip, their mass [kg].
        """
        axes = BENDING_AXIS | {"x": 0}
        turned = {direction: _about(self.welded, axis) for direction, axis in axes.items()}
        return turned | {"axial": float(self.welded[3, 3])}

    def _turned(self, axis: int) -> float:
        whole, welded = (_about(masses, axis) for masses in self[:2])
        if self.joint is None or self.joint.parallel:
            return welded
        behind, rotor = whole - welded, self.joint.rotor_inertia
        driven = behind + self.joint.hub_inertia
        series = rotor * driven / (rotor + driven) if rotor else 0.0
        about = 0.0 if self.joint.type == "prismatic" else float(self.axis[axis]) ** 2
        return welded + (1.0 - about) * behind + about * series


def _about(masses: Array, axis: int) -> float:
    """[kg m^2] inertia of masses (4, 4) about an axis of their frame."""
    return float(np.trace(masses[:3, :3]) - masses[axis, axis])


def carried(links: Sequence[Link], payload: Payload | None = None) -> list[Carried]:
    """Links that each link carries beyond its tip, and the payload of the last."""
    last = np.zeros((4, 4))
    if payload is not None:
        last = _of_body(payload.mass, payload.com, payload.inertia)
    result = [Carried(last, last, None, np.zeros(3))]
    for link in reversed(links[1:]):
        result.append(result[-1].before(link))
    return result[::-1][: len(links)]


def tip_loads(links: Sequence[Link], payload: Payload | None) -> list[TipLoad]:
    """Load of each link's tip, which chooses its modes by rule."""
    last = len(links) - 1
    about_x = 0.0 if payload is None else float(about_origin(payload)[0][0])
    return [
        TipLoad(beyond.welded[3, 3], beyond.turned_inertia(), about_x * (i == last), i < last)
        for i, beyond in enumerate(carried(links, payload))
    ]


def _masses(link: Link) -> Array:
    """(4, 4) masses of a link about its root, in its frame."""
    line = link.beam.line_mass
    result = _of_body(link.tip_mass, (link.length, 0.0, 0.0), link.tip_inertia)
    polar = link.mean("rho_Ip") * link.length  # [kg m^2]
    result[range(3), range(3)] += 0.5 * polar * np.array((-1.0, 1.0, 1.0))  # about x alone
    result[np.ix_([0, 3], [0, 3])] += [[line.second, line.first], [line.first, line.mass]]
    if link.body is not None:
        result += _of_body(link.body.mass, link.body.com, link.body.inertia)
    return result


def _of_body(mass: float, com: Vector3, inertia: Matrix3) -> Array:
    """(4, 4) masses of a body about the origin of its frame."""
    result, place = np.zeros((4, 4)), _place(com)
    result[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - np.array(inertia)
    result[3, 3] = mass
    return place @ result @ place.T


def _place(offset: Vector3, rotation: Matrix3 | None = None) -> Array:
    """(4, 4) homogeneous transform of a frame at `offset` [m]."""
    result = np.eye(4)
    result[:3, 3] = offset
    if rotation is not None:
        result[:3, :3] = rotation
    return result
