"""Tip errors of an arm's models on a scene, measured against a converged reference."""

import logging
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynamics.accuracy.choice import NoModel
from dynamics.accuracy.fidelity import Fidelity, divisible, everything, rigid
from dynamics.accuracy.rollout import NotConverged, Rollout, distance
from dynamics.accuracy.scene import Scene
from dynamics.description.arm import Arm
from dynamics.progress import Progress
from dynamics.validity import LARGEST_DEFLECTION

_log = logging.getLogger(__name__)
Tips = list[NDArray[np.float64]]  # (N, 3) [m] per motion

INTEGRATION_SHARE = 0.02  # of the tolerance: integration error allowed in a compared motion
REFERENCE_SHARE = 0.1  # of the tolerance: residual allowed in the reference
MODEL_SHARE = 0.9  # of the tolerance less the residual: error allowed in a model before stepping
REFERENCES = ((2, 3), (4, 3), (8, 3), (16, 2))  # segments per link, modes per direction


class ModelErrors:
    """Tip errors of an arm's models on a scene; each model's motions are computed once."""

    def __init__(
        self, arm: Arm, scene: Scene, tolerance: float, progress: Progress | None = None
    ) -> None:
        self.arm, self.scene, self.tolerance = arm, scene, tolerance
        self.progress = progress or Progress(False)
        self.residual = 0.0  # [m] tip displacement by the last refinement of the reference
        self.reference: Tips = []
        self._rollouts: dict[Fidelity, Rollout] = {}
        self._tips: dict[Fidelity, Tips] = {}

    @property
    def model_tolerance(self) -> float:
        """[m] error allowed in a model with converged integration."""
        return MODEL_SHARE * (self.tolerance - self.residual)

    def rollout(self, fidelity: Fidelity) -> Rollout:
        if fidelity not in self._rollouts:
            self._rollouts[fidelity] = Rollout(fidelity.arm(self.arm))
        return self._rollouts[fidelity]

    def tips(self, fidelity: Fidelity) -> Tips:
        """Converged motions of a model; NaN if one diverges."""
        if fidelity not in self._tips:
            try:
                found = self._converged(self.rollout(fidelity))
            except NotConverged:
                found = [np.full_like(tip, np.nan) for tip in self.reference]
            self._tips[fidelity] = found
            error = largest_distance(found, self.reference)
            _log.info("%s: %.2g m from the reference", fidelity, error)
            self.progress.result(
                f"{error:.2g} m from the reference, {self.model_tolerance:.2g} m allowed"
            )
        return self._tips[fidelity]

    def measured(self, fidelity: Fidelity) -> bool:
        """True if a model's motions have been computed."""
        return fidelity in self._tips

    def error(self, fidelity: Fidelity) -> float:
        """[m] distance of a model, with converged integration, from the reference."""
        return largest_distance(self.tips(fidelity), self.reference)

    def integration(self, fidelity: Fidelity, integrator: str, dt: float) -> float:
        """[m] integration error of a model by steps of about `dt` [s] as in use."""
        rollout = self.rollout(fidelity)
        runs = []
        for motion in self.scene.motions:
            runs.append(rollout.run(motion, integrator, dt))
            self.progress.motion()
        pairs = zip(runs, self.tips(fidelity), strict=True)
        error = max(distance(run.tips, tips[:: run.stride]) for run, tips in pairs)
        self.progress.result(f"{integrator}, dt {dt:.3g} s: {error:.2g} m")
        return error

    def step_budget(self, fidelity: Fidelity) -> float:
        """[m] share of the tolerance that a model leaves for its integration error."""
        return self.tolerance - self.residual - self.error(fidelity)

    def operations(self, fidelity: Fidelity) -> int:
        return self.rollout(fidelity).operations

    def converge(self) -> str:
        """Refine the reference until its tip settles; return a description of it.

        The segments of links are doubled; a link before a parallel drive, which has none, gets one
        more mode.
        """
        self.progress.stage("reference")
        start = rigid(self.arm, foreshortening=True, polynomial=True)
        start = replace(start, counts=everything(self.arm, 3, 2))
        if start.rigid:
            start = rigid(self.arm)
        level, tips = start, self._reference_tips(start)
        change = 0.0 if start.rigid else math.inf
        for finer, (segments, modes) in enumerate(REFERENCES, 1):
            if change <= REFERENCE_SHARE * self.tolerance:
                break
            cuts = divisible(self.arm)
            cut = tuple(
                segments if any(counts) and cut else 1
                for counts, cut in zip(start.counts, cuts, strict=True)
            )
            few, many = everything(self.arm, modes, 2), everything(self.arm, 3 + finer, 2 + finer)
            counts = tuple(a if cut else b for a, b, cut in zip(few, many, cuts, strict=True))
            before = tips
            level = replace(start, counts=counts, segments=cut)
            tips = self._reference_tips(level)
            change = largest_distance(tips, before)
            _log.info("reference, %s: moved the tip by %.2g m", level, change)
            self.progress.result(
                f"moved the tip by {change:.2g} m, {REFERENCE_SHARE * self.tolerance:.2g} m allowed"
            )
        if change > REFERENCE_SHARE * self.tolerance:
            raise NoModel(
                f"The reference does not converge: with '{level}' the tip still moves by "
                f"{change:.3g} m; a tolerance of {self.tolerance:.3g} m needs "
                f"{REFERENCE_SHARE * self.tolerance:.3g} m. Take a larger tolerance or a shorter "
                "scene."
            )
        self._check_undivided(level)
        self.reference, self.residual = tips, change
        self.progress.stage("models")
        return f"{level}; its last refinement moved the tip by {change:.2g} m"

    def _check_undivided(self, level: Fidelity) -> None:
        """Refuse large deflections of a link that the reference cannot cut into segments."""
        for i, cut in enumerate(divisible(self.arm)):
            if cut or not any(level.counts[i]):
                continue
            bent = max(self.rollout(level).deflection(m, i) for m in self.scene.motions)
            if bent > LARGEST_DEFLECTION:
                raise NoModel(
                    f"No reference for link {i + 1}: it bends by {bent:.0%} of its length, and "
                    f"Joint.parallel of link {i + 2} (True) forbids segments, without which "
                    f"{LARGEST_DEFLECTION:.0%} are allowed. Take smaller torques, or set "
                    "Joint.parallel to False."
                )

    def _reference_tips(self, fidelity: Fidelity) -> Tips:
        try:
            self._tips[fidelity] = self._converged(self.rollout(fidelity))
        except NotConverged as error:
            raise NoModel(f"No reference from '{fidelity}': {error}") from error
        return self._tips[fidelity]

    def _converged(self, rollout: Rollout) -> Tips:
        accuracy, result = INTEGRATION_SHARE * self.tolerance, []
        for motion in self.scene.motions:
            result.append(rollout.converged(motion, accuracy))
            self.progress.motion()
        return result


def largest_distance(a: Tips, b: Tips) -> float:
    """[m] largest distance over all motions."""
    return max(distance(x, y) for x, y in zip(a, b, strict=True))
