"""Damping that does not depend on the modes and segments of a link.

A damping ratio is that of the link alone, clamped at its joint, with its tip body: of its first
bending mode, and of its first torsion mode. As modal damping it holds for each mode of the
description. Other shapes and segments get it from the material: Kelvin-Voigt damping, C = beta K,
with one beta for bending and stretching and one for torsion.
"""

import math
from dataclasses import replace

from dynamics.description.arm import Arm
from dynamics.description.beam_shapes import clamped_root
from dynamics.description.link import Link
from dynamics.description.mode_shapes import STIFFNESS

_AXIS = {"y": 2, "z": 1}  # about which bending along y or z turns the tip


def viscous_links(arm: Arm) -> tuple[Link, ...]:
    """Links of the arm with Kelvin-Voigt damping: `viscous` of each."""
    return tuple(map(viscous, arm.links))


def viscous(link: Link) -> Link:
    """Replace a link's damping ratio by the viscosities that give its first modes that ratio.

    `damping_beta` belongs to the lowest bending mode, or without bending to the lowest axial one;
    `damping_beta_torsion` to the lowest torsion mode.
    """
    bending = [_bending(link, d) for d in "yz" if yields(link, d)]
    if not bending and yields(link, "axial"):
        bending = [_shaft(link.length, link.EA, link.rho_A, link.tip_mass)]
    inertia = link.tip_inertia[0][0]
    twists = yields(link, "x") and link.rho_Ip + inertia > 0.0
    torsion = [_shaft(link.length, link.GJ, link.rho_Ip, inertia)] if twists else []
    if not (link.damping_ratio and (bending or torsion)):
        return link
    lowest, twisting = (
        2.0 * link.damping_ratio / min(x, default=math.inf) for x in (bending, torsion)
    )
    return replace(
        link,
        damping_ratio=0.0,
        damping_beta=lowest,
        damping_beta_torsion=twisting if torsion else None,
    )


def yields(link: Link, direction: str) -> bool:
    """True if a link has a rigidity in a direction, with or without modes in it."""
    return link.body is None and bool(getattr(link, STIFFNESS[direction]))


def _bending(link: Link, direction: str) -> float:
    """[rad/s] first frequency of a cantilever with the link's tip body."""
    rigidity, axis, beam = (
        getattr(link, STIFFNESS[direction]),
        _AXIS[direction],
        link.rho_A * link.length,
    )
    inertia = link.tip_inertia[axis][axis] / (beam * link.length**2)
    root = clamped_root(1, link.tip_mass / beam, inertia)
    return (root / link.length) ** 2 * math.sqrt(rigidity / link.rho_A)


def _shaft(length: float, rigidity: float | None, per_length: float, tip: float) -> float:
    """[rad/s] first frequency of a shaft held at its root: b tan b = its inertia over the tip's.

    Of torsion with moments of inertia [kg m], [kg m^2], of stretching with masses [kg/m], [kg].
    """
    assert rigidity is not None
    own = per_length * length
    if own == 0.0:
        return math.sqrt(rigidity / length / tip)
    low, high = 0.0, 0.5 * math.pi
    while low < (middle := 0.5 * (low + high)) < high:
        if tip * middle * math.sin(middle) < own * math.cos(middle):
            low = middle
        else:
            high = middle
    return high / length * math.sqrt(rigidity / per_length)
