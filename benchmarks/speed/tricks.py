"""Gain of each trick that makes stepping faster, on the three registered arms.

    python -m benchmarks.speed.tricks [--rounds 5] [--only NAME ...] [--out FILE]

Every trick is switched off in processes of its own, which run in turn with untouched ones; the
table shows the time without a trick over the time with it. A trick stays in the code if it gains
at least 5 % on one of the arms.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np
from numba.extending import register_jitable

from benchmarks.output import argument_parser, count, paragraphs, provenance, save_results, table
from dynamics.backends.numba_llvm import lanes, plain_code, vector_code
from dynamics.runtime import thread_pool, work_queue
from dynamics.runtime.jit import aligned_zeros
from flexarm_env import core as core_file
from flexarm_env.compiled import outputs
from flexarm_env.core import Core
from flexarm_env.registration import SCENES

BATCH = 16384
PERIOD = 0.15  # [s] of steps per timing
TIMINGS = 5  # per process, of which the least is kept


@register_jitable
def _expect_nothing(array, count, first, stride):  # type: ignore[no-untyped-def]
    return


_LANE_MOVES = lanes.lane_moves


def _without_prefetch(*sizes: Any) -> tuple[Any, ...]:
    return (*_LANE_MOVES(*sizes)[:2], _expect_nothing)


def _beside_a_cache_line(shape: tuple[int, int], dtype: Any) -> Any:
    """Zeros 16 bytes behind a cache line, as NumPy allocates large arrays."""
    size, gap = shape[0] * shape[1], 16 // np.dtype(dtype).itemsize
    return aligned_zeros(size + gap, dtype)[gap:].reshape(shape)


def _search_for_signature(core: Core) -> None:
    core.__dict__["_control_step"] = core.program.control_step


def _arguments_anew(core: Core) -> None:
    core.__dict__["alone"] = partial(core.step, core.action), core.outputs()


def _new_outputs(core: Core) -> None:
    core._kept = []
    outputs = type(core).outputs

    def fresh() -> Any:
        core._kept = []
        return outputs(core)

    core.__dict__["outputs"] = fresh


@dataclass(frozen=True)
class Trick:
    """A trick, the case that it is for, and how to do without it."""

    where: str
    envs: int
    threads: int
    # without the trick: values of modules before anything is compiled, a change of the environment
    values: tuple[tuple[ModuleType, str, object], ...] = ()
    after: Callable[[Core], None] = lambda core: None
    busy: bool = False  # while another process takes one core


_NEVER = {32: 10**9, 64: 10**9}
TRICKS = {
    "type dispatch skipped": Trick(
        "runtime/numba_internals.py, compiled_for", 1, 1, after=_search_for_signature
    ),
    "arguments bound": Trick("flexarm_env/core.py, alone", 1, 1, after=_arguments_anew),
    "output arrays reused": Trick("flexarm_env/core.py, outputs", 64, 1, after=_new_outputs),
    "output arrays reused, large batch": Trick(
        "flexarm_env/core.py, outputs", BATCH, 1, after=_new_outputs
    ),
    "stack aligned": Trick(
        "backends/numba_llvm/vector_code.py, _lay_out_stack", BATCH, 1,
        values=((vector_code, "_lay_out_stack", lambda builder, data: None),),
    ),
    "long functions in rounds": Trick(
        "backends/numba_llvm/vector_code.py, NARROW", BATCH, 1,
        values=((vector_code, "NARROW", _NEVER), (vector_code, "NARROW_LOOSE", _NEVER)),
    ),
    "rows fetched ahead": Trick(
        "backends/numba_llvm/moves.py, expect", BATCH, 1,
        values=((lanes, "lane_moves", _without_prefetch),),
    ),
    "rows transposed in registers": Trick(
        "backends/numba_llvm/moves.py, block_moves", BATCH, 1,
        values=((lanes, "block_moves", plain_code.block_moves),),
    ),
    "arrays begin at a cache line": Trick(
        "runtime/jit.py, aligned_zeros", BATCH, 1,
        values=tuple((x, "aligned_zeros", _beside_a_cache_line) for x in (core_file, outputs)),
    ),
    "threads spin before they sleep": Trick(
        "runtime/thread_pool.py, SPINS", 1024, 2, values=((thread_pool, "SPINS", 1),)
    ),
    **{
        f"chunks from a queue{', one core busy' * busy}": Trick(
            "runtime/work_queue.py, CHUNKS", BATCH, 2, values=((work_queue, "CHUNKS", 1),),
            busy=busy,
        )
        for busy in (False, True)
    },
}  # fmt: skip


def seconds(name: str, on: bool) -> dict[str, float]:
    """Least time of a control step per arm, in this process, with a trick or without it."""
    trick = TRICKS[name]
    if not on:
        for value in trick.values:
            setattr(*value)
    result = {}
    for scene, (arm, control_dt, _) in SCENES.items():
        single = trick.envs == 1
        core = Core(
            task="Reach", arm=arm, control_dt=control_dt, n_env=trick.envs, threads=trick.threads,
            single=single,
        )  # fmt: skip
        if not on:
            trick.after(core)
        core.reset(np.arange(trick.envs))
        shape = trick.envs, core.arm.n_joint
        actions = np.random.default_rng(0).uniform(-0.3, 0.3, shape).astype(np.float32)
        core.action[...] = actions[0]
        step = core.alone[0] if single else partial(core.step, actions)
        step()
        result[scene] = min(_timed(step) for _ in range(TIMINGS))
    return result


def _timed(call: Callable[[], Any]) -> float:
    """[s] per call."""
    calls, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < PERIOD:
        call()
        calls += 1
    return (time.perf_counter() - begin) / calls


def gains(name: str, rounds: int, folder: Path) -> dict[str, list[float]]:
    """Time without a trick over time with it: a ratio per round, by arm."""
    ratios: dict[str, list[float]] = {scene: [] for scene in SCENES}
    for k in range(rounds):
        found = {on: _in_process(name, on, folder) for on in (k % 2 == 0, k % 2 == 1)}
        for scene, kept in ratios.items():
            kept.append(found[False][scene] / found[True][scene])
    return ratios


def _in_process(name: str, on: bool, folder: Path) -> dict[str, float]:
    """`seconds` in a fresh process with a code cache of its own."""
    cache = folder / f"{list(TRICKS).index(name)}-{on}"
    command = [
        sys.executable,
        "-m",
        "benchmarks.speed.tricks",
        "--child",
        name,
        "--on",
        str(int(on)),
    ]
    result = subprocess.run(
        command, env=os.environ | {"FLEXARM_CACHE": str(cache)}, check=True, capture_output=True
    )
    found: dict[str, float] = json.loads(result.stdout)
    return found


def page(results: dict[str, Any]) -> str:
    """Table of all gains."""
    rows = [
        [name, f"`{row['where']}`", *(_range(row["ratios"][scene]) for scene in SCENES)]
        for name, row in results["tricks"].items()
    ]
    return paragraphs(
        "# Tricks",
        f"Made by `{results['command']}` on {results['machine']['processor']}. Time of a control "
        "step without a trick over the time with it: median (least to most) of "
        f"{results['rounds']} pairs of processes. Batches have {BATCH} environments, those of "
        "spinning threads 1024, those of reused arrays 64 where not large.",
        table(["trick", "where", *SCENES], rows),
    )


def _range(ratios: list[float]) -> str:
    return f"{median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


def main() -> None:
    """Run the command line."""
    parser = argument_parser("speed.tricks", __doc__, "tricks.json")
    parser.add_argument("--rounds", type=count, default=5)
    parser.add_argument("--only", nargs="+", choices=TRICKS, default=list(TRICKS))
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--on", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(seconds(options.child, bool(options.on))))
        return
    tricks: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only:
            neighbour = _neighbour() if TRICKS[name].busy else None
            ratios = gains(name, options.rounds, Path(folder))
            if neighbour:
                neighbour.kill()
            tricks[name] = {"where": TRICKS[name].where, "ratios": ratios}
            print(name, {scene: _range(x) for scene, x in ratios.items()}, flush=True)
    results = {**provenance("numba", "numpy"), "rounds": options.rounds, "tricks": tricks}
    save_results(results, page, options.out)


def _neighbour() -> "subprocess.Popen[bytes]":
    """A process that keeps one core busy."""
    return subprocess.Popen([sys.executable, "-c", "while True: pass"])


if __name__ == "__main__":
    main()
