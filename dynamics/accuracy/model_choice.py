"""The cheapest model of an arm whose tip error stays within a tolerance on a scene.

All errors are measured. A reference is refined until its tip settles. Models are then refined from
rigid links upwards, by one mode or by doubling the segments of one link, and last the integration
step is chosen. The arm gives lengths, masses and stiffnesses; its own modes only name the family of
shapes. The ladder lists all measured models and steps.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from dynamics.accuracy.choice import Choice, NoModel, Rung, metres
from dynamics.accuracy.fidelity import (
    MOST_MODES,
    MOST_SEGMENTS,
    Change,
    Counts,
    Fidelity,
    divisible,
    everything,
    lumped,
    rigid,
)
from dynamics.accuracy.reference import ModelErrors, largest_distance
from dynamics.accuracy.rollout import SAMPLES, STRIDES
from dynamics.accuracy.scene import Scene
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS, usable
from dynamics.load import ArmSource, load_arm
from dynamics.progress import Progress

STABILITY_SHARE = 0.7  # of a method's stability limit: frequencies change with the pose
TRIALS = 3  # changes with the largest known gain that are measured again at each refinement
SMALL_BUDGET = 0.3  # of the tolerance: below it, a refined model with longer steps may be cheaper
LARGER_BUDGET = 2.0  # ratio of step budgets from which such a refined model is tried
USELESS = 0.05  # gain below which no single change helps, and all modes are raised together
STEP_RATIO = 10.0**0.1  # of a step and the smaller one that has to confirm it
LARGEST_FALL = 0.25  # of a step to the next smaller one that is tried
MOST_STEPS = 1e6  # per motion
MOST_FROZEN = 12  # coordinates of an arm that exponential steps are tried on: many need small steps


def choose_model(
    arm: ArmSource, scene: Scene, tolerance: float, *, progress: bool | None = None
) -> Choice:
    """Find the cheapest model, integrator and step with a tip error of at most `tolerance` [m].

    Parameters
    ----------
    arm : an Arm or any other source that `load_arm` accepts. Lengths, masses, stiffnesses, tip
        bodies and joints are used as described. Modes only name the family of shapes.
    scene : motions on which the tip error is measured, as the largest over time and motions.
    tolerance : [m]
    progress : True shows a line of progress on standard error; None only on a terminal.

    Raises
    ------
    ValueError : for a scene that does not fit the arm, or a tolerance that is not positive.
    NoModel, a RuntimeError : if the reference does not converge, or no model or step is accurate
        enough; the message states the error reached.
    """
    arm = load_arm(arm)
    validate.instance(scene, "scene", Scene).check(arm)
    tolerance = validate.positive(tolerance, "tolerance", "m")
    with Progress(progress) as line:
        return _choice(ModelErrors(arm, scene, tolerance, line))


def _choice(errors: ModelErrors) -> Choice:
    reference = errors.converge()
    ladder: list[Rung] = []
    sufficient = _cheapest_sufficient(errors, ladder)
    errors.progress.stage("steps")
    steps = list(_steps(errors, sufficient))
    ladder += [step.rung for step in steps]
    rival = _rival(errors, sufficient)
    if rival:
        further = list(_steps(errors, rival, min(step.cost for step in steps)))
        ladder += [_rung(errors, rival, None), *(step.rung for step in further)]
        steps += further
    step = min(steps, key=lambda step: step.cost)
    chosen, best = step.model, step.rung
    if best.cost is None:
        least = min(k.rung.error for k in steps)
        raise NoModel(
            f"No step keeps '{chosen}' within {errors.tolerance:.3g} m of the reference; the "
            f"smallest error is {least:.3g} m. Take a larger tolerance."
        )
    return Choice(
        arm=chosen.arm(errors.arm),
        integrator=step.integrator,
        dt=step.dt,
        tolerance=errors.tolerance,
        error=best.error,
        residual=errors.residual,
        cost=best.cost,
        reason=_reason(errors, chosen, best),
        reference=reference,
        scene=errors.scene.name,
        ladder=tuple(ladder),
    )


@dataclass(frozen=True)
class _Kind:
    """Models of one kind (linear, foreshortened or segmented) with one family of shapes."""

    start: Fidelity
    most: tuple[Counts, ...]  # modes
    most_segments: tuple[int, ...]
    best: Fidelity | None = None  # all modes; None for segments, which converge to the reference


def _kinds(arm: Arm) -> list[list[_Kind]]:
    """Kinds in order of cost, each with its families of shapes, whose costs have to be measured."""
    few, most = everything(arm, 3, 2), everything(arm, MOST_MODES, 2)
    few = tuple(f if d else m for f, m, d in zip(few, most, divisible(arm), strict=True))
    whole, cut = (1,) * len(arm.links), _most_segments(arm)
    result = []
    for foreshortening, modes in ((False, (5, 3)), (True, (4, 2))):
        start = rigid(arm, foreshortening, polynomial=True)
        best = replace(start, counts=everything(arm, *modes))
        families = {f.arm(arm): f for f in (best, replace(best, polynomial=False))}.values()
        kinds = [
            _Kind(replace(start, polynomial=f.polynomial), most, whole, best) for f in families
        ]
        result.append([*kinds, _Kind(replace(start, lumped=True), lumped(arm, most), whole, best)])
    return [*result, [_Kind(rigid(arm, True, polynomial=True), few, cut)]]


def _most_segments(arm: Arm) -> tuple[int, ...]:
    return tuple(MOST_SEGMENTS if cut else 1 for cut in divisible(arm))


def _cheapest_sufficient(errors: ModelErrors, ladder: list[Rung]) -> Fidelity:
    """Cheapest model within the model tolerance, of the first kind that has one.

    Kinds and families that fail with all their modes are not refined step by step. A further family
    is tried with the modes that suffice in the first one, and fewer; lumped links, whose errors are
    larger, with those that the first one reached before needless ones were removed.
    """
    start, kinds = rigid(errors.arm), _kinds(errors.arm)
    ladder.append(_rung(errors, start, kinds[0][0].best))
    if errors.error(start) <= errors.model_tolerance:
        return start
    for families in kinds:
        sufficient: list[Fidelity] = []
        reached: Fidelity | None = None  # in the first family that suffices
        best = families[0].best
        if best is not None and errors.error(best) > errors.model_tolerance:
            ladder.append(_rung(errors, best, best))
            continue
        for kind in families:
            if reached:  # as many modes of another family are about as accurate, if not lumped
                path = [_alike(kind, reached if kind.start.lumped else sufficient[0])]
            elif best is None or _suffices(errors, replace(kind.start, counts=kind.most)):
                path = _refined(errors, kind)
            else:
                path = [replace(kind.start, counts=kind.most)]
            if _suffices(errors, path[-1]):
                reached = reached or path[-1]
                sufficient.append(_pruned(errors, path[-1]))
                path += sufficient[-1:] if sufficient[-1] != path[-1] else []
            ladder += [_rung(errors, f, best) for f in path if f != kind.start]
        if sufficient:
            return min(sufficient, key=errors.operations)
    last = ladder[-1]
    raise NoModel(
        f"No model is within {errors.model_tolerance:.3g} m of the reference; the last one tried, "
        f"'{last.description}', has an error of {last.error:.3g} m. Take a larger tolerance."
    )


def _alike(kind: _Kind, fidelity: Fidelity) -> Fidelity:
    """A kind's fidelity with the modes of another, as far as it may have them."""
    counts = tuple(
        tuple(map(min, own, most)) for own, most in zip(fidelity.counts, kind.most, strict=True)
    )
    return replace(kind.start, counts=counts, segments=fidelity.segments)


