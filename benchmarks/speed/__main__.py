"""Step rates of the three default arms, compared with this machine's multiply-add peak.

    python -m benchmarks.speed [--thorough] [--out docs/results/speed.json]

Results are medians of repeated runs; ratios and the peak come from the same run. Run nothing else
on the machine meanwhile. `--thorough` also chooses a model of six links, which takes a quarter of
an hour; the choice is stored in the cache folder.
"""

import itertools
import math
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, cast

import gymnasium as gym
import numpy as np

from benchmarks.output import argument_parser, paragraphs, provenance, save_results, table
from benchmarks.speed.timing import RUNS, Timing, timed, timed_in_turn
from dynamics import ARMS, Stepper, compile_arm
from dynamics.backends.numba_llvm.fingerprint import fingerprint
from dynamics.backends.numba_llvm.module_text import straight_line_text
from dynamics.backends.numba_llvm.program import cached_module
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.runtime.work_queue import STOP
from dynamics.tracing.function import written
from dynamics.tracing.ssa import Code
from flexarm_env import FlexArmVectorEnv
from flexarm_env.accuracy.certificates import covering, entries

DEFAULT_ARMS = {"OneLink": "slim", "TwoLink": "two-link", "SixLink": "six-link"}
BATCHES = (1024, 16384)
LANE_COUNTS = {"one lane": 1, "many lanes": LANES}
TOLERANCE = 1e-3  # tip error over the reach
STARTS = 5  # process starts with a cache, and without
CHAINS, ROUNDS = 12, 200  # each chain takes a vector register: 12 of 16 are in use
WIDTHS = 4, 8  # float64 numbers per vector register: AVX2, AVX-512


def rates(calls: Mapping[str, tuple[Callable[[], Any], float]]) -> dict[str, dict[str, float]]:
    """Amounts per second of (call, amount done by the call), timed in turn."""
    found = timed_in_turn({name: call for name, (call, _) in calls.items()})
    return {name: found[name].per(amount) for name, (_, amount) in calls.items()}


def multiply_adds(width: int) -> tuple[Callable[[], Any], float]:
    """A call that evaluates independent chains of multiply-adds, and its number of operations."""
    code = Code()
    factor, term, *chains = (code.load(slot) for slot in range(2 + CHAINS))
    for _ in range(ROUNDS):
        chains = [code.emit("+", code.emit("*", x, factor), term) for x in chains]
    rounds = written("rounds", code, dict(enumerate(chains, 2)))
    text = "\n".join([
        "from dynamics.backends.numba_llvm.lanes import straight_line",
        "from dynamics.runtime.jit import outermost",
        f"LANES = {width}",
        straight_line_text(rounds),
        "@outermost",
        "def often(w, times):",
        "    for _ in range(times):",
        "        rounds(w)",
    ])  # fmt: skip
    module = cached_module(fingerprint("peak", text), lambda: text)
    w = np.full((2 + CHAINS) * width, 0.5)
    times = 2000
    return lambda: module.often(w, times), 2.0 * CHAINS * ROUNDS * width * times


def right_hand_sides() -> tuple[dict[str, float], dict[str, dict[str, Any]]]:
    """Peak of one core [FLOP/s]; and per arm ns per environment and share of the peak."""
    peaks = {f"{width} numbers": multiply_adds(width) for width in WIDTHS}
    calls, counts, often = dict(peaks), dict[str, int](), 1000
    for arm in DEFAULT_ARMS.values():
        model = compile_arm(arm)
        count = model.operation_count()["accelerations"]
        counts[arm] = count["multiplications"] + count["additions"] + count["divisions"]
        for name, lanes in LANE_COUNTS.items():
            program = model.program(lanes, "rk4")
            call = partial(program.evaluate_often, model.workspace(program), often)
            calls[arm + name] = call, counts[arm] * often * lanes
    found = rates(calls)
    peak, rows = max((found[name] for name in peaks), key=lambda rate: rate["median"]), {}
    for arm, operations in counts.items():
        row: dict[str, Any] = {"operations": operations}
        for name in LANE_COUNTS:
            rate = found[arm + name]
            if rate["best"] > peak["best"]:
                raise RuntimeError(f"{arm}, {name}, ran faster than the measured peak.")
            row[f"rhs {name} [ns]"] = {key: 1e9 * operations / x for key, x in rate.items()}
            row[f"share of peak, {name}"] = {key: x / peak[key] for key, x in rate.items()}
        rows[arm] = row
    return peak, rows


