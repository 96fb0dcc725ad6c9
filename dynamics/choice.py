"""The cheapest model of an arm whose tip stays within a tolerance on a scene's own motions.

Found by measurement: a reference is refined until refining it no longer matters, then models are
tried from rigid links upwards, one mode or cut at a time, and last the integration step. The arm
gives lengths, masses and stiffnesses; of its modes only the family of shapes counts.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics import checks
from dynamics.arm import Arm
from dynamics.fidelity import (
    MOST_MODES,
    MOST_SEGMENTS,
    Change,
    Counts,
    Fidelity,
    everything,
    rigid,
)
from dynamics.integrators import INTEGRATORS
from dynamics.rollout import SAMPLES, STRIDES, Rollout, Unsettled, distance
from dynamics.scene import Scene

Tips = list[NDArray[np.float64]]  # (N, 3) [m] per motion

SETTLED = 0.02  # of the tolerance: what integrating a compared motion may cost
CONVERGED = 0.1  # of the tolerance: what refining the reference may still change
MODELLING = 0.9  # of what the reference leaves to modes and nonlinearity; the rest is for steps
SAFE = 0.7  # of an explicit method's stability limit: frequencies change with the pose
TRIALS = 3  # changes measured per rung, the most promising ones, once all have been seen
REFERENCES = ((2, 3), (4, 3), (8, 3), (16, 2))  # segments per link, modes per direction
IDLE = 0.05  # gain of a change below which it counts as useless alone
STEPPING = tuple(name for name, method in INTEGRATORS.items() if method.aid != "jacobian")
# a Jacobian is worth 3 (one link) to 19 (six links) evaluations: never the cheapest
FINER = 10.0**0.1  # ratio of neighbouring steps
FINEST = 1e6  # steps per motion


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One model or step of the ladder; errors are the largest distance of the tip [m]."""

    description: str
    error: float  # from the reference, steps added to it; infinite if the motion diverges
    truncation: float | None = None  # from all modes of its kind
    nonlinear: float | None = None  # of its kind with all modes, from the reference
    integration: float | None = None  # of this step alone
    operations: int  # per evaluation of the accelerations
    cost: float | None = None  # operations per simulated second


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What `choose_model` found, and how."""

    arm: Arm
    integrator: str
    dt: float  # [s]
    tolerance: float  # [m]
    error: float  # [m] of arm and of integrator and dt, added
    residual: float  # [m] what the last refinement of the reference changed
    cost: float  # operations per simulated second
    reason: str
    reference: str
    scene: str
    ladder: tuple[Rung, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and text, as JSON would hold them; a diverged error is text."""
        values = {**vars(self), "arm": self.arm.to_dict()}
        values["ladder"] = [
            {k: "diverged" if v == math.inf else v for k, v in vars(rung).items()}
            for rung in self.ladder
        ]
        return values

    def table(self) -> str:
        """The ladder as a Markdown table."""
        head = "| model | error [m] | modes | nonlinear | integration | operations | per second |"
        rows = [head, "|---|---|---|---|---|---|---|"]
        for rung in self.ladder:
            errors = (rung.error, rung.truncation, rung.nonlinear, rung.integration)
            cells = [rung.description, *map(_metres, errors), str(rung.operations)]
            cells.append("" if rung.cost is None else f"{rung.cost:.3g}")
            rows.append(f"| {' | '.join(cells)} |")
        return "\n".join(rows)


def choose_model(arm: Arm, scene: Scene, tolerance: float) -> Choice:
    """The cheapest model, integrator and step with a tip error of at most `tolerance` [m].

    Parameters
    ----------
    arm : lengths, masses, stiffnesses, tip bodies and joints; its modes name the family of shapes.
    scene : the motions that count; the error is the largest over time and motions.
    tolerance : [m]

    Raises
    ------
    ValueError : for a scene that does not fit the arm, or a tolerance that is not positive.
    RuntimeError : naming numbers, if the reference does not converge or no step is small enough.
    """
    scene.check(arm)
    bench = Bench(arm, scene, checks.positive(tolerance, "tolerance", "m"))
    reference = bench.converge()
    ladder: list[Rung] = []
    chosen = _climb_all(bench, ladder)
    steps = list(_steps(bench, chosen))
    ladder += steps
    best = min(steps, key=lambda step: step.cost or math.inf)
    if best.cost is None:
        raise RuntimeError(
            f"No step keeps '{chosen}' within {tolerance:.3g} m of the reference; "
            f"smallest error {min(k.error for k in steps):.3g} m."
        )
    integrator, dt = bench.steps[best.description]
    return Choice(
        arm=chosen.arm(arm),
        integrator=integrator,
        dt=dt,
        tolerance=bench.tolerance,
        error=best.error,
        residual=bench.residual,
        cost=best.cost,
        reason=_reason(bench, chosen, best),
        reference=reference,
        scene=scene.name,
        ladder=tuple(ladder),
    )