def _suffices(errors: ModelErrors, fidelity: Fidelity) -> bool:
    return errors.error(fidelity) <= errors.model_tolerance


def _refined(errors: ModelErrors, kind: _Kind) -> list[Fidelity]:
    """Models from the kind's start up to a sufficient one; each adds the change of largest gain."""
    path, gains = [kind.start], dict[Change, float]()
    while errors.error(path[-1]) > errors.model_tolerance:
        options = path[-1].refinements(kind.most, kind.most_segments)
        if not options:
            break
        new = [change for change in options if change not in gains]
        known = sorted((c for c in options if c in gains), key=lambda c: -gains[c])
        tried = new + known[:TRIALS]
        for change in tried:
            gains[change] = _gain(errors, path[-1], options[change])
        best = max(tried, key=lambda change: gains[change])
        together = path[-1].one_mode_more(kind.most)  # modes may help only together; pruned later
        alone = gains[best] > USELESS or together == path[-1]
        path.append(options[best] if alone else together)
    return path


def _gain(errors: ModelErrors, before: Fidelity, after: Fidelity) -> float:
    """Logarithm of the error ratio over the logarithm of the cost ratio."""
    far = 1e3 * errors.arm.reach
    limited = [min(max(errors.error(f), 1e-15), far) for f in (before, after)]
    work = errors.operations(after) / errors.operations(before)
    return math.log(limited[0] / limited[1]) / math.log(max(work, 1.01))


