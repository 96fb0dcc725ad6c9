"""Runs of all engines on the peers' scenes, over models, methods and steps."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, partial
from itertools import groupby

import numpy as np

from benchmarks.output import REFERENCE
from benchmarks.peers import engines
from benchmarks.peers.lines import (
    BATCH,
    BATCHED,
    ENGINES,
    OURS,
    Family,
    Point,
    Run,
    front,
    steady,
)
from benchmarks.peers.scenes import SCENES, PeerScene
from dynamics import Arm, Mode, Model, Stepper, compile_arm
from dynamics.integrators.table import INTEGRATORS

RATES = (
    *(Fraction(1, k) for k in (10, 5, 4, 3, 2)),
    *(Fraction(k) for k in (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 256)),
)
FEWEST = 40  # least number of tips compared
LONGEST = 0.4  # [s] longest processor time expected of a run
QUICK = 0.02  # [s] runs shorter than this are repeated without recording
ENOUGH = 0.3  # [s] processor time for timing one run
REPEATS = 5  # timings of every run near its engine's line
NEAR = 1.4  # runs within this factor of the fastest equally accurate run are timed repeatedly


# ---- our line ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shapes:
    """Mode shapes of an arm: their kind and number per link."""

    kinds: tuple[str, ...]
    counts: tuple[int, ...]
    foreshortening: bool
    segments: int = 1

    def __str__(self) -> str:
        modes = ", ".join(f"{n} {kind}" for kind, n in zip(self.kinds, self.counts, strict=True))
        cut = f" in each of {self.segments} segments" if self.segments > 1 else ""
        return f"{modes}{cut}{', foreshortened' if self.foreshortening else ''}"

    def arm(self, arm: Arm) -> Arm:
        """The arm with these modes."""
        links = tuple(
            replace(
                link,
                segments=self.segments,
                modes=tuple(Mode(kind=kind, index=k + 1, direction="y") for k in range(count)),
            )
            for link, kind, count in zip(arm.links, self.kinds, self.counts, strict=True)
        )
        return replace(arm, links=links, foreshortening=self.foreshortening)


CUT = tuple(Shapes(("poly",), (2,), True, segments) for segments in (2, 4, 8))
OUR_SHAPES = {  # the first two make the quick form
    "S1": (
        Shapes(("clamped-tip-mass",), (2,), False),
        Shapes(("clamped-tip-mass",), (3,), True),
        *(Shapes(("clamped-tip-mass",), (n,), f) for n, f in ((1, False), (3, False), (4, False))),
        *(Shapes(("clamped-tip-mass",), (n,), True) for n in (2, 4)),
        *(Shapes(("clamped-free",), (n,), f) for n in (1, 2, 3, 4) for f in (False, True)),
        *CUT,
    ),
    "S3": (*(Shapes(("clamped-free",), (n,), True) for n in (1, 2, 3, 4)), *CUT),
    "korayem": (
        Shapes(("pinned-free", "pinned-free"), (2, 2), False),
        Shapes(("pinned-free", "clamped-free"), (2, 2), False),
        *(Shapes(("pinned-free", "pinned-free"), (n, n), True) for n in (2, 3, 4)),
        *(
            Shapes((inner, outer), counts, False)
            for inner in ("pinned-free", "clamped-free")
            for outer in ("pinned-free", "clamped-free")
            for counts in ((1, 1), (2, 2), (3, 3), (3, 2), (4, 4))
            if (inner, counts) != ("pinned-free", (2, 2))
        ),
    ),
}


@cache
def compiled(arm: Arm) -> Model:
    """The arm compiled, once per arm."""
    return compile_arm(arm)


def our_run(
    scene: PeerScene, model: Model, integrator: str, rate: Fraction, record: bool, n_env: int = 1
) -> Run:
    """Tips and processor time of a batch of equal environments; each call has constant torque."""
    stepper = Stepper(model, n_env, dt=scene.step(rate), substeps=1, integrator=integrator)
    stepper.q[:, list(model.arm.joint_index)] = scene.motion.joint_angles
    torques = scene.torques(rate)
    ends = np.arange(torques.size) // rate.numerator if record else np.zeros(torques.size)
    calls = [
        (torque, len(list(group)))
        for (torque, _), group in groupby(zip(torques.tolist(), ends.tolist(), strict=True))
    ]
    tips, done, where = [], 0, model.measurements["tip"]
    begin = time.process_time()
    for torque, count in calls:
        stepper.torque[:, 0], stepper.substeps = torque, count
        stepper.advance()
        if record:
            done += count
            if done % rate.numerator == 0:
                tip = stepper.measured[0, where][:2]
                tips.append(np.full(2, np.nan) if stepper.status[0] else tip.copy())
    return np.array(tips).reshape(-1, 2), time.process_time() - begin


# ---- all engines ---------------------------------------------------------------------------------


def families(scene: PeerScene, quick: bool) -> Iterator[Family]:
    """All models and methods of all engines on a scene."""
    for shapes in OUR_SHAPES[scene.name][: 2 if quick else None]:
        model = compiled(shapes.arm(scene.arm))
        for integrator in INTEGRATORS:
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
        for elements in (2, 4) if quick else (1, 2, 3, 4, 6):
            for axial in (scene.axial, *scene.softer)[-1 if quick else 0 :]:
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


def timed(scene: PeerScene, point: Point, n_env: int = 1) -> Point:
    """The point with the smallest of several processor times, measured without recording."""
    run: Callable[..., Run] = point.family.run
    family = point.family
    if n_env > 1:
        run = partial(run, n_env=n_env)
        family = replace(family, engine=BATCHED)
    times: list[float] = []
    while len(times) < 2 or (len(times) < REPEATS and sum(times) < ENOUGH):
        times.append(run(point.rate, False)[1])
    return replace(point, family=family, cost=min(times) / n_env / scene.motion.t_end)


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
    return result | {BATCHED: [timed(scene, p, BATCH) for p in front(result[OURS])]}


def make_truth() -> None:
    """Write the truth of the two links: chains of 16 and 32 hinges (MuJoCo, RK4), extrapolated."""
    scene = SCENES["korayem"]
    coarse, _ = engines.mujoco_chain(scene, 16, "RK4", Fraction(160))
    fine, _ = engines.mujoco_chain(scene, 32, "RK4", Fraction(640))
    apart = np.linalg.norm(fine - coarse, axis=1).max() / 3.0 / scene.arm.reach
    tips = np.vstack([scene.start, fine + (fine - coarse) / 3.0])
    rows = np.column_stack([scene.interval * np.arange(scene.rows), tips])
    head = (
        "Two-link arm of Korayem and Shafei (2009), released at -90 and 5 degrees: chains of 16 "
        "and 32 hinges per link\n(MuJoCo, RK4) extrapolated to infinitely many, by "
        f"`python -m benchmarks.peers --truth`; the extrapolation moved the tip by {apart:.1g} of "
        "the length.\nt,tip_x,tip_y"
    )
    np.savetxt(REFERENCE / "korayem_nonlinear_beam.csv", rows, "%.12g", ",", header=head)
