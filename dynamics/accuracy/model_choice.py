"""The cheapest model of an arm whose tip stays within a tolerance on a scene's own motions.

Found by measurement: a reference is refined until refining it no longer matters, then models are
tried from rigid links upwards, one mode or cut at a time, and last the integration step. The arm
gives lengths, masses and stiffnesses; of its modes only the family of shapes counts.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from dynamics.accuracy.fidelity import (
    MOST_MODES,
    MOST_SEGMENTS,
    Change,
    Counts,
    Fidelity,
    everything,
    rigid,
)
from dynamics.accuracy.reference import Bench, apart
from dynamics.accuracy.rollout import SAMPLES, STRIDES, distance
from dynamics.accuracy.scene import Scene
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource, load_arm

SAFE = 0.7  # of an explicit method's stability limit: frequencies change with the pose
TRIALS = 3  # changes measured per rung, the most promising ones, once all have been seen
CROWDED = 0.3  # of the tolerance: a model that leaves its steps less may be the dearer one
ROOMIER = 2.0  # times as much for the steps, for a richer model to be tried
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


def choose_model(arm: ArmSource, scene: Scene, tolerance: float) -> Choice:
    """The cheapest model, integrator and step with a tip error of at most `tolerance` [m].

    Parameters
    ----------
    arm : whatever `load_arm` takes: lengths, masses, stiffnesses, tip bodies and joints; its modes
        name the family of shapes, a damping ratio the viscosity, see `damping.viscous`.
    scene : the motions that count; the error is the largest over time and motions.
    tolerance : [m]

    Raises
    ------
    ValueError : for a scene that does not fit the arm, or a tolerance that is not positive.
    RuntimeError : naming numbers, if the reference does not converge or no step is small enough.
    """
    arm = load_arm(arm)
    validate.instance(scene, "scene", Scene).check(arm)
    bench = Bench(arm, scene, validate.positive(tolerance, "tolerance", "m"))
    reference = bench.converge()
    ladder: list[Rung] = []
    enough = _climb_all(bench, ladder)
    steps = list(_steps(bench, enough))
    ladder += [step.rung for step in steps]
    roomier = _roomier(bench, enough)
    if roomier:
        further = list(_steps(bench, roomier, min(step.cost for step in steps)))
        ladder += [_rung(bench, roomier, None), *(step.rung for step in further)]
        steps += further
    step = min(steps, key=lambda step: step.cost)
    chosen, best = step.model, step.rung
    if best.cost is None:
        raise RuntimeError(
            f"No step keeps '{chosen}' within {tolerance:.3g} m of the reference; "
            f"smallest error {min(k.rung.error for k in steps):.3g} m."
        )
    return Choice(
        arm=chosen.arm(arm),
        integrator=step.integrator,
        dt=step.dt,
        tolerance=bench.tolerance,
        error=best.error,
        residual=bench.residual,
        cost=best.cost,
        reason=_reason(bench, chosen, best),
        reference=reference,
        scene=scene.name,
        ladder=tuple(ladder),
    )


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
    """Take away, cheapest remainder first, whatever turns out not to be needed.

    What is needed beside much is not tried again beside less.
    """
    needed: set[Change] = set()
    while True:
        options = {c: f for c, f in fidelity.poorer().items() if c not in needed}
        for change in sorted(options, key=lambda c: bench.operations(options[c])):
            if bench.error(options[change]) <= bench.enough:
                fidelity = options[change]
                break
            needed.add(change)
        else:
            return fidelity


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


@dataclass(frozen=True)
class _Step:
    """A method's largest step with a model."""

    model: Fidelity
    integrator: str
    dt: float  # [s]
    rung: Rung

    @property
    def cost(self) -> float:
        return math.inf if self.rung.cost is None else self.rung.cost


def _roomier(bench: Bench, enough: Fidelity) -> Fidelity | None:
    """Where a model leaves little to its steps, a richer one that leaves them several times that.

    The more accurate model may be the cheaper one, for its longer steps.
    """
    left = bench.left(enough)
    if left > CROWDED * bench.tolerance:
        return None
    segments = MOST_SEGMENTS if max(enough.segments) > 1 else 1
    options = enough.richer(everything(bench.arm, MOST_MODES, 2), segments).values()
    roomy = [f for f in options if bench.left(f) > ROOMIER * left]
    return min(roomy, key=bench.operations, default=None)


def _steps(bench: Bench, fidelity: Fidelity, cheapest: float = math.inf) -> Iterator[_Step]:
    """Per integrator its largest step within the tolerance, if any costs less than `cheapest`."""
    model, left = bench.error(fidelity), bench.left(fidelity)
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
        rung = Rung(
            description=f"{name}, dt {dt:.4g} s",
            error=model + integration,
            integration=integration,
            operations=traced.operations,
            cost=work / dt if integration <= left else None,
        )
        yield _Step(fidelity, name, dt, rung)


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
    poorer = [bench.error(f) for f in chosen.poorer().values()]
    less = f"; the next simpler model errs by {_metres(min(poorer))} m" if poorer else ""
    if poorer and min(poorer) <= bench.enough:
        less += ", and its shorter steps cost more"
    return (
        f"{str(chosen).capitalize()} with {best.description} keeps the tip within "
        f"{_metres(best.error)} m of the reference, {bench.tolerance:.3g} m are allowed{less}."
    )


def _metres(value: float | None) -> str:
    if value is None:
        return ""
    return "diverged" if value == math.inf else f"{value:.2g}"
