"""Damping that does not depend on the modes and segments of a link.

A damping ratio applies to the modes of the description, not to the beam: other shapes are damped
differently, and segments, whose modes are fast, hardly at all. Kelvin-Voigt damping, C = beta K,
is a property of the material.
"""

import math
from dataclasses import replace

import numpy as np

from dynamics.description.arm import Arm, Payload
from dynamics.description.link import Link
from dynamics.description.mode_shapes import STIFFNESS, Mode
from dynamics.formulations.link_constants import link_constants

_POWERS = range(1, 6)  # polynomial shapes that give a beam's first frequency to 1e-7


def viscous_links(arm: Arm) -> tuple[Link, ...]:
    """Links of the arm with Kelvin-Voigt damping: `viscous` of each."""
    return tuple(map(viscous, arm.links, arm.carried))


def viscous(link: Link, payload: Payload | None = None) -> Link:
    """Replace a link's damping ratio by the `damping_beta` that gives its first mode that ratio.

    The first mode is the lowest bending mode of the link alone, clamped, with tip mass and payload.
    """
    directions = [d for d in "yz" if yields(link, d)]
    if not (link.damping_ratio and directions):
        return link
    from scipy.linalg import eigh

    shapes = tuple(Mode(kind="poly", index=k, direction=d) for d in directions for k in _POWERS)
    alone = link_constants(replace(link, modes=shapes, segments=1), payload)
    tip = np.array(alone.tip_phi)
    mass = np.array(alone.s) + alone.tip_mass * tip @ tip.T
    first = math.sqrt(eigh(np.array(alone.K), mass, eigvals_only=True)[0])
    return replace(link, damping_ratio=0.0, damping_beta=2.0 * link.damping_ratio / first)


def yields(link: Link, direction: str) -> bool:
    """True if a link has a rigidity in a direction, with or without modes in it."""
    return link.body is None and bool(getattr(link, STIFFNESS[direction]))
