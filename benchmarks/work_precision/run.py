"""Tip error against CPU time over integrators, steps, modes, foreshortening and segments.

    python -m benchmarks.work_precision [--quick] [--only NAME ...] [--out FILE] [--images FOLDER]
    python -m benchmarks.work_precision --charts | --truth [--only NAME ...]

CPU time is per simulated second of one environment in a batch of 1024 on one thread, including
calls and measurements. Errors are the largest tip distance over the motion, divided by the reach:
the integration error is that of a run from the converged integration of its own model, the model
error is that of the converged integration from the truth. Runs are charted and chosen by the sum of
both, because the two may cancel by chance; the total error, that of the run from the truth, is
stored too. The method of highest order runs on every model; the other methods run on the default
model and on each model that is more accurate than all cheaper ones.
`--only` keeps the stored results of the other scenes. `--truth` recomputes the truths in
tests/reference/, which takes many minutes. `--charts` draws the stored results, with
the peers' lines of docs/results/peers.json, and writes their table.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.signals import workers
from benchmarks.output import RESULTS, argument_parser, count, provenance
from benchmarks.work_precision.charts import draw, page, store, stored_results
from benchmarks.work_precision.scenes import GOOD, SETTINGS, Level, Setting
from dynamics import Arm, Diverged, Model, Stepper, compile_arm, simulate
from dynamics.integrators.table import INTEGRATORS
from dynamics.tracing import graphs
from dynamics.tracing.method import LONGEST
from dynamics.tracing.operation_counts import operations
from dynamics.types import Array
from flexarm_env.accuracy.certificates import stored
from flexarm_env.accuracy.timing import cpu_seconds
from flexarm_env.core import Core

BATCH = 1024  # environments per timed call
LONG = 17  # substeps of the longer of the two timed calls
ACCURATE = max(INTEGRATORS, key=lambda name: INTEGRATORS[name].order)
CONVERGED = 1e-8  # [reach] a reference is converged if halving its step changes it by less
ENOUGH = 1e-7  # [reach] steps are refined until the integration error is below this
MOST_STEPS = 2**20  # per motion of a reference
MOST_SECONDS = 0.01  # of CPU time per simulated second; more expensive steps are skipped
MOST_CALLS = 2**14  # per motion under a torque that varies between output times
FAR = 2.0  # [reach] a motion whose tip is farther from the base has diverged
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
        """Length of the step [s]."""
        return setting.period * self.stride / self.substeps


@dataclass(frozen=True)
class Cost:
    """CPU time of one environment in a batch [s]: per call, and per step in a call."""

    call: float
    step: float

    def per_second(self, setting: Setting, step: Step) -> float:
        """CPU time per simulated second [-]; a varying torque needs a call per step."""
        calls = 1 if setting.constant_torque else step.substeps
        period = setting.period * step.stride
        return (calls * self.call + step.substeps * self.step) / period


# ---- runs ----------------------------------------------------------------------------------------


def follow(
    model: Model, setting: Setting, integrator: str, step: Step, n_env: int = 2
) -> Array | None:
    """(N, 3) [m] tip at every `stride`-th output time; None if the motion diverges.

    With two environments or more the many-lane code runs. A varying torque is constant over a step,
    at its value in the middle.
    """
    times, dt = setting.times[:: step.stride], step.dt(setting)
    calls = 1 if setting.constant_torque else step.substeps
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


def converged(model: Model, setting: Setting, n_env: int = 2) -> tuple[Array | None, float]:
    """Tips by a converged integration, and their change by the last halving of the step [reach]."""
    q, _ = setting.start(model)
    fastest = float(model.frequencies(q, joints="free").max(initial=0.0))
    substeps = max(2, math.ceil(setting.period * fastest))
    before, change = None, math.inf
    while substeps * setting.times.size < MOST_STEPS:
        tips = follow(model, setting, ACCURATE, Step(1, substeps), n_env)
        change = apart(tips, before, setting)
        if change <= CONVERGED:
            return tips, change
        before, substeps = tips, 2 * substeps
    return before, change


def apart(a: Array | None, b: Array | None, setting: Setting) -> float:
    """Largest distance of two tips over the reach [-]; infinite if a motion diverged."""
    if a is None or b is None:
        return math.inf
    return float(np.linalg.norm(a - b, axis=1).max()) / setting.arm.reach


def costs(
    models: dict[str, Model], setting: Setting, pairs: list[tuple[str, str]]
) -> dict[tuple[str, str], Cost]:
    """Costs of (model, method) pairs, timed on batches that stay near the start of the motion."""
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
    default_step: Step | None,
) -> Iterator[Row]:
    """Runs of one integrator from its longest step down to the limit on error or cost.

    The step `default_step`, if any, is always run.
    """
    steps = {*(Step(k, 1) for k in setting.strides), *(Step(1, k) for k in SUBSTEPS)}
    steps |= {default_step} if default_step is not None else set()
    done = False
    for step in sorted(steps, key=lambda step: -step.dt(setting)):
        work = price.per_second(setting, step)
        calls = 0 if setting.constant_torque else setting.times.size * step.substeps
        if (done or calls > MOST_CALLS or work > MOST_SECONDS) and step != default_step:
            continue
        tips = follow(model, setting, integrator, step)
        error = apart(tips, None if exact is None else exact[:: step.stride], setting)
        done = done or error <= ENOUGH
        yield {
            "integrator": integrator, "stride": step.stride, "substeps": step.substeps,
            "dt": step.dt(setting), "cpu": work, "integration": error,
            "total": apart(tips, setting.truth[:: step.stride], setting),
            "default": step == default_step,
        }  # fmt: skip


def scipy_points(model: Model, setting: Setting, exact: Array | None) -> Iterator[Row]:
    """Runs of SciPy's methods with error control: one environment, called from Python."""
    q, v = setting.start(model)
    torque, times = setting.motion.torque, setting.times
    simulate(model, q, v, torque, times[:2], integrator=SCIPY[0])  # compiles before timing
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
                break  # this version lacks the method
            work = (time.process_time() - begin) / setting.motion.t_end
            yield {
                "integrator": name, "rtol": rtol, "cpu": work,
                "integration": apart(tips, exact, setting),
                "total": apart(tips, setting.truth, setting), "default": False,
            }  # fmt: skip