class Bench:
    """An arm on a scene: every model's motions, computed once."""

    def __init__(self, arm: Arm, scene: Scene, tolerance: float) -> None:
        self.arm, self.scene, self.tolerance = arm, scene, tolerance
        self.residual = 0.0  # [m]
        self.truth: Tips = []
        self.steps: dict[str, tuple[str, float]] = {}
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
            try:
                self._tips[fidelity] = self._settled(fidelity)
            except Unsettled:
                self._tips[fidelity] = [np.full_like(tip, np.nan) for tip in self.truth]
        return self._tips[fidelity]

    def error(self, fidelity: Fidelity) -> float:
        """[m] from the reference."""
        return apart(self.tips(fidelity), self.truth)

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
            self._tips[fidelity] = self._settled(fidelity)
        except Unsettled as error:
            raise RuntimeError(
                f"No reference from '{fidelity}': {error} Take a larger tolerance or a shorter "
                "scene."
            ) from error
        return self._tips[fidelity]

    def _settled(self, fidelity: Fidelity) -> Tips:
        rollout = self.rollout(fidelity)
        return [rollout.settled(m, SETTLED * self.tolerance) for m in self.scene.motions]


@dataclass(frozen=True)
class _Kind:
    """Models of one kind: where to start, how far to go, and the best it can do."""

    start: Fidelity
    most: tuple[Counts, ...]  # modes
    most_segments: int = 1
    best: Fidelity | None = None  # all modes; None where segments converge to the reference


def _kinds(arm: Arm) -> list[list[_Kind]]:
    """From cheap to dear; of shapes, the cheaper is for measurement to say."""
    few, most = everything(arm, 3, 2), everything(arm, MOST_MODES, 2)
    result = []
    for foreshortening, modes in ((False, (5, 3)), (True, (4, 2))):
        start = rigid(arm, foreshortening, polynomial=True)
        best = replace(start, counts=everything(arm, *modes))
        families = {f.arm(arm): f for f in (best, replace(best, polynomial=False))}.values()
        result.append(
            [_Kind(replace(start, polynomial=f.polynomial), most, best=best) for f in families]
        )
    return [*result, [_Kind(rigid(arm, True, polynomial=True), few, MOST_SEGMENTS)]]


def _climb_all(bench: Bench, ladder: list[Rung]) -> Fidelity:
    """The cheapest model that is good enough; a kind that cannot be is not climbed."""
    start, kinds = rigid(bench.arm), _kinds(bench.arm)
    ladder.append(_rung(bench, start, kinds[0][0].best))
    if bench.error(start) <= bench.enough:
        return start
    for families in kinds:
        good = []
        best = families[0].best
        if best is not None and bench.error(best) > bench.enough:
            ladder.append(_rung(bench, best, best))
            continue
        for kind in families:
            all_modes = replace(kind.start, counts=kind.most)
            if best is not None and bench.error(all_modes) > bench.enough:
                ladder.append(_rung(bench, all_modes, best))
                continue
            path = _climb(bench, kind)
            if bench.error(path[-1]) <= bench.enough:
                good.append(_pruned(bench, path[-1]))
                path += good[-1:] if good[-1] != path[-1] else []
            ladder += [_rung(bench, f, best) for f in path[1:]]
        if good:
            return min(good, key=bench.operations)
    last = ladder[-1]
    raise RuntimeError(
        f"No model on the ladder is within {bench.enough:.3g} m of the reference; the last, "
        f"'{last.description}', errs by {last.error:.3g} m."
    )


