"""Tip error against CPU time: every integrator, step, number of modes, foreshortening, segments.

    python -m benchmarks.work_precision [--quick] [--only NAME ...] [--out FILE] [--images FOLDER]
    python -m benchmarks.work_precision --redraw | --truth [--only NAME ...]

CPU time is that of one environment in a batch of 1024 on one thread, calls and measurements
included, per simulated second. Errors are the largest distance of the tip over the motion, in
parts of the reach: of a run from the converged integration of its own model (integration), of that
from the truth (model). Their sum is what a run is charted and chosen by, for they may cancel by
luck; the distance of the run itself from the truth (total) is kept beside it. Every model is
followed by the method of highest order; the others follow those models that no cheaper one
betters, and the default.
`--truth` makes the truths in tests/reference/ again, which takes many minutes.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import RESULTS, provenance
from benchmarks.work_precision import charts as precision_charts
from benchmarks.work_precision.scenes import GOOD, SETTINGS, Level, Setting
from dynamics import Arm, Diverged, Model, Stepper, compile_arm, simulate
from dynamics.backends.numba_llvm.methods import LONGEST
from dynamics.integrators.table import INTEGRATORS
from dynamics.tracing import graphs
from dynamics.tracing.ssa import operations
from dynamics.types import Array
from flexarm_env.accuracy.certificates import stored
from flexarm_env.accuracy.timing import cpu_seconds
from flexarm_env.core import Core

BATCH = 1024  # environments per timed call
LONG = 17  # substeps of the longer of two timed calls
ACCURATE = max(INTEGRATORS, key=lambda name: INTEGRATORS[name].order)
SETTLED = 1e-8  # of the reach: what halving the reference's step may still change
ENOUGH = 1e-7  # of the reach: integration errors below are not pursued
MOST_STEPS = 2**20  # per motion of a reference
MOST_SECONDS = 0.01  # of CPU time per simulated second; dearer steps are not taken
MOST_CALLS = 2**14  # per motion under a torque that varies
FAR = 2.0  # of the reach: a tip farther off has diverged
SUBSTEPS = tuple(round(2 ** (k / 2)) for k in range(1, 40))
SCIPY = ("dop853", "bdf")
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-8)
Row = dict[str, Any]
Compile = Callable[[list[tuple[Arm, str]]], None]


@dataclass(frozen=True)
class Step:
    """`substeps` per `stride` output times."""

    stride: int
    substeps: int

    def dt(self, setting: Setting) -> float:
        """Its length [s]."""
        return setting.period * self.stride / self.substeps


@dataclass(frozen=True)
class Cost:
    """CPU time of one environment in a batch [s]: per call, and per step inside it."""

    call: float
    step: float

    def per_second(self, setting: Setting, step: Step) -> float:
        """CPU time per simulated second [-]; a torque that varies needs a call per step."""
        calls = 1 if setting.held else step.substeps
        period = setting.period * step.stride
        return (calls * self.call + step.substeps * self.step) / period


# ---- runs ----------------------------------------------------------------------------------------


def follow(
    model: Model, setting: Setting, integrator: str, step: Step, n_env: int = 2
) -> Array | None:
    """(N, 3) [m] tip at every `stride`-th output time; None where it diverges.

    Two environments take the many-lane code. A torque that varies is held at its value in mid-step.
    """
    times, dt = setting.times[:: step.stride], step.dt(setting)
    calls = 1 if setting.held else step.substeps
    stepper = Stepper(model, n_env, dt=dt, substeps=step.substeps // calls, integrator=integrator)
    stepper.q[:], stepper.v[:] = setting.start(model)
    tip, torque = model.measurements["tip"], setting.motion.torque
    tips = np.empty((times.size, 3))
    tips[0] = model.tip(stepper.q[0])
    for k, begin in enumerate(times[:-1], 1):
        for call in range(calls):
            if torque is not None:
                stepper.torque[:] = torque(begin + (call + 0.5) * dt)
            stepper.advance()
            if stepper.status[0]:
                return None
        tips[k] = stepper.measured[0, tip]
        if np.abs(tips[k]).max() > FAR * setting.arm.reach:
            return None
    return tips


def settled(model: Model, setting: Setting, n_env: int = 2) -> tuple[Array | None, float]:
    """Tips free of integration error, and what the last halving changed [of the reach]."""
    q, _ = setting.start(model)
    fastest = float(model.frequencies(q, joints="free").max(initial=0.0))
    substeps = max(2, math.ceil(setting.period * fastest))
    before, change = None, math.inf
    while substeps * setting.times.size < MOST_STEPS:
        tips = follow(model, setting, ACCURATE, Step(1, substeps), n_env)
        change = apart(tips, before, setting)
        if change <= SETTLED:
            return tips, change
        before, substeps = tips, 2 * substeps
    return before, change


def apart(a: Array | None, b: Array | None, setting: Setting) -> float:
    """Largest distance of two tips, in parts of the reach; infinite where one diverged."""
    if a is None or b is None:
        return math.inf
    return float(np.linalg.norm(a - b, axis=1).max()) / setting.arm.reach


def costs(
    models: dict[str, Model], setting: Setting, pairs: list[tuple[str, str]]
) -> dict[tuple[str, str], Cost]:
    """Of models by methods, on batches at the start of the motion, too short to leave it."""
    calls = {}
    for name, integrator in pairs:
        for substeps in (1, LONG):
            stepper = Stepper(
                models[name], BATCH, dt=1e-7, substeps=substeps, integrator=integrator
            )
            stepper.q[:], stepper.v[:] = setting.start(models[name])
            calls[name, integrator, substeps] = stepper.advance
    seconds = {key: t / BATCH for key, t in cpu_seconds(calls).items()}
    result = {}
    for pair in pairs:
        one, many = seconds[*pair, 1], seconds[*pair, LONG]
        step = max((many - one) / (LONG - 1), 1e-12)
        result[pair] = Cost(max(one - step, 0.0), step)
    return result


# ---- points --------------------------------------------------------------------------------------


def sweep(
    model: Model,
    setting: Setting,
    integrator: str,
    price: Cost,
    exact: Array | None,
    more: Step | None,
) -> Iterator[Row]:
    """One integrator from its longest step to where its error or its cost no longer matters."""
    steps = {*(Step(k, 1) for k in setting.strides), *(Step(1, k) for k in SUBSTEPS)}
    steps |= {more} if more is not None else set()
    done = False
    for step in sorted(steps, key=lambda step: -step.dt(setting)):
        work = price.per_second(setting, step)
        many = not setting.held and setting.times.size * step.substeps > MOST_CALLS
        if (done or many or work > MOST_SECONDS) and step != more:
            continue
        tips = follow(model, setting, integrator, step)
        error = apart(tips, None if exact is None else exact[:: step.stride], setting)
        done = done or error <= ENOUGH
        yield {
            "integrator": integrator, "stride": step.stride, "substeps": step.substeps,
            "dt": step.dt(setting), "cpu": work, "integration": error,
            "total": apart(tips, setting.truth[:: step.stride], setting),
            "default": step == more,
        }  # fmt: skip


def scipy_points(model: Model, setting: Setting, exact: Array | None) -> Iterator[Row]:
    """SciPy's methods with error control: one environment, driven from Python."""
    q, v = setting.start(model)
    torque, times = setting.motion.torque, setting.times
    simulate(model, q, v, torque, times[:2], integrator=SCIPY[0])  # compiles what is timed below
    for name in SCIPY:
        for rtol in TOLERANCES:
            begin = time.process_time()
            try:
                tips: Array | None = simulate(
                    model, q, v, torque, times, integrator=name, rtol=rtol
                ).tip
            except Diverged:
                tips = None
            except ValueError:
                break  # a method that this version does not have
            work = (time.process_time() - begin) / setting.motion.t_end
            yield {
                "integrator": name, "rtol": rtol, "cpu": work,
                "integration": apart(tips, exact, setting),
                "total": apart(tips, setting.truth, setting), "default": False,
            }  # fmt: skip


