"""Modes that a link gets by rule (`modes: auto`), and the warning where no modes were stated.

A bending direction with a stiffness gets two modes. Their family suits both ends of the link:

| root                                             | tip                | family           |
|--------------------------------------------------|--------------------|------------------|
| turns about the bending axis, on a light joint   | without a body     | unconstrained    |
| any other                                        | with or without it | clamped-tip-mass |
| any other                                        | a very heavy body  | hierarchical     |
| any, of a link in segments                       | any                | hierarchical     |
| any                                              | turns others       | hierarchical     |

A light joint has less than LIGHT of the link's inertia: `python -m benchmarks.accuracy.stability`
finds two pinned shapes, which span the same bending as unconstrained ones, closer than two clamped
ones up to there. Torsion gets one mode, if the link or its tip body has an inertia about x: a twist
in proportion to x where more than TWISTED of the link's own turns with its tip, as a link beyond
does, else that of a free tip. In segments it gets two, if the link itself has an inertia. Axial
stretching gets none, its frequencies are far above those of bending. A lumped link gets one mode
along a direction in which its tip has no inertia.

Segments are welded, and a weld carries moment and shear. Shapes of a beam whose tip is free of
them make a link in segments too stiff, however many segments it has. Nor do they suit a link whose
tip turns more than LADEN of its inertia with it: what is welded to it, what a joint across its
bending carries, or what a geared joint couples through its rotor (carried.py).
"""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from dynamics.description.joint import Joint
from dynamics.description.mode_shapes import (
    BENDING_AXIS,
    STIFFNESS,
    Beam,
    Mode,
    in_direction,
    shape,
)
from dynamics.description.validate import shown

AUTO = "auto"
PER_PLANE = 2  # modes per bending direction
LADEN = 0.03  # [-] inertia a tip turns over its link's: above it hierarchical shapes err less
LIGHT = 0.005  # [-] joint inertia over the link's, up to which pinned shapes suit
TWISTED = 0.38  # [-] polar inertia at the tip over the link's: from it linear twist errs less
_REMEDY = 'list modes, or write "auto" (shapes by a rule) or [] (a rigid link)'


class RigidLinkWarning(UserWarning):
    """A link with a stiffness is rigid because its description states no modes."""


class TipLoad(NamedTuple):
    """Bodies beyond the tip of a link: other links, or the payload of the last."""

    fixed: float = 0.0  # [kg] to the tip
    bending: Mapping[str, float] = MappingProxyType({})  # [kg m^2] turned with it, by direction
    twisting: float = 0.0  # [kg m^2] that the payload turns about x
    links: bool = False


class ModesByRule(tuple[Mode, ...]):
    """Modes of a link that was described with `modes: auto`."""


def modes_by_rule(
    beam: Beam,
    joint: Joint,
    stiffnesses: Collection[str],
    segments: int,
    bare_root: bool,
    load: TipLoad,
    lumped: bool,
) -> ModesByRule:
    """Modes for the directions whose stiffness is among `stiffnesses`, names of Link fields.

    `bare_root` is false where a body is fixed to the root. The tip of a `lumped` link, where its
    mass is, carries a second mode only if it has an inertia.
    """
    modes: list[Mode] = []
    for direction, axis in BENDING_AXIS.items():
        if STIFFNESS[direction] in stiffnesses:
            kind = _bending(beam, joint, direction, segments, bare_root, load)
            single = lumped and not beam.tip_inertia[axis][axis]
            modes += _first(1 if single else PER_PLANE, kind, direction)
    if STIFFNESS["x"] in stiffnesses:
        if segments > 1 and beam.rho_Ip > 0.0:
            modes += _first(2, "torsion-poly", "x")
        elif segments == 1 and beam.rho_Ip + beam.tip_inertia[0][0] > 0.0:
            turned = beam.tip_inertia[0][0] + load.twisting
            laden = load.links or turned > TWISTED * beam.rho_Ip * beam.length
            modes += _first(1, "torsion-poly" if laden else "torsion-fixed-free", "x")
    return ModesByRule(modes)


def _first(count: int, kind: str, direction: str) -> list[Mode]:
    return [Mode(kind=kind, index=k + 1, direction=direction) for k in range(count)]


def _bending(
    beam: Beam, joint: Joint, direction: str, segments: int, bare_root: bool, load: TipLoad
) -> str:
    if segments > 1 or load.bending.get(direction, 0.0) > LADEN * beam.line_mass.second:
        return "hierarchical"
    loose = direction == "y" and bare_root and not load.fixed and _is_loose(beam, joint)
    return "unconstrained" if loose else _clamped(beam, direction)


def stated(modes: object) -> object:
    """Modes as described; None becomes (), and what is neither a list nor AUTO is refused."""
    return () if modes is None else listed(modes, "Link.modes")


def listed(modes: object, name: str) -> object:
    """Modes as described, a list or AUTO; ValueError for anything else."""
    if not isinstance(modes, list | tuple | np.ndarray) and modes != AUTO:
        raise ValueError(f"{name} must be a list, got {shown(modes)}; {_REMEDY}.")
    return modes


def in_words(modes: Collection[Mode], stiffnesses: Collection[str]) -> str:
    """Modes per direction, and the directions that stay rigid in spite of their stiffness."""
    parts = []
    for direction, stiffness in STIFFNESS.items():
        own = in_direction(modes, direction)
        if own:
            parts.append(f"{len(own)} {own[0].kind} along {direction}")
        elif stiffness in stiffnesses:
            reason = {"x": ", no inertia about x is stated"}.get(direction, "")
            parts.append(f"none along {direction} ({stiffness} unused{reason})")
    return ", ".join(parts) or "no stiffness, so none"


def rigid_in_silence(name: str, stiffnesses: Collection[str]) -> str:
    """Sentence of the warning about a link without stated modes."""
    return (
        f"{name} has {' and '.join(stiffnesses)} but states no modes, so it is rigid; write "
        "modes: [] if that is meant, or modes: auto for mode shapes by a rule."
    )


def rigid_though_auto(name: str) -> str:
    """Sentence of the warning about a link with modes by rule that has no stiffness."""
    return (
        f"{name} states modes: auto but neither EIz, EIy, GJ nor EA, so it is rigid; give a "
        "stiffness, or modes: [] if that is meant."
    )


def _is_loose(beam: Beam, joint: Joint) -> bool:
    tip = beam.tip_mass > 0.0 or any(map(any, beam.tip_inertia))
    if joint.type != "revolute" or joint.elastic or joint.parallel or any(joint.root) or tip:
        return False
    return joint.rotor_inertia + joint.hub_inertia < LIGHT * beam.line_mass.second


def _clamped(beam: Beam, direction: str) -> str:
    try:
        shape(Mode(kind="clamped-tip-mass", index=PER_PLANE, direction=direction), beam)
    except ValueError:  # the tip body is too heavy for these shapes
        return "hierarchical"
    return "clamped-tip-mass"