def compile_seconds(arm: str) -> dict[str, dict[str, float]]:
    """Time to the first batched step in a fresh process, without and with a cache."""
    code = (
        "import time; t = time.perf_counter()\n"
        "from dynamics import Stepper, compile_arm\n"
        f"s = Stepper(compile_arm({arm!r}), 64, dt=1e-3, substeps=1); s.advance()\n"
        "print(time.perf_counter() - t)"
    )
    start = partial(subprocess.run, [sys.executable, "-c", code], check=True, capture_output=True)
    times: dict[str, list[float]] = {"cold [s]": [], "warm [s]": []}
    for _ in range(STARTS):
        with tempfile.TemporaryDirectory() as folder:
            env = {**os.environ, "FLEXARM_CACHE": folder}
            for found in times.values():
                found.append(float(start(env=env, text=True).stdout))
    return {k: Timing(statistics.median(t), min(t)).each(1.0) for k, t in times.items()}


def env_steps(family: str) -> dict[str, Any]:
    """Environment steps per second of gym.make and of the native batch."""
    env_id = f"FlexArm/{family}-Reach-v0"
    env = gym.make(env_id)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (256, *env.action_space.shape)).astype(np.float32)  # type: ignore[misc]
    calls: dict[str, tuple[Callable[[], Any], float]] = {}

    def episode(env: gym.Env[Any, Any]) -> None:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    for name, single in (("gym.make", env), ("unwrapped", env.unwrapped)):
        calls[f"single {name} [steps/s]"] = partial(episode, single), len(actions)
    for size, threads, dtype in itertools.product(BATCHES, (1, 2), ("float64", "float32")):
        batch = gym.make_vec(env_id, num_envs=size, threads=threads, dtype=dtype)
        batch.reset(seed=0)
        many = rng.uniform(-1.0, 1.0, (size, actions.shape[1])).astype(np.float32)
        name = f"batch of {size}, {threads} thread{'s' * (threads > 1)}, {dtype} [steps/s]"
        calls[name] = partial(batch.step, many), size
    return rates(calls) | {"vector interface [us/call]": interface_microseconds(env_id)}


def interface_microseconds(env_id: str) -> dict[str, float]:
    """Time of a batch's step without its compiled work, which is skipped here [us]."""
    batch = cast(FlexArmVectorEnv, gym.make_vec(env_id, num_envs=LANES))
    batch.reset(seed=0)
    batch.core.shares[STOP] = 0
    return timed(partial(batch.step, np.zeros((LANES, batch.n_joint), np.float32))).each(1e-6)


def errors(env_id: str) -> dict[str, float]:
    """Stored tip errors of the environment that is timed, over the reach."""
    core = cast(Any, gym.make(env_id).unwrapped).core
    entry = covering(entries(core.arm, core.control_dt), core.conditions)
    assert entry is not None
    found, reach = entry["certificate"], core.arm.reach
    return {
        "error of the step, 95 % of episodes [reach]": found["integration"] / reach,
        "error in all, 95 % of episodes [reach]": found["error"] / reach,
    }


