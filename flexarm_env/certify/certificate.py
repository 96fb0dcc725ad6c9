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

from dynamics.accuracy.fidelity import Fidelity, everything, fidelity_of, rigid
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.progress import Progress
from dynamics.tracing.traced_arm import TracedArm
from dynamics.types import Array
from flexarm_env import arguments
from flexarm_env.accuracy.certificates import REFERENCE_METHOD as METHOD
from flexarm_env.accuracy.certificates import reference
from flexarm_env.accuracy.motions import KINDS
from flexarm_env.certify.episodes import SHARE, Distances, Episodes, Trace, environment
from flexarm_env.core import Core
from flexarm_env.plant import fastest_drawn
from flexarm_env.task.scales import DEFLECTION_LIMIT, RIGID_PERIOD, SAFE, scales, stable_steps

EPISODES = 64  # of each kind
CHECKED = 16  # of each kind, by a finer reference
RICH = (6, 2)  # modes of the rich model: of bending, of torsion
EXPLICIT = "rk4"  # of a stiff model, with which the implicit METHOD diverges
FINE = 60  # least steps of a fine model per control step
MOST_FINE = 1000  # steps of EXPLICIT per control step
PER_PERIOD = 400  # and per period of the first joint-free mode
WIDER = 1.1  # times the deflection limit, of other models: a controller may ride the environment's
DISTURBANCE = 1e-6  # [rad] of every joint at the start
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
    arm : the described arm, whose modes are listed.
    keywords : of the environment, as those of `core.Core`; fidelity and steps are chosen here.
    steps : control steps of an episode.

    Raises
    ------
    ValueError : where every episode of a kind ends at once.

    Attributes
    ----------
    model : the arm as it is stepped, rotors of actuators included.
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
        base = self.default()
        self.model, self.control_dt, self.reach = base.arm, base.control_dt, arm.reach
        self.episodes = Episodes.drawn(base, kinds, count, steps)
        self._fine = converged_steps(arm, self.control_dt)
        self._ranges = base.randomize
        self.line.stage("reference")
        self.reference = self._converged(reference(arm))
        self.line.stage("model")
        self._own = self._converged("auto")
        self._refuse_ended()

    def _refuse_ended(self) -> None:
        """Refuse a kind whose episodes all end at once: their errors would be zero."""
        found = self.model_error()
        for kind in dict.fromkeys(found.kinds):
            if np.isnan(found.of(kind)).all():
                raise ValueError(
                    f"Errors cannot be measured: every episode of kind {kind!r} ends in its first "
                    f"control step of {self.control_dt:g} s, as links bend too far. Give a larger "
                    "deflection_limit, smaller torques, or a stiffer arm."
                )

    def model_error(self) -> Distances:
        """Distances of the model, with fine steps, from the reference."""
        return Distances.between(self._own, self.reference, self.episodes.kinds)

    def default(self) -> Core:
        """An environment as it is by default."""
        return self._core("auto", None, None, 1)

    def trace(self, integrator: str, substeps: int, disturbance: float = 0.0) -> Trace:
        """The episodes of the model with a step; joints start `disturbance` [rad] off."""
        return self._played("auto", integrator, substeps, disturbance)

    def error(self, integrator: str, substeps: int) -> Distances:
        """Distances of model and step from the reference."""
        trace = self.trace(integrator, substeps)
        return Distances.between(trace, self.reference, self.episodes.kinds)

    def certificate(self, integrator: str, substeps: int) -> dict[str, Any]:
        """The certificate of a step: JSON numbers and text."""
        kinds, own = self.episodes.kinds, self._played("auto", integrator, substeps)
        self.line.stage("causes")
        many = self._converged(rich(self.arm))
        nudged = self._played("auto", integrator, substeps, DISTURBANCE)
        total = Distances.between(own, self.reference, kinds)
        growth = Distances.between(own, nudged, kinds)
        core = self._core("auto", integrator, substeps, 1)

        def part(a: Trace, b: Trace) -> float | None:
            return _finite(Distances.between(a.until(own), b.until(own), kinds).worst_share)

        return {
            "model": str(fidelity_of(self.arm)),
            "integrator": integrator,
            "dt": self.control_dt / substeps,
            "error": _finite(total.worst_share),
            "integration": part(own, self._own),
            "truncation": part(self._own, many),
            "nonlinear": part(many, self.reference),
            "residual": _finite(self._residual(own)),
            "reach": self.reach,
            "cost": float(core._operations() / self.control_dt),
            "reference": str(reference(self.arm)),
            "scene": f"{SHARE:.0%} of {len(kinds) // len({*kinds})} whole episodes of each kind",
            "holds": core.conditions.to_dict(),
            "episodes": summary(total, growth, self.control_dt, self.reach),
        }

    def _residual(self, own: Trace) -> float:
        """[m] from the reference to a finer one with half the step, for some of the episodes."""
        kinds = np.array(self.episodes.kinds)
        rows = np.concatenate([np.flatnonzero(kinds == k)[:CHECKED] for k in dict.fromkeys(kinds)])
        some = self.episodes.of(rows)
        ends, fine = own.of(rows), self._converged(reference(self.arm, finer=1), some, finer=2)
        coarse, finer = self.reference.of(rows).until(ends), fine.until(ends)
        return Distances.between(coarse, finer, some.kinds).worst_share

    def _core(
        self,
        model: str | Fidelity,
        integrator: str | None,
        substeps: int | None,
        count: int,
        wider: float = 1.0,
    ) -> Core:
        limit = self.keywords.get("deflection_limit", DEFLECTION_LIMIT)
        least, most = arguments.DEFLECTION_LIMITS
        limit = min(wider * arguments.within("deflection_limit", limit, least, most, "-"), most)
        steps = {"integrator": integrator, "substeps": substeps}
        keywords = {**self.keywords, **steps, "fidelity": model, "deflection_limit": limit}
        return environment(self.arm, count, keywords)

    def _converged(
        self, model: str | Fidelity, some: Episodes | None = None, finer: int = 1
    ) -> Trace:
        """The episodes of a model with fine steps, of a stable explicit method if they diverge."""
        arm = model.arm(self.model) if isinstance(model, Fidelity) else self.model
        trace = self._played(model, METHOD, finer * self._fine_steps(arm), some=some)
        if trace.diverged.mean() <= 1.0 - SHARE:
            return trace
        limit = SAFE * INTEGRATORS[EXPLICIT].limit
        stable = max(self._fine, ceil(self.control_dt * scales(arm).fastest / limit))
        if stable > MOST_FINE:
            return trace
        return self._played(model, EXPLICIT, finer * stable, some=some)

    def _fine_steps(self, arm: Arm) -> int:
        """Steps of METHOD per control step, stable in its explicit damping."""
        chain = TracedArm(arm).chain
        if not chain.dampers and not any(link.coulomb for link in chain.links):
            return self._fine
        drawn = fastest_drawn(arm, self._ranges)
        return stable_steps(drawn, self.control_dt, METHOD, self._fine)

    def _played(
        self,
        model: str | Fidelity,
        integrator: str,
        substeps: int,
        disturbance: float = 0.0,
        some: Episodes | None = None,
    ) -> Trace:
        episodes = some or self.episodes
        wider = 1.0 if model == "auto" else WIDER
        core = self._core(model, integrator, substeps, len(episodes.kinds), wider)
        trace = episodes.played(core, disturbance)
        self.line.motion()
        return trace


