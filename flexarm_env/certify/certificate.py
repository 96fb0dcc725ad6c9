"""Certificate of an environment: tip errors over whole episodes, by cause.

Five models of one arm play the same episodes: the environment's; the same with fine steps; a rich
one, in one piece with many modes; the reference, in segments; and for some of the episodes a finer
reference. The certificate has the distances between neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np
from scipy.stats import binom

from dynamics.accuracy.certificate import fidelity_of
from dynamics.accuracy.fidelity import Fidelity, everything, rigid
from dynamics.accuracy.progress import Progress
from dynamics.description.arm import Arm
from dynamics.types import Array
from flexarm_env.accuracy.certificates import REFERENCE_METHOD as METHOD
from flexarm_env.accuracy.certificates import reference
from flexarm_env.certify.episodes import Distances, Episodes, Trace, environment
from flexarm_env.certify.motions import KINDS
from flexarm_env.core import Core
from flexarm_env.scales import RIGID_PERIOD, scales

EPISODES = 64  # of each kind
CHECKED = 16  # of each kind, by a finer reference
SHARE = 0.95  # of the episodes of a kind that stay within the stated error
RICH = (6, 2)  # modes of the rich model: of bending, of torsion
FINE = 60  # least steps of a fine model per control step
PER_PERIOD = 400  # and per period of the first joint-free mode
DISTURBANCE = 1e-6  # [rad] of the first joint at the start
LEVELS = (1e-3, 1e-2)  # [of the reach] errors whose times are stated
TIMES = 25  # of the curve over an episode
CONFIDENCE = 0.95


def converged_steps(arm: Arm, control_dt: float) -> int:
    """Steps per control step of a fine model."""
    free = scales(arm).free
    period = 2.0 * np.pi / free[0] if free else RIGID_PERIOD
    return max(FINE, ceil(PER_PERIOD * control_dt / period))


def rich(arm: Arm) -> Fidelity:
    """Links in one piece with many modes."""
    whole = rigid(arm, foreshortening=True, polynomial=True)
    return replace(whole, counts=everything(arm, *RICH))


class Certifier:
    """Errors of an environment's model by any method and step, all from one reference.

    Parameters
    ----------
    arm : the described arm.
    keywords : of the environment, as those of `core.Core`; fidelity and steps are chosen here.
    steps : control steps of an episode.
    """

    def __init__(
        self,
        arm: Arm,
        keywords: Mapping[str, Any],
        steps: int,
        line: Progress | None = None,
        kinds: Sequence[str] = tuple(KINDS),
        count: int = EPISODES,
    ) -> None:
        self.arm, self.keywords, self.line = arm, dict(keywords), line or Progress(False)
        base = self._core("auto", None, None, 1)
        self.control_dt, self.reach = base.control_dt, arm.reach
        self.episodes = Episodes.drawn(base, kinds, count, steps)
        self._fine = converged_steps(arm, self.control_dt)
        self.line.stage("reference")
        self.reference = self._played(reference(arm), METHOD, self._fine)

    def error(self, integrator: str, substeps: int) -> Distances:
        """Distances of model and step from the reference."""
        trace = self._played("auto", integrator, substeps)
        return Distances.between(trace, self.reference, self.episodes.kinds)

    def certificate(self, integrator: str, substeps: int) -> dict[str, Any]:
        """The certificate of a step: JSON numbers and text."""
        kinds, own = self.episodes.kinds, self._played("auto", integrator, substeps)
        self.line.stage("causes")
        fine = self._played("auto", METHOD, self._fine)
        many = self._played(rich(self.arm), METHOD, self._fine)
        nudged = self._played("auto", integrator, substeps, DISTURBANCE)
        total = Distances.between(own, self.reference, kinds)
        growth = Distances.between(own, nudged, kinds)
        core = self._core("auto", integrator, substeps, 1)

        def part(a: Trace, b: Trace) -> float:
            return Distances.between(a, b, kinds).quantile(SHARE)

        return {
            "model": str(fidelity_of(self.arm)),
            "integrator": integrator,
            "dt": self.control_dt / substeps,
            "error": total.quantile(SHARE),
            "integration": part(own, fine),
            "truncation": part(fine, many),
            "nonlinear": part(many, self.reference),
            "residual": self._residual(),
            "reach": self.reach,
            "cost": float(core._operations() / self.control_dt),
            "reference": str(reference(self.arm)),
            "scene": f"{SHARE:.0%} of {len(kinds) // len({*kinds})} whole episodes of each kind",
            "holds": holds(core, self.keywords),
            "episodes": summary(total, growth, self.control_dt, self.reach),
        }

    def _residual(self) -> float:
        """[m] from the reference to a finer one with half the step, for some of the episodes."""
        kinds = np.array(self.episodes.kinds)
        rows = np.concatenate([np.flatnonzero(kinds == k)[:CHECKED] for k in dict.fromkeys(kinds)])
        some = self.episodes.of(rows)
        core = self._core(reference(self.arm, finer=1), METHOD, 2 * self._fine, len(rows))
        finer = some.played(core)
        coarse = Trace(self.reference.tips[:, rows], self.reference.valid[:, rows])
        return Distances.between(coarse, finer, some.kinds).quantile(SHARE)

    def _core(
        self, model: str | Fidelity, integrator: str | None, substeps: int | None, count: int
    ) -> Core:
        steps = {"integrator": integrator, "substeps": substeps}
        arm = self.arm.with_listed_modes()
        return environment(arm, count, {**self.keywords, **steps, "fidelity": model})

    def _played(
        self, model: str | Fidelity, integrator: str, substeps: int, disturbance: float = 0.0
    ) -> Trace:
        core = self._core(model, integrator, substeps, len(self.episodes.kinds))
        trace = self.episodes.played(core, disturbance)
        self.line.motion()
        return trace


def summary(total: Distances, growth: Distances, control_dt: float, reach: float) -> dict[str, Any]:
    """Statistics of each kind of motion, errors over the reach, and curves over the episode."""
    steps = len(total.largest)
    shown = np.unique(np.linspace(0, steps - 1, TIMES).round().astype(int))
    kinds, curves = {}, {}
    for kind in dict.fromkeys(total.kinds):
        own = total.of(kind) / reach
        largest = np.nan_to_num(np.nanmax(np.vstack([own, 0.0 * own[:1]]), axis=0))
        curve = _curve(own)
        low, high = interval(largest, SHARE)
        kinds[kind] = {
            "median": _short(np.median(largest)),
            "share": _short(np.quantile(largest, SHARE)),
            "interval": [_short(low), _short(high)],
            "worst": _short(largest.max()),
            "length": _short(control_dt * np.isfinite(own).sum(axis=0).mean()),
            "until": [_until(curve, level, control_dt) for level in LEVELS],
            "growth": _short(_growth(growth.of(kind)) / (DISTURBANCE * reach)),
        }
        curves[kind] = [None if np.isnan(x) else _short(x) for x in curve[shown]]
    times = [_short(x) for x in control_dt * (shown + 1)]
    return {"count": own.shape[1], "duration": control_dt * steps, "share": SHARE,
            "levels": list(LEVELS), "kinds": kinds, "times": times, "curves": curves}  # fmt: skip


def interval(values: Array, share: float) -> tuple[float, float]:
    """Interval of a quantile by order statistics; its upper end may be the largest value."""
    ordered, n = np.sort(values), len(values)
    low, high = binom.ppf((0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE), n, share)
    return float(ordered[int(max(low - 1, 0))]), float(ordered[int(min(high, n - 1))])


def holds(core: Core, keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Conditions under which a certificate holds: the torques, drawn parameters and actuators."""
    return {
        "torque_limit": core.torque_limit.tolist(),
        "ranges": {name: list(pair) for name, pair in core.randomize.items()},
        "actuator": keywords.get("actuator"),
        "base_torque": keywords.get("base_torque"),
        "deflection_limit": core.settings.deflection_limit,
    }


def _curve(largest: Array) -> Array:
    """(T,) quantile SHARE of the episodes that go on; NaN where none does."""
    result = np.full(len(largest), np.nan)
    for k, row in enumerate(largest):
        if np.isfinite(row).any():
            result[k] = np.quantile(row[np.isfinite(row)], SHARE)
    return result


def _until(curve: Array, level: float, control_dt: float) -> float | None:
    """[s] first time at which a curve exceeds a level; None if it does not."""
    above = np.flatnonzero(curve > level)
    return _short(control_dt * (above[0] + 1)) if above.size else None


def _growth(largest: Array) -> float:
    """Median over episodes of the largest distance."""
    values = np.nanmax(np.vstack([largest, 0.0 * largest[:1]]), axis=0)
    return float(np.median(np.nan_to_num(values)))


def _short(x: Any) -> float:
    return float(f"{float(x):.3g}")