def default_of(setting: Setting) -> tuple[str, Step]:
    """Integrator and step of an environment with this arm."""
    entry = stored().get(setting.arm.name)
    if entry is not None and entry["control_dt"] == setting.period:
        best = entry["measured"][0]["steps"][0]
        return best["integrator"], Step(1, best["substeps"])
    core = Core(task="Reach", arm=setting.arm, control_dt=setting.period)
    return core.integrator, Step(1, core.substeps)


def models_of(setting: Setting) -> tuple[str, dict[str, Arm]]:
    """Name of the default model, and all models by name."""
    arms = {str(level): level.arm(setting.arm) for level in setting.levels}
    default = next((name for name, arm in arms.items() if arm == setting.arm), "default")
    return default, {**arms, default: setting.arm}


def measured(setting: Setting, compile_all: Compile) -> dict[str, Any]:
    """Models, runs and Pareto line of one scene."""
    integrator, step = default_of(setting)
    default, arms = models_of(setting)
    models = {name: compile_arm(arm) for name, arm in arms.items()}
    exact = {name: converged(model, setting) for name, model in models.items()}
    rows = {
        name: {
            "coordinates": model.n,
            "operations": sum(operations(model.graph).values()),
            "model error": apart(exact[name][0], setting.truth, setting),
            "residual": exact[name][1],
        }
        for name, model in models.items()
    }
    best = {name for name in rows if not dominated(name, rows)} | {default}
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
        default_step = step if (name, method) == (default, integrator) else None
        price, reference = prices[name, method], exact[name][0]
        found = sweep(models[name], setting, method, price, reference, default_step)
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


