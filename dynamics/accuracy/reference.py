"""An arm on a scene: every model's motions, computed once, beside a converged reference."""

import logging
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynamics.accuracy.fidelity import Fidelity, everything, rigid
from dynamics.accuracy.rollout import Rollout, Unsettled, distance
from dynamics.accuracy.scene import Scene
from dynamics.description.arm import Arm

_log = logging.getLogger(__name__)
Tips = list[NDArray[np.float64]]  # (N, 3) [m] per motion

SETTLED = 0.02  # of the tolerance: what integrating a compared motion may cost
CONVERGED = 0.1  # of the tolerance: what refining the reference may still change
MODELLING = 0.9  # of what the reference leaves to modes and nonlinearity; the rest is for steps
REFERENCES = ((2, 3), (4, 3), (8, 3), (16, 2))  # segments per link, modes per direction


class Bench:
    """An arm on a scene: every model's motions, computed once."""

    def __init__(self, arm: Arm, scene: Scene, tolerance: float) -> None:
        self.arm, self.scene, self.tolerance = arm, scene, tolerance
        self.residual = 0.0  # [m]
        self.truth: Tips = []
        self._rollouts: dict[Fidelity, Rollout] = {}
        self._tips: dict[Fidelity, Tips] = {}

    @property
    def enough(self) -> float:
        """[m] error a model may have, before any of its integration."""
        return MODELLING * (self.tolerance - self.residual)

    def rollout(self, fidelity: Fidelity) -> Rollout:
        if fidelity not in self._rollouts:
            self._rollouts[fidelity] = Rollout(fidelity.arm(self.arm))
        return self._rollouts[fidelity]

    def tips(self, fidelity: Fidelity) -> Tips:
        """Settled motions; NaN where a motion diverges."""
        if fidelity not in self._tips:
            found = self._tips[fidelity] = self.follow(self.rollout(fidelity))
            _log.info("%s: %.2g m from the reference", fidelity, apart(found, self.truth))
        return self._tips[fidelity]

    def follow(self, rollout: Rollout) -> Tips:
        """The same of an arm that is no fidelity of the bench's own."""
        try:
            return self._settled(rollout)
        except Unsettled:
            return [np.full_like(tip, np.nan) for tip in self.truth]

    def error(self, fidelity: Fidelity) -> float:
        """[m] from the reference."""
        return apart(self.tips(fidelity), self.truth)

    def left(self, fidelity: Fidelity) -> float:
        """[m] what a model leaves of the tolerance to its steps."""
        return self.tolerance - self.residual - self.error(fidelity)

    def operations(self, fidelity: Fidelity) -> int:
        return self.rollout(fidelity).operations

    def converge(self) -> str:
        """Cut all links of the reference into more segments until that changes little; describe."""
        start = rigid(self.arm, foreshortening=True, polynomial=True)
        start = replace(start, counts=everything(self.arm, 3, 2))
        if start.rigid:
            start = rigid(self.arm)
        level, tips = start, self._reference(start)
        change = 0.0 if start.rigid else math.inf
        for segments, modes in REFERENCES:
            if change <= CONVERGED * self.tolerance:
                break
            cut = tuple(segments if any(counts) else 1 for counts in start.counts)
            counts, before = everything(self.arm, modes, 2), tips
            level = replace(start, counts=counts, segments=cut)
            tips = self._reference(level)
            change = apart(tips, before)
            _log.info("reference, %s: moved the tip by %.2g m", level, change)
        if change > CONVERGED * self.tolerance:
            raise RuntimeError(
                f"The reference does not converge: with '{level}' the tip still moves by "
                f"{change:.3g} m, and {CONVERGED * self.tolerance:.3g} m are wanted for a "
                f"tolerance of {self.tolerance:.3g} m; take a larger tolerance or a shorter scene."
            )
        self.truth, self.residual = tips, change
        return f"{level}; its last refinement moved the tip by {change:.2g} m"

    def _reference(self, fidelity: Fidelity) -> Tips:
        try:
            self._tips[fidelity] = self._settled(self.rollout(fidelity))
        except Unsettled as error:
            raise RuntimeError(
                f"No reference from '{fidelity}': {error} Take a larger tolerance or a shorter "
                "scene."
            ) from error
        return self._tips[fidelity]

    def _settled(self, rollout: Rollout) -> Tips:
        return [rollout.settled(m, SETTLED * self.tolerance) for m in self.scene.motions]


def apart(a: Tips, b: Tips) -> float:
    """[m] largest distance over all motions."""
    return max(distance(x, y) for x, y in zip(a, b, strict=True))
