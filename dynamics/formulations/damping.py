"""Damping that a link keeps whatever modes and segments describe it.

A damping ratio belongs to the modes that are described, not to the beam: other shapes would be
damped otherwise, and segments, whose own modes are fast, hardly at all. Kelvin-Voigt damping,
C = beta K, belongs to the material.
"""

import math
from dataclasses import replace

import numpy as np

from dynamics.description.arm import Arm, Payload
from dynamics.description.link import Link
from dynamics.description.mode_shapes import STIFFNESS, Mode
from dynamics.formulations.link_constants import link_constants

_FIRST = range(1, 6)  # polynomials that give a beam's first frequency to 1e-7


def viscous_links(arm: Arm) -> tuple[Link, ...]:
    """The arm's links, each as `viscous` has it."""
    return tuple(map(viscous, arm.links, arm.carried))


def viscous(link: Link, payload: Payload | None = None) -> Link:
    """The link with `damping_beta` in place of a damping ratio, which its first mode keeps.

    That is the lowest bending mode of the link alone, clamped, with its tip mass and payload.
    """
    directions = [d for d in "yz" if yields(link, d)]
    if not (link.damping_ratio and directions):
        return link
    from scipy.linalg import eigh

    shapes = tuple(Mode(kind="poly", index=k, direction=d) for d in directions for k in _FIRST)
    alone = link_constants(replace(link, modes=shapes, segments=1), payload)
    tip = np.array(alone.tip_phi)
    mass = np.array(alone.s) + alone.tip_mass * tip @ tip.T
    first = math.sqrt(eigh(np.array(alone.K), mass, eigvals_only=True)[0])
    return replace(link, damping_ratio=0.0, damping_beta=2.0 * link.damping_ratio / first)


def yields(link: Link, direction: str) -> bool:
    """Whether a link bends or twists in a direction, whatever its modes."""
    return link.body is None and bool(getattr(link, STIFFNESS[direction]))