def within_tolerance(env_id: str, tolerance: float, most_links: float) -> dict[str, Any]:
    """Step rate with the cheapest model and step whose total error is within the tolerance.

    `tolerance` is a tip error over the reach, at full torque. Arms of more links are not tried.
    """
    bare = cast(Any, gym.make(env_id).unwrapped)
    size, name = BATCHES[-1], f"within {tolerance:g} of the reach in all"
    if bare.n_joint > most_links:
        return {f"{name}: model": "not tried", f"{name}: batch of {size} [steps/s]": "-"}
    batch = cast(
        FlexArmVectorEnv,
        gym.make_vec(env_id, num_envs=size, threads=2, tolerance=tolerance * bare.reach),
    )
    batch.reset(seed=0)
    actions = np.zeros((size, batch.n_joint), np.float32)
    rate = timed(partial(batch.step, actions)).per(size)
    core = batch.core
    steps = f"{core.integrator}, {core.substeps} step{'s' * (core.substeps > 1)}"
    batch.close()
    assert core.certificate is not None
    model = core.certificate["reason"].split(" with ")[0].lower()
    return {f"{name}: model": f"{model}; {steps}", f"{name}: batch of {size} [steps/s]": rate}


def physics_steps(family: str) -> dict[str, Any]:
    """Control steps per second of the stepper alone, with the environment's settings."""
    bare: Any = gym.make(f"FlexArm/{family}-Reach-v0").unwrapped
    core = bare.core
    calls = {}
    for threads in (1, 2):
        stepper = Stepper(
            core.model, BATCHES[-1], dt=core.control_dt / core.substeps, substeps=core.substeps,
            integrator=core.integrator, threads=threads,
        )  # fmt: skip
        name = f"physics, batch of {BATCHES[-1]}, {threads} thread{'s' * (threads > 1)} [steps/s]"
        calls[name] = stepper.advance, BATCHES[-1]
    return rates(calls)


def main() -> None:
    """Measure, print a table, and write JSON."""
    parser = argument_parser("speed", __doc__, "speed.json")
    parser.add_argument("--thorough", action="store_true", help="also choose a model of six links")
    options = parser.parse_args()
    most_links = math.inf if options.thorough else 2
    peak, rows = right_hand_sides()
    results = provenance("numba", "numpy", "gymnasium", "casadi")
    results["machine"] |= {
        "cores in fact": cores_in_fact(),
        "peak, one core [GFLOP/s]": {k: x / 1e9 for k, x in peak.items()},
    }
    for family, arm in DEFAULT_ARMS.items():
        results[family] = {
            "arm": arm,
            "coordinates": ARMS[arm].n,
            **errors(f"FlexArm/{family}-Reach-v0"),
            **rows[arm],
            **physics_steps(family),
            **env_steps(family),
            **within_tolerance(f"FlexArm/{family}-Reach-v0", TOLERANCE, most_links),
            **compile_seconds(arm),
        }
    save_results(results, page, options.out)


def page(results: dict[str, Any]) -> str:
    """The results as Markdown."""
    machine = results["machine"]
    peak = machine["peak, one core [GFLOP/s]"]
    return paragraphs(
        "# Speed",
        f"Made by `{results['command']}`: medians of {RUNS} runs, and in brackets the best "
        f"of them, all on {machine['cores']} cores ({machine['processor']}) whose peak in float64, "
        "of fused multiply-adds that need nothing from memory, was "
        f"{peak['median']:.0f} ({peak['best']:.0f}) GFLOP/s each. Where median and best differ "
        "much, the machine had other work.",
        f"Two busy processes side by side had {machine['cores in fact']:.2f} cores: where that is "
        "near one, the two-thread figures say nothing of threads.",
        table(
            ["", *DEFAULT_ARMS],
            [
                [key, *(_text(results[family][key]) for family in DEFAULT_ARMS)]
                for key in results["OneLink"]
            ],
            "lr",
        ),
    )


def _text(cell: Any) -> str:
    if isinstance(cell, dict):
        return f"{cell['median']:.3g} ({cell['best']:.3g})"
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)


def spin(seconds: float) -> float:
    """Number of loops that this process runs in the given time [s]."""
    loops, end = 0, time.perf_counter() + seconds
    while time.perf_counter() < end:
        loops += 1
    return float(loops)


def cores_in_fact() -> float:
    """Work of two simultaneous processes over that of one: 2 on two free cores."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        pool.map(spin, [0.1, 0.1])
        alone = pool.map(spin, [1.0])[0]
        return sum(pool.map(spin, [1.0, 1.0], chunksize=1)) / alone


if __name__ == "__main__":
    main()