def default_of(setting: Setting) -> tuple[str, Step]:
    """Integrator and step that an environment of this arm, damped as it is, takes."""
    entry = stored().get(setting.arm.name)
    if entry is not None and entry["control_dt"] == setting.period:
        best = entry["steps"][0]
        return best["integrator"], Step(1, best["substeps"])
    core = Core(task="Reach", arm=setting.arm, control_dt=setting.period)
    return core.integrator, Step(1, core.substeps)


def models_of(setting: Setting) -> tuple[str, dict[str, Arm]]:
    """The default model's name, and all models by name."""
    arms = {str(level): level.arm(setting.arm) for level in setting.levels}
    default = next((name for name, arm in arms.items() if arm == setting.arm), "default")
    return default, {**arms, default: setting.arm}


def measured(setting: Setting, compile_all: Compile) -> dict[str, Any]:
    """All points of one scene."""
    integrator, step = default_of(setting)
    default, arms = models_of(setting)
    models = {name: compile_arm(arm) for name, arm in arms.items()}
    exact = {name: settled(model, setting) for name, model in models.items()}
    rows = {
        name: {
            "coordinates": model.n,
            "operations": sum(operations(model.graph).values()),
            "model error": apart(exact[name][0], setting.truth, setting),
            "residual": exact[name][1],
        }
        for name, model in models.items()
    }
    best = {name for name in rows if not bettered(name, rows)} | {default}
    pairs = [
        (name, method)
        for name in models
        for method in (INTEGRATORS if name in best else (ACCURATE,))
        if compiles(models[name], method)
    ]
    compile_all([(arms[name], method) for name, method in pairs])
    prices = costs(models, setting, pairs)
    points: list[Row] = []
    for name, method in pairs:
        more = step if (name, method) == (default, integrator) else None
        price, truth = prices[name, method], exact[name][0]
        found = sweep(models[name], setting, method, price, truth, more)
        points += [{"model": name, **row} for row in found]
    others = scipy_points(models[default], setting, exact[default][0])
    points += [{"model": default, **row} for row in others]
    for point in points:
        point["error"] = rows[point["model"]]["model error"] + point["integration"]
    return {
        "title": setting.title, "reach [m]": setting.arm.reach, "floor": setting.floor,
        "default": {"model": default, "integrator": integrator, "dt": step.dt(setting)},
        "models": rows, "points": points, "front": front(points),
    }  # fmt: skip