def _pruned(errors: ModelErrors, fidelity: Fidelity) -> Fidelity:
    """Remove modes and segments that the tolerance does not need, cheapest remainder first.

    The highest modes are first removed together. A removal that has failed once is not tried again
    on a smaller model.
    """
    needed: set[Change] = set()
    while not fidelity.rigid and _suffices(errors, fidelity.without_highest()):
        fidelity = fidelity.without_highest()
    while True:
        options = {c: f for c, f in fidelity.reductions().items() if c not in needed}
        for change in sorted(options, key=lambda c: errors.rollout(options[c]).estimate):
            if _suffices(errors, options[change]):
                fidelity = options[change]
                break
            needed.add(change)
        else:
            return fidelity


def _rung(errors: ModelErrors, fidelity: Fidelity, best: Fidelity | None) -> Rung:
    truncation = nonlinear = None
    if best is not None:
        nonlinear = errors.error(best)
        if nonlinear < math.inf:
            truncation = largest_distance(errors.tips(fidelity), errors.tips(best))
    return Rung(
        description=str(fidelity),
        error=errors.error(fidelity),
        truncation=truncation,
        nonlinear=nonlinear,
        operations=errors.operations(fidelity),
    )


@dataclass(frozen=True)
class _Step:
    """An integrator's largest sufficient step with a model."""

    model: Fidelity
    integrator: str
    dt: float  # [s]
    rung: Rung

    @property
    def cost(self) -> float:
        return math.inf if self.rung.cost is None else self.rung.cost


def _rival(errors: ModelErrors, sufficient: Fidelity) -> Fidelity | None:
    """The cheapest refinement with a larger step budget, if the sufficient model's is small.

    The refined model may be the cheaper one, because its steps may be longer.
    """
    budget = errors.step_budget(sufficient)
    if budget > SMALL_BUDGET * errors.tolerance:
        return None
    segmented = max(sufficient.segments) > 1
    segments = _most_segments(errors.arm) if segmented else sufficient.segments
    most = everything(errors.arm, MOST_MODES, 2)
    most = lumped(errors.arm, most) if sufficient.lumped else most
    options = sufficient.refinements(most, segments).values()
    rivals = [f for f in options if errors.step_budget(f) > LARGER_BUDGET * budget]
    return min(rivals, key=errors.operations, default=None)