def _climb(bench: Bench, kind: _Kind) -> list[Fidelity]:
    """Add what reduces the error most for its cost, until it is enough or nothing is left."""
    path, promise = [kind.start], dict[Change, float]()
    while bench.error(path[-1]) > bench.enough:
        options = path[-1].richer(kind.most, kind.most_segments)
        if not options:
            break
        unseen = [change for change in options if change not in promise]
        seen = sorted((c for c in options if c in promise), key=lambda c: -promise[c])
        tried = unseen + seen[:TRIALS]
        for change in tried:
            promise[change] = _gain(bench, path[-1], options[change])
        best = max(tried, key=lambda change: promise[change])
        together = path[-1].thicker(kind.most)  # modes may help only in company; prune later
        alone = promise[best] > IDLE or together == path[-1]
        path.append(options[best] if alone else together)
    return path


def _gain(bench: Bench, before: Fidelity, after: Fidelity) -> float:
    """Error reduced per cost added, both as ratios."""
    far = 1e3 * bench.arm.reach
    errors = [min(max(bench.error(f), 1e-15), far) for f in (before, after)]
    work = bench.operations(after) / bench.operations(before)
    return math.log(errors[0] / errors[1]) / math.log(max(work, 1.01))


def _pruned(bench: Bench, fidelity: Fidelity) -> Fidelity:
    """Take away, cheapest remainder first, whatever turns out not to be needed."""
    while True:
        good = [f for f in fidelity.poorer() if bench.error(f) <= bench.enough]
        if not good:
            return fidelity
        fidelity = min(good, key=bench.operations)


def _rung(bench: Bench, fidelity: Fidelity, best: Fidelity | None) -> Rung:
    truncation = nonlinear = None
    if best is not None:
        nonlinear = bench.error(best)
        if nonlinear < math.inf:
            truncation = apart(bench.tips(fidelity), bench.tips(best))
    return Rung(
        description=str(fidelity),
        error=bench.error(fidelity),
        truncation=truncation,
        nonlinear=nonlinear,
        operations=bench.operations(fidelity),
    )


def _steps(bench: Bench, fidelity: Fidelity) -> Iterator[Rung]:
    """Per integrator its largest step within the tolerance, if any."""
    model = bench.error(fidelity)
    left = bench.tolerance - bench.residual - model
    cheapest = math.inf
    for name in STEPPING:
        traced = bench.rollout(fidelity).method(name)
        work = traced.evaluations * traced.operations
        dt, integration = math.inf, math.inf
        for finer, error in _trials(bench, fidelity, name):
            if max(integration, error) <= left:  # twice: not by luck
                cheapest = min(cheapest, work / dt)
                break
            dt, integration = finer, error
            if work / dt > cheapest:  # another method has done it for less
                break
        kept = f"{name}, dt {dt:.4g} s"
        bench.steps[kept] = (name, dt)
        yield Rung(
            description=kept,
            error=model + integration,
            integration=integration,
            operations=traced.operations,
            cost=work / dt if integration <= left else None,
        )


def _trials(bench: Bench, fidelity: Fidelity, integrator: str) -> Iterator[tuple[float, float]]:
    """Ever smaller steps [s], and how far each moves the tip [m]."""
    rollout, motions = bench.rollout(fidelity), bench.scene.motions
    fastest = max(rollout.fastest(motion) for motion in motions)
    shortest = min(motion.t_end for motion in motions)
    dt = shortest / (SAMPLES / STRIDES[0])
    if fastest:
        dt = min(dt, SAFE * INTEGRATORS[integrator].limit / fastest)
    while shortest / dt < FINEST:
        runs = [rollout.run(motion, integrator, dt) for motion in motions]
        settled = zip(runs, bench.tips(fidelity), strict=True)
        yield max(r.dt for r in runs), max(distance(r.tips, t[:: r.stride]) for r, t in settled)
        dt /= FINER


def _reason(bench: Bench, chosen: Fidelity, best: Rung) -> str:
    poorer = [bench.error(f) for f in chosen.poorer()]
    less = f"; the next simpler model errs by {_metres(min(poorer))} m" if poorer else ""
    return (
        f"{str(chosen).capitalize()} with {best.description} keeps the tip within "
        f"{_metres(best.error)} m of the reference, {bench.tolerance:.3g} m are allowed{less}."
    )


def apart(a: Tips, b: Tips) -> float:
    """[m] largest distance over all motions."""
    return max(distance(x, y) for x, y in zip(a, b, strict=True))


def _metres(value: float | None) -> str:
    if value is None:
        return ""
    return "diverged" if value == math.inf else f"{value:.2g}"
