"""Welds between the segments of a link or between links, and the shapes that cannot load them.

A weld carries moment and shear. A shape whose own tip is free of them leaves every segment
straight at its end, so that a link of such shapes is too stiff in any number of segments; so is one
to whose tip others or a payload are welded.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from dynamics.description.beams.sections import cut
from dynamics.description.mode_shapes import (
    BENDING,
    STIFFNESS,
    Beam,
    Mode,
    in_direction,
    points,
    shape,
)
from dynamics.description.validate import ZEROS

FREE_TIP = {  # kind -> the load that its tip cannot take
    "clamped-free": "moment", "clamped-tip-mass": "moment",
    "torsion-fixed-free": "torque", "axial-fixed-free": "force",
}  # fmt: skip
_BEARING = {"moment": "hierarchical", "torque": "torsion-poly", "force": "axial-poly"}


class StiffSegmentsWarning(UserWarning):
    """A link in segments, or with bodies welded to its tip, has shapes that leave it too stiff."""


def unloaded(modes: Sequence[Mode]) -> str | None:
    """The load that no shape along one direction takes at its tip, or None if one does."""
    loads = [FREE_TIP.get(mode.kind) for mode in modes]
    return loads[0] if loads and all(loads) else None


def tip_compliance(modes: Sequence[Mode], beam: Beam, segments: int) -> float:
    """Tip compliance of a link in segments over that of its beam [-].

    Under a force across, a torque or a force along the tip, by the direction of the modes. A beam
    has the compliance int (l - x)^2 / EI, int 1 / GJ or int 1 / EA.
    """
    size, total = beam.length / segments, 0.0
    for k in range(segments):
        part = replace(beam, length=size, sections=cut(beam.sections, k * size, (k + 1) * size))
        if k < segments - 1:
            part = replace(part, tip_mass=0.0, tip_inertia=ZEROS)
        total += _yield(modes, part, beam.length - (k + 1) * size)
    x, weights = points(beam, modes)
    lever = (beam.length - x) ** 2 if modes[0].direction in BENDING else np.ones(x.size)
    return total / float(weights @ (lever / beam.rigidity(modes[0].direction, x)))


def stiff_segments(name: str, modes: Sequence[Mode], beam: Beam, segments: int) -> str | None:
    """Sentence of the warning about the shapes of a link in segments, or None."""
    for direction in STIFFNESS if segments > 1 else ():
        own = in_direction(modes, direction)
        load = unloaded(own)
        if load:
            share = tip_compliance(own, beam, segments)
            return (
                f"{name} in {segments} segments has {_kinds(own)} modes along {direction!r}, which "
                f"bear no {load} at a weld: its tip yields only {share:.3g} of what the beam's "
                f"does; take {_BEARING[load]} modes, or modes: auto."
            )
    return None


def stiff_end(name: str, modes: Sequence[Mode], beam: Beam, laden: Collection[str]) -> str | None:
    """Sentence of the warning about the shapes of a link to whose tip bodies are welded, or None.

    It has the tip's compliance under a moment, torque or force along it over that of the beam.

    Parameters
    ----------
    laden : directions along which those bodies load the tip.
    """
    for direction in STIFFNESS:
        own = in_direction(modes, direction)
        load = unloaded(own)
        if load and direction in laden:
            x, weights = points(beam, own)
            whole = float(weights @ (1.0 / beam.rigidity(direction, x)))
            share = _yield(own, beam, None) / whole
            return (
                f"{name} has {_kinds(own)} modes along {direction!r}, which bear no {load} at a "
                f"weld, as to the next link or a payload: under it the tip yields only {share:.3g} "
                f"of what the beam's does; take {_BEARING[load]} modes, or modes: auto."
            )
    return None


def _kinds(modes: Sequence[Mode]) -> str:
    return " and ".join(sorted({mode.kind for mode in modes}))


def _yield(modes: Sequence[Mode], beam: Beam, lever: float | None) -> float:
    """Compliance of one segment under unit load at `lever` [m] beyond its tip; None: a moment.

    If it is uniform, its rigidity is 1.
    """
    x, weights = points(beam, modes)
    weights = weights * beam.rigidity(modes[0].direction, x)
    shapes = [shape(mode, beam) for mode in modes]
    bending = modes[0].direction in BENDING
    bent = np.array([s.curvature(x) if bending else s.slope(x) for s in shapes])
    load = np.array([float(s.value(beam.length)) for s in shapes])
    if bending:
        turn = np.array([float(s.slope(beam.length)) for s in shapes])
        load = turn if lever is None else load + lever * turn
    return float(load @ np.linalg.solve((bent * weights) @ bent.T, load))