def _steps(errors: ModelErrors, fidelity: Fidelity, cheapest: float = math.inf) -> Iterator[_Step]:
    """For each integrator the largest step within the budget, unless it exceeds `cheapest`."""
    arm = fidelity.arm(errors.arm)
    for name in usable(arm.n, arm.base.spatial):
        if INTEGRATORS[name].aid == "jacobian":
            continue  # it costs 3 (one link) to 19 (six links) evaluations: never the cheapest
        if INTEGRATORS[name].aid == "modes" and arm.n > MOST_FROZEN:
            continue
        dt, integration = _largest_step(errors, fidelity, name, cheapest)
        fits = integration <= errors.step_budget(fidelity)
        work = _cost(errors, fidelity, name, dt)
        cheapest = min(cheapest, work) if fits else cheapest
        rung = Rung(
            description=f"{name}, dt {dt:.4g} s",
            error=errors.error(fidelity) + integration,
            integration=integration,
            operations=errors.rollout(fidelity).method(name).operations,
            cost=work if fits else None,
        )
        yield _Step(fidelity, name, dt, rung)


def _largest_step(
    errors: ModelErrors, fidelity: Fidelity, integrator: str, cheapest: float
) -> tuple[float, float]:
    """Largest step [s] within the budget and its integration error [m].

    Steps shrink as the method's order predicts until one fits; a smaller one has to confirm it.
    The largest fitting step is then bracketed to the root of STEP_RATIO. Without such a step below
    the cost `cheapest`, the last step that was tried.
    """
    budget, rollout = errors.step_budget(fidelity), errors.rollout(fidelity)
    motions, method = errors.scene.motions, INTEGRATORS[integrator]
    found: dict[float, float] = {}  # step -> integration error

    def error(dt: float) -> float:
        if dt not in found:
            found[dt] = errors.integration(fidelity, integrator, dt)
        return found[dt]

    def near(dt: float) -> float:
        return max(rollout.step(motion, dt) for motion in motions)

    def finer(dt: float, ratio: float) -> float:
        while near(dt * ratio) > (1.0 - 1e-9) * dt:
            ratio /= STEP_RATIO
        return near(dt * ratio)

    fastest = max(rollout.fastest(motion) for motion in motions)
    shortest = min(motion.t_end for motion in motions)
    dt = shortest / (SAMPLES / STRIDES[0])
    if fastest:
        dt = min(dt, STABILITY_SHARE * method.limit / fastest)
    dt, bad = near(dt), math.inf
    while True:
        while max(error(dt), error(finer(dt, 1.0 / STEP_RATIO))) > budget:
            if error(dt) <= budget:  # by chance
                dt = finer(dt, 1.0 / STEP_RATIO)
            bad = dt
            if _cost(errors, fidelity, integrator, dt) > cheapest or shortest / dt > MOST_STEPS:
                return dt, error(dt)
            fall = (budget / error(dt)) ** (1.0 / method.order)
            dt = finer(dt, min(max(fall, LARGEST_FALL), 1.0 / STEP_RATIO))
        between = near(math.sqrt(dt * bad))
        if bad / dt <= STEP_RATIO**0.5 or between in found:
            return dt, error(dt)
        if error(between) <= budget:
            dt = between
        else:
            bad = between


def _cost(errors: ModelErrors, fidelity: Fidelity, integrator: str, dt: float) -> float:
    """Operations per simulated second, largest over the motions."""
    rollout = errors.rollout(fidelity)
    return max(rollout.cost(motion, integrator, dt) for motion in errors.scene.motions)


def _reason(errors: ModelErrors, chosen: Fidelity, best: Rung) -> str:
    simpler = [errors.error(f) for f in chosen.reductions().values() if errors.measured(f)]
    less = f"; the next simpler model errs by {metres(min(simpler))} m" if simpler else ""
    if simpler and min(simpler) <= errors.model_tolerance:
        less += ", and its shorter steps cost more"
    return (
        f"{str(chosen).capitalize()} with {best.description} keeps the tip within "
        f"{metres(best.error)} m of the reference, {errors.tolerance:.3g} m are allowed{less}."
    )
