"""Our line beside Exudyn and MuJoCo: tip error against processor time, in one process.

    python -m benchmarks.peers [--quick] [--out FILE] [--images FOLDER] [--truth]

Every engine follows the same scenes with many models, methods and steps; its cheapest at each error
make its line. `--quick` takes fewer of them; `--truth` makes the third scene's truth again.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, partial
from itertools import groupby
from pathlib import Path

import numpy as np

from benchmarks.output import REFERENCE, RESULTS, provenance, save_results
from benchmarks.peers import engines as peers
from benchmarks.peers.lines import (
    BATCH,
    BATCHED,
    ENGINES,
    OURS,
    Family,
    Point,
    Run,
    bests,
    comparisons,
    draw,
    front,
    steady,
    table,
)
from benchmarks.peers.scenes import SCENES, PeerScene
from dynamics import Arm, Mode, Model, Stepper, compile_arm
from dynamics.integrators.table import INTEGRATORS

RATES = (
    *(Fraction(1, k) for k in (10, 5, 4, 3, 2)),
    *(Fraction(k) for k in (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 256)),
)
FEWEST = 40  # tips compared, at least
LONGEST = 0.4  # [s] of processor time that a run may be expected to take
QUICK = 0.02  # [s] of processor time that may be spent twice
ENOUGH = 0.3  # [s] of processor time for timing one run
REPEATS = 5  # of every run near its engine's line
NEAR = 1.4  # times as slow as the fastest that errs as little: worth timing carefully


# ---- our line ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shapes:
    """Shapes of every link: the same kind and number, unless one per link is given."""

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
    """One model of each arm."""
    return compile_arm(arm)


def our_run(
    scene: PeerScene, model: Model, integrator: str, rate: Fraction, record: bool, n_env: int = 1
) -> Run:
    """Tips and processor time of a batch of equal environments; a call holds one torque."""
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
    """Everything that competes on a scene."""
    for shapes in OUR_SHAPES[scene.name][: 2 if quick else None]:
        model = compiled(shapes.arm(scene.arm))
        for integrator in INTEGRATORS:
            run = partial(our_run, scene, model, integrator)
            run(Fraction(1), False)  # compiles
            yield Family(OURS, str(shapes), integrator, run)
    for hinges in (4, 8) if quick else (2, 3, 4, 6, 8, 12, 16, 24, 32):
        for name in peers.MUJOCO_METHODS[: 1 if quick else None]:
            run = partial(peers.mujoco_chain, scene, hinges, name)
            yield Family("MuJoCo", f"{hinges} hinges per link", name, run)
    for name, method in list(peers.EXUDYN_METHODS.items())[: 1 if quick else None]:
        for hinges in (4,) if quick else (2, 3, 4, 6, 8, 12, 16):
            run = partial(exudyn_run, scene, partial(peers.tree, scene, hinges), method)
            yield Family("Exudyn, tree", f"{hinges} hinges per link", name, run)
        if method.explicit and len(scene.arm.links) > 1:
            continue  # two cables meet in a constraint
        for elements in (2, 4) if quick else (1, 2, 3, 4, 6):
            for axial in (scene.axial, *scene.softer)[-1 if quick else 0 :]:
                build = partial(peers.cable, scene, elements, axial, method.explicit)
                run = partial(exudyn_run, scene, build, method)
                size = f"{elements} elements per link, EA {axial:.3g} N"
                yield Family("Exudyn, cable", size, name, run)


def exudyn_run(
    scene: PeerScene,
    build: Callable[[], peers.System],
    method: peers.Method,
    rate: Fraction,
    record: bool,
) -> Run:
    """One run of a newly built system."""
    return peers.follow(build(), scene, method, rate, record)


def refine(scene: PeerScene, family: Family) -> list[Point]:
    """Ever smaller steps until they no longer change the error, or take too long."""
    points: list[Point] = []
    for rate in RATES:
        if not scene.allows(rate) or scene.rows <= FEWEST * rate.denominator:
            continue
        try:
            tips, seconds = family.run(rate, True)
            error = scene.error(tips, rate)
            if seconds < QUICK and error < math.inf:
                seconds = family.run(rate, False)[1]  # recording may have been half of it
        except peers.Stopped:
            continue
        points.append(Point(family, rate, error, seconds / scene.motion.t_end))
        before = [p.error for p in points[-3:]]
        if 1.5 * seconds > LONGEST or (
            len(before) == 3 and before[0] < 1.0 and np.ptp(before) < 0.03 * error
        ):
            break
    return points


def timed(scene: PeerScene, point: Point, n_env: int = 1) -> Point:
    """The point with the least of several processor times, nothing recorded on the way."""
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
    """Engine -> all its runs, each timed once."""
    points: dict[str, list[Point]] = {engine: [] for engine in ENGINES}
    for family in families(scene, quick):
        points[family.engine] += refine(scene, family)
    return points


def time_again(scene: PeerScene, points: dict[str, list[Point]]) -> dict[str, list[Point]]:
    """The same with those near any line timed carefully, and our line's in a batch."""
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
    """Two links as chains of 16 and 32 hinges under RK4 in MuJoCo, extrapolated to none."""
    scene = SCENES["korayem"]
    coarse, _ = peers.mujoco_chain(scene, 16, "RK4", Fraction(160))
    fine, _ = peers.mujoco_chain(scene, 32, "RK4", Fraction(640))
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


def main() -> None:
    """Follow all scenes with all engines; write JSON, a page and the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few models and methods")
    parser.add_argument("--out", type=Path, default=RESULTS / "peers.json")
    parser.add_argument("--images", type=Path, default=RESULTS)
    parser.add_argument("--truth", action="store_true", help="make the third scene's truth again")
    options = parser.parse_args()
    if options.truth:
        make_truth()
    results = provenance("exudyn", "mujoco", "numba", "numpy")  # of the code that now runs
    everything = {
        name: time_again(scene, explore(scene, options.quick)) for name, scene in SCENES.items()
    }
    results |= {
        "comparisons": [
            row for name, points in everything.items() for row in comparisons(SCENES[name], points)
        ],
        "scenes": {
            name: {
                "title": SCENES[name].title,
                "best": bests(SCENES[name], points),
                "lines": {
                    engine: [p.to_dict(SCENES[name]) for p in front(runs)]
                    for engine, runs in points.items()
                },
            }
            for name, points in everything.items()
        },
    }
    text = table(results)
    print(text)
    options.images.mkdir(parents=True, exist_ok=True)
    save_results(results, text, options.out)
    draw(everything, options.images / "peers")


if __name__ == "__main__":
    main()
