"""Limits of small deflections, and sentences about links that bend beyond them."""

from collections.abc import Sequence

import numpy as np

from dynamics.description.arm import Arm
from dynamics.formulations.kinematics import Chain
from dynamics.types import Array

LARGEST_DEFLECTION = 0.1  # [-] tip deflection over length, of a link or segment
LARGEST_SLOPE = 0.15  # [rad] tip rotation of a link or segment


class ValidityWarning(UserWarning):
    """A motion or a rest violates an assumption of its model."""


def bending(arm: Arm, chain: Chain, bodies: Sequence[slice], q: Array) -> list[str]:
    """One sentence for each link that bends beyond its limits at coordinates q (N, n).

    `bodies` are the places of each link's segments in the chain.
    """
    parts = list(zip(chain.links, chain.split(list(q.T)), strict=True))
    result = []
    for i, (link, place) in enumerate(zip(arm.links, bodies, strict=True), 1):
        part = "link" if link.segments == 1 else "segment"
        deflection = slope = 0.0
        for body, (_, delta) in parts[place]:
            m = len(body.K)
            if m == 0:
                continue
            shift, turn = (
                np.linalg.norm(np.transpose(shapes[:m]) @ np.array(delta), axis=0).max()
                for shapes in (body.tip_phi, body.tip_theta)
            )
            deflection = max(deflection, float(shift) / body.length)
            slope = max(slope, float(turn))
        advice = f"expect errors, or raise Link.segments ({link.segments})."
        if deflection > LARGEST_DEFLECTION:
            result.append(
                f"Link {i} bends by up to {deflection:.0%} of the {part}'s length, more than "
                f"{LARGEST_DEFLECTION:.0%}: {advice}"
            )
        if slope > LARGEST_SLOPE:
            result.append(
                f"Link {i} turns the {part}'s tip by up to {slope:.2f} rad, more than "
                f"{LARGEST_SLOPE} rad: {advice}"
            )
    return result