def dominated(name: str, rows: dict[str, Row]) -> bool:
    """True if another model is more accurate with no more operations, or this one diverges."""
    own = rows[name]
    return not own["model error"] < math.inf or any(
        row["operations"] <= own["operations"] and row["model error"] < own["model error"]
        for other, row in rows.items()
        if other != name
    )


def compile_one(program: tuple[Arm, str]) -> None:
    """Compile the many-lane code of one arm for one integrator, unless it is cached."""
    arm, integrator = program
    Stepper(compile_arm(arm), 2, dt=1e-7, substeps=1, integrator=integrator).advance()


def compiles(model: Model, method: str) -> bool:
    """True if the method's code for this model is short enough to compile."""
    if INTEGRATORS[method].aid != "jacobian":
        return True
    return bool(graphs.state_jacobian(model.traced).n_instructions() <= LONGEST)


def front(points: list[Row]) -> list[Row]:
    """The Pareto line: points by increasing cost, each with a smaller error than all before."""
    line: list[Row] = []
    for point in sorted(points, key=lambda p: (p["cpu"], p["error"])):
        if point["error"] < (line[-1]["error"] if line else math.inf):
            line.append(point)
    return line


# ---- truth and main ------------------------------------------------------------------------------


def make_truth(setting: Setting) -> None:
    """Write the tip of the finer of two models, and its distance from that of the other."""
    models = [compile_arm(level.arm(setting.arm)) for level in setting.refined]
    tips = [converged(model, setting, 1)[0] for model in models]
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
    """Measure all scenes, write packed JSON, a table and the charts."""
    parser = argument_parser("work_precision", __doc__, "work_precision.json.bz2")
    parser.add_argument("--quick", action="store_true", help="one scene, three models")
    parser.add_argument("--truth", action="store_true", help="only recompute the truths")
    parser.add_argument(
        "--charts", action="store_true", help="only draw and list the stored results"
    )
    parser.add_argument("--only", nargs="+", choices=list(SETTINGS), default=list(SETTINGS))
    parser.add_argument("--jobs", type=count, default=2, help="number of compiling processes")
    parser.add_argument("--images", type=Path, default=RESULTS)
    options = parser.parse_args()
    chosen = [SETTINGS[name] for name in options.only]
    if options.truth:
        for setting in chosen:
            if setting.refined:
                make_truth(setting)
        return
    if not options.charts:
        results = quick() if options.quick else run(chosen, options.jobs)
        if len(chosen) < len(SETTINGS) and options.out.exists():
            results["scenes"] = stored_results(options.out)["scenes"] | results["scenes"]
        store(plain(results), options.out)
    results = stored_results(options.out)
    options.images.mkdir(parents=True, exist_ok=True)
    text = page(results)
    options.out.with_name(f"{options.out.name.split('.')[0]}.md").write_text(text)
    print(text)
    draw(results, options.images)


def quick() -> dict[str, Any]:
    """Results of the short form: one scene, three models."""
    levels = tuple(Level(modes=m) for m in (0, 1, 2))
    return run([replace(SETTINGS["S1"], levels=levels)])


def run(settings: list[Setting], jobs: int = 1) -> dict[str, Any]:
    """Results of the scenes, compiled by `jobs` processes."""
    origin = provenance("numpy", "scipy", "numba", "casadi")
    results: dict[str, Any] = {"batch": BATCH, "scenes": {}}
    with workers(jobs) as pool:

        def compile_all(programs: list[tuple[Arm, str]]) -> None:
            if jobs > 1:
                list(pool.map(compile_one, programs))

        arms = [arm for s in settings for arm in models_of(s)[1].values()]
        compile_all([(arm, ACCURATE) for arm in arms])
        for setting in settings:
            begin = time.perf_counter()
            scene = measured(setting, compile_all)
            results["scenes"][setting.name] = {"made": origin, **scene}
            seconds = time.perf_counter() - begin
            print(f"{setting.title}: {len(scene['points'])} runs, {seconds:.0f} s", flush=True)
    return results


def plain(value: Any) -> Any:
    """A copy for JSON: numbers rounded to four digits, "diverged" for infinity and NaN."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else "diverged"
    return value