def summary(total: Distances, growth: Distances, control_dt: float, reach: float) -> dict[str, Any]:
    """Statistics of each kind of motion, errors over the reach, and curves over the episode."""
    steps = len(total.largest)
    shown = np.unique(np.linspace(0, steps - 1, TIMES).round().astype(int))
    kinds, curves = {}, {}
    for kind in dict.fromkeys(total.kinds):
        own = total.of(kind)
        rows = np.array(total.kinds) == kind
        largest = total.per_episode[rows] / reach
        curve = total.curve(kind) / reach
        low, high = interval(largest, SHARE)
        kinds[kind] = {
            "median": _short(np.median(largest)),
            "share": _short(total.share(kind) / reach),
            "interval": [_short(low), _short(high)],
            "worst": _short(largest.max()),
            "length": _short(control_dt * np.isfinite(own).sum(axis=0).mean()),
            "until": [_until(curve, level, control_dt) for level in LEVELS],
            "growth": _short(np.median(growth.per_episode[rows]) / (DISTURBANCE * reach)),
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


def _until(curve: Array, level: float, control_dt: float) -> float | None:
    """[s] first time at which a curve exceeds a level; None if it never does."""
    above = np.flatnonzero(curve > level)
    return _short(control_dt * (above[0] + 1)) if above.size else None


def _short(x: Any) -> float | None:
    """Three digits; None if an episode diverges."""
    return float(f"{float(x):.3g}") if np.isfinite(x) else None


def _finite(x: float) -> float | None:
    """The number, or None if it is infinite: more of the episodes diverge than may leave it."""
    return x if np.isfinite(x) else None
