"""Runs of all engines on the peers' scenes, over models, methods and steps."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial

import numpy as np

from benchmarks.peers import engines
from benchmarks.peers.lines import BATCH, BATCHED, ENGINES, OURS, Family, Point, Run, front, steady
from benchmarks.peers.models import OUR_SHAPES, compiled, our_run
from benchmarks.peers.scenes import PeerScene

RATES = (
    *(Fraction(1, k) for k in (10, 5, 4, 3, 2)),
    *(Fraction(k) for k in (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96)),
    *(Fraction(k) for k in (128, 256, 512)),
)
FEWEST = 40  # least number of tips compared
LONGEST = 0.4  # [s] longest processor time expected of a run
QUICK = 0.02  # [s] runs shorter than this are repeated without recording
ENOUGH = 0.3  # [s] processor time for timing one run
REPEATS = 5  # timings of every run near its engine's line
NEAR = 1.4  # runs within this factor of the fastest equally accurate run are timed repeatedly
BATCH_STEPS = 400  # a batch is timed over this many first steps at most: all steps cost the same


def families(scene: PeerScene, quick: bool) -> Iterator[Family]:
    """All models and methods of all engines on a scene."""
    for shapes in OUR_SHAPES[scene.name][: 2 if quick else None]:
        model = compiled(shapes.arm(scene))
        for integrator in shapes.methods:
            run = partial(our_run, scene, model, integrator)
            run(Fraction(1), False)  # compiles
            yield Family(OURS, str(shapes), integrator, run)
    for hinges in (4, 8) if quick else (2, 3, 4, 6, 8, 12, 16, 24, 32):
        for name in engines.MUJOCO_METHODS[: 1 if quick else None]:
            run = partial(engines.mujoco_chain, scene, hinges, name)
            yield Family("MuJoCo", f"{hinges} hinges per link", name, run)
    for name, method in list(engines.EXUDYN_METHODS.items())[: 1 if quick else None]:
        for hinges in (4,) if quick else (2, 3, 4, 6, 8, 12, 16):
            run = partial(exudyn_run, scene, partial(engines.tree, scene, hinges), method)
            yield Family("Exudyn, tree", f"{hinges} hinges per link", name, run)
        if method.explicit and len(scene.arm.links) > 1:
            continue  # two cables are joined by a constraint, which explicit methods lack
        for elements in (2, 4) if quick else (1, 2, 3, 4, 6, 8):
            for axial in (scene.axial, *scene.others)[-1 if quick else 0 :]:
                build = partial(engines.cable, scene, elements, axial, method.explicit)
                run = partial(exudyn_run, scene, build, method)
                size = f"{elements} elements per link, EA {axial:.3g} N"
                yield Family("Exudyn, cable", size, name, run)


def exudyn_run(
    scene: PeerScene,
    build: Callable[[], engines.System],
    method: engines.Method,
    rate: Fraction,
    record: bool,
) -> Run:
    """Run a newly built Exudyn system."""
    return engines.follow(build(), scene, method, rate, record)


def refine(scene: PeerScene, family: Family) -> list[Point]:
    """Run with ever smaller steps until the error no longer changes or a run takes too long."""
    points: list[Point] = []
    for rate in RATES:
        if not scene.allows(rate) or scene.rows <= FEWEST * rate.denominator:
            continue
        try:
            tips, seconds = family.run(rate, True)
            error = scene.error(tips, rate)
            if seconds < QUICK and error < math.inf:
                seconds = family.run(rate, False)[1]  # recording may take half the time
        except engines.Stopped:
            continue
        points.append(Point(family, rate, error, seconds / scene.motion.t_end))
        before = [p.error for p in points[-3:]]
        if 1.5 * seconds > LONGEST or (
            len(before) == 3 and before[0] < 1.0 and np.ptp(before) < 0.03 * error
        ):
            break
    return points


def timed(scene: PeerScene, point: Point) -> Point:
    """The point with the smallest of several processor times, measured without recording."""
    run = point.family.run
    return replace(point, cost=shortest(lambda: run(point.rate, False)[1]) / scene.motion.t_end)


def timed_in_batch(scene: PeerScene, point: Point) -> Point:
    """Our run per environment of a batch."""
    run: Callable[..., Run] = point.family.run
    seconds = shortest(lambda: run(point.rate, False, n_env=BATCH, most=BATCH_STEPS)[1])
    steps = min(BATCH_STEPS, round(scene.motion.t_end / scene.step(point.rate)))
    cost = seconds / BATCH / (steps * scene.step(point.rate))
    return replace(point, family=replace(point.family, engine=BATCHED), cost=cost)


def shortest(measure: Callable[[], float]) -> float:
    """The smallest of several processor times [s]."""
    times: list[float] = []
    while len(times) < 2 or (len(times) < REPEATS and sum(times) < ENOUGH):
        times.append(measure())
    return min(times)


def explore(scene: PeerScene, quick: bool) -> dict[str, list[Point]]:
    """All runs of every engine, each timed once."""
    points: dict[str, list[Point]] = {engine: [] for engine in ENGINES}
    for family in families(scene, quick):
        points[family.engine] += refine(scene, family)
    return points


def time_again(scene: PeerScene, points: dict[str, list[Point]]) -> dict[str, list[Point]]:
    """The runs with those near a line timed repeatedly, and flexarm's line in a batch."""
    result = {}
    for engine in ENGINES:
        runs = points[engine]
        near = front(runs, NEAR)
        for error, _, _ in scene.demands:
            near += front(steady(runs, error), NEAR)
            bent = [p for p in runs if p.family.model.endswith("foreshortened")]
            near += front(steady(bent, error), NEAR)
        careful = {(p.family, p.rate): timed(scene, p) for p in set(near)}
        result[engine] = [careful.get((p.family, p.rate), p) for p in runs]
        print(f"{scene.name}, {engine}: {len(runs)} runs", flush=True)
    return result | {BATCHED: [timed_in_batch(scene, p) for p in front(result[OURS])]}