def bettered(name: str, rows: dict[str, Row]) -> bool:
    """Whether a model of no more operations is nearer to the truth."""
    mine = rows[name]
    return not mine["model error"] < math.inf or any(
        row["operations"] <= mine["operations"] and row["model error"] < mine["model error"]
        for other, row in rows.items()
        if other != name
    )


def compile_one(program: tuple[Arm, str]) -> None:
    """Compile, or find compiled, one arm for one integrator, many lanes."""
    arm, integrator = program
    Stepper(compile_arm(arm), 2, dt=1e-7, substeps=1, integrator=integrator).advance()


def compiles(model: Model, method: str) -> bool:
    """Whether the method's code for this model is short enough."""
    if INTEGRATORS[method].aid != "jacobian":
        return True
    return bool(graphs.state_jacobian(model.traced).n_instructions() <= LONGEST)


def front(points: list[Row]) -> list[Row]:
    """The Pareto line: points in order of cost, each of a smaller error than all before."""
    line: list[Row] = []
    for point in sorted(points, key=lambda p: (p["cpu"], p["error"])):
        if point["error"] < (line[-1]["error"] if line else math.inf):
            line.append(point)
    return line


# ---- truth and main ------------------------------------------------------------------------------


def make_truth(setting: Setting) -> None:
    """Write the tip of the finer of two models, and how far refining moved it."""
    models = [compile_arm(level.arm(setting.arm)) for level in setting.refined]
    tips = [settled(model, setting, 1)[0] for model in models]
    change = apart(tips[0], tips[1], setting)
    if tips[1] is None or not change < math.inf:
        raise RuntimeError(f"No truth for {setting.title!r}: {setting.refined} diverge.")
    head = f"# Tip of {setting.refined[1]} per link, from {setting.refined[0]}.\n"
    head += f"# {GOOD} {change:.1e} of the reach, by which the last refinement moved it.\n"
    rows = np.column_stack([setting.times, tips[1]]).tolist()
    text = "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows)
    setting.file.write_text(f"{head}t,tip_x,tip_y,tip_z\n{text}\n")
    print(f"{setting.title}\n{head}", end="", flush=True)


def main() -> None:
    """Measure all scenes, write JSON, a table and the charts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one scene, three models")
    parser.add_argument("--truth", action="store_true", help="make the truths again, nothing else")
    parser.add_argument("--redraw", action="store_true", help="charts of stored results, no runs")
    parser.add_argument("--only", nargs="+", choices=list(SETTINGS), default=list(SETTINGS))
    parser.add_argument("--jobs", type=int, default=2, help="processes that compile")
    parser.add_argument("--out", type=Path, default=RESULTS / "work_precision.json")
    parser.add_argument("--images", type=Path, default=RESULTS)
    options = parser.parse_args()
    chosen = [SETTINGS[name] for name in options.only]
    if options.truth:
        for setting in chosen:
            if setting.refined:
                make_truth(setting)
        return
    if options.redraw:
        text = options.out.read_text().replace('"diverged"', "Infinity")
        precision_charts.draw(json.loads(text), options.images)
        return
    results = quick() if options.quick else run(chosen, options.jobs)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.images.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(plain(results)) + "\n")
    text = precision_charts.table(results)
    options.out.with_suffix(".md").write_text(text)
    print(text)
    precision_charts.draw(results, options.images)


def quick() -> dict[str, Any]:
    """A short form: one scene, three models."""
    levels = tuple(Level(modes=m) for m in (0, 1, 2))
    return run([replace(SETTINGS["S1"], levels=levels)])


def run(settings: list[Setting], jobs: int = 1) -> dict[str, Any]:
    """Results of all these scenes, each with its Pareto line; `jobs` processes compile."""
    origin = provenance("numpy", "scipy", "numba", "casadi")
    results: dict[str, Any] = {**origin, "batch": BATCH, "scenes": {}}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:

        def compile_all(programs: list[tuple[Arm, str]]) -> None:
            if jobs > 1:
                list(pool.map(compile_one, programs))

        arms = [arm for s in settings for arm in models_of(s)[1].values()]
        compile_all([(arm, ACCURATE) for arm in arms])
        for setting in settings:
            begin = time.perf_counter()
            scene = measured(setting, compile_all)
            results["scenes"][setting.name] = scene
            seconds = time.perf_counter() - begin
            print(f"{setting.title}: {len(scene['points'])} runs, {seconds:.0f} s", flush=True)
    return results


def plain(value: Any) -> Any:
    """Numbers of four digits, and "diverged" for those that JSON does not know."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else "diverged"
    return value


if __name__ == "__main__":
    main()
