"""Growth of the accelerations' cost with links, segments, modes and the size of a batch.

    python -m benchmarks.speed.cost [--quick | --charts] [--out FILE] [--images FOLDER]

CPU time is for one right-hand side of one environment, with many lanes on one thread; a batch adds
its share of the call. Each exponent is fitted to the growth beyond the second point of its line,
because the first link or segment is cheaper: its root does not move. Compile time is also CPU time,
from the arm's description to its first right-hand side, without a cache.
`--charts` draws the stored results.
"""

import json
import os
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar
from unittest.mock import patch

import numpy as np

from benchmarks import style
from benchmarks.arms import ACROSS
from benchmarks.output import (
    RESULTS,
    argument_parser,
    paragraphs,
    provenance,
    save_figure,
    save_results,
    table,
)
from dynamics import Arm, Joint, Link, Mode, Stepper, compile_arm
from dynamics.description.validate import IDENTITY
from dynamics.tracing.operation_counts import operations
from flexarm_env.accuracy.timing import cpu_seconds

DEFAULT_ARMS = ("slim", "deluca-siciliano", "six-link")
EVALUATIONS = 4  # of the accelerations per Runge-Kutta step
SUBSTEPS = 5
REPEATED = 50  # evaluations per timed call
SERIES = ("x", "operations", "ns", "workspace [kB]", "compile [s]")  # columns of numbers
plt = style.pyplot()
Row = dict[str, Any]
K = TypeVar("K")


def chain(links: int, modes: int, *, spatial: bool = False, **changes: Any) -> Arm:
    """Arm of equal links; spatial links bend in y and z, on alternately perpendicular axes."""
    shapes = tuple(
        Mode(kind="poly", index=k, direction=direction)
        for direction in ("yz" if spatial else "y")
        for k in range(1, modes + 1)
    )
    link: dict[str, Any] = {
        "length": 0.5,
        "rho_A": 0.4,
        "EIz": 100.0,
        "EIy": 100.0,
        "tip_mass": 0.5,
    }
    inertia = ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3))
    turned = (IDENTITY, ACROSS) if spatial else (IDENTITY, IDENTITY)
    return Arm(
        links=tuple(
            Link(
                **link, tip_inertia=inertia, modes=shapes, segments=changes.get("segments", 1),
                joint=Joint(rotor_inertia=0.1, rotation=turned[k % 2]),
            )
            for k in range(links)
        ),
        foreshortening=changes.get("foreshortening", False),
    )  # fmt: skip


def growth(most: int) -> dict[str, tuple[str, dict[int, Arm]]]:
    """Lines of the chart: name -> (what grows, number -> arm), up to `most` links."""
    links = [n for n in (1, 2, 3, 4, 6, 8) if n <= most]
    segments = [1, 2, 4, 8, *([16, 32] if most > 4 else [])]
    modes = [n for n in (1, 2, 3, 4, 5, 6) if n <= most]
    return {
        "planar links, 2 modes": ("parts", {n: chain(n, 2) for n in links}),
        "spatial links, 1 mode each way": (
            "parts", {n: chain(n, 1, spatial=True) for n in links},
        ),
        "segments of a link, 2 modes": (
            "parts", {n: chain(1, 2, segments=n) for n in segments},
        ),
        "segments, 2 modes, foreshortened": (
            "parts", {n: chain(1, 2, segments=n, foreshortening=True) for n in segments},
        ),
        "one link": ("modes", {n: chain(1, n) for n in modes}),
        "two links": ("modes", {n: chain(2, n) for n in modes}),
        "two links, foreshortened": (
            "modes", {n: chain(2, n, foreshortening=True) for n in modes if n < 5},
        ),
    }  # fmt: skip


def right_hand_sides(arms: dict[K, Arm]) -> dict[K, Row]:
    """Operations and CPU time [ns] of the accelerations of one environment, for each arm."""
    rows, calls = {}, {}
    compiling: dict[Arm, float] = {}  # an arm on two lines is compiled once
    for key, arm in arms.items():
        begin = time.process_time()
        model = compile_arm(arm)
        program = model.program(model.lanes, "rk4")
        w = model.workspace(program)
        program.evaluate_often(w, 1)
        compiling.setdefault(arm, time.process_time() - begin)
        calls[key] = partial(program.evaluate_often, w, REPEATED)
        rows[key] = {
            "coordinates": model.n,
            "operations": sum(operations(model.graph).values()),
            "workspace [kB]": w.nbytes / 1e3,
            "compile [s]": compiling[arm],
        }
    for key, seconds in cpu_seconds(calls).items():
        rows[key]["ns"] = 1e9 * seconds / REPEATED / compile_arm(arms[key]).lanes
    return rows


def batches(arms: tuple[str, ...], sizes: list[int]) -> dict[str, list[float]]:
    """CPU time [ns] per right-hand side and environment, including the call, per batch size."""
    calls = {
        (arm, size): Stepper(compile_arm(arm), size, dt=1e-7, substeps=SUBSTEPS).advance
        for arm in arms
        for size in sizes
    }
    seconds = cpu_seconds(calls)
    share = 1e9 / SUBSTEPS / EVALUATIONS
    return {arm: [share * seconds[arm, size] / size for size in sizes] for arm in arms}


def exponent(x: list[int], y: list[float]) -> float:
    """Slope of log(y - y[1]) over log(x - x[1]); 1 where every part adds the same cost."""
    added = np.log(np.subtract(x[2:], x[1])), np.log(np.subtract(y[2:], y[1]))
    return float(np.polyfit(*added, 1)[0])


def measure(most: int, sizes: list[int]) -> Row:
    """Measure all lines of the chart, and the batches."""
    wanted = growth(most)
    arms = {(name, n): arm for name, (_, line) in wanted.items() for n, arm in line.items()}
    with TemporaryDirectory() as empty, patch.dict(os.environ, FLEXARM_CACHE=empty):
        right_hand_sides({"warm-up of numba": chain(1, 7)})
        rows = right_hand_sides(arms)
    lines: Row = {}
    for name, (kind, line) in wanted.items():
        x = list(line)
        columns = {key: [rows[name, n][key] for n in x] for key in rows[name, x[0]]}
        lines[name] = {
            "grows": kind,
            "x": x,
            **columns,
            "exponent, operations": exponent(x, columns["operations"]),
            "exponent, time": exponent(x, columns["ns"]),
        }
    return {
        **provenance("numpy", "numba", "casadi"),
        "lines": lines,
        "batch": {"x": sizes, **batches(DEFAULT_ARMS, sizes)},
    }


def draw(results: Row, path: Path) -> None:
    """Draw four panels: links and segments, modes, batch size, compile time."""
    figure, axes = plt.subplots(1, 4, figsize=(18.0, 7.0), layout="constrained")
    looks = {name: style.series(k) for k, name in enumerate(results["lines"])}
    lines: dict[str, Any] = {"markersize": 8, "linewidth": 2.0}
    titles = {"parts": "links, or segments of one link", "modes": "modes per link"}
    for axis, (kind, label) in zip(axes, titles.items(), strict=False):
        mine = {k: v for k, v in results["lines"].items() if v["grows"] == kind}
        for name, line in mine.items():
            text = f"{name}: operations {line['exponent, operations']:.2f}"
            text += f", time {line['exponent, time']:.2f}"
            axis.loglog(line["x"], line["ns"], **looks[name], **lines, label=text)
        line = next(iter(mine.values()))
        _guide(axis, line["x"], 0.6 * line["ns"][0])
        axis.set(xlabel=label, ylabel="ns per right-hand side")
        ticks = sorted({n for line in mine.values() for n in line["x"]})
        axis.set_xticks(ticks, [str(n) for n in ticks])
        axis.set_xticks([], minor=True)
    sizes = results["batch"]["x"]
    for k, name in enumerate(DEFAULT_ARMS):
        axes[2].loglog(sizes, results["batch"][name], **style.series(k), **lines, label=name)
    axes[2].set(xlabel="environments in the batch", ylabel="ns per right-hand side, calls included")
    for name, line in results["lines"].items():
        axes[3].loglog(
            line["operations"], line["compile [s]"], linestyle="none", **looks[name], markersize=8,
            label=name,
        )  # fmt: skip
    least, most = (f(f(x["operations"]) for x in results["lines"].values()) for f in (min, max))
    _guide(axes[3], [least, most], 3e-4 * least)
    axes[3].set(xlabel="operations", ylabel="seconds to trace and compile")
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.xaxis.label.set_size(12)
        axis.yaxis.label.set_size(12)
        axis.legend(
            fontsize=10, loc="upper center", bbox_to_anchor=(0.5, -0.11), frameon=False,
            title="exponents" if axis in axes[:2] else None,
        )  # fmt: skip
    save_figure(figure, path)


def _guide(axis: Any, ends: list[int], first: float) -> None:
    """Draw a grey line of slope 1 between the ends of a list, starting at the value `first`."""
    x = np.array([ends[0], ends[-1]])
    axis.loglog(x, first * x / x[0], "--", color="0.6", label="linear")


def page(results: Row) -> str:
    """The results as Markdown."""
    machine, batch = results["machine"], results["batch"]
    header = ["", "numbers", "operations", "ns", "workspace [kB]", "compile [s]"]
    return paragraphs(
        "# How cost grows",
        f"Made by `{results['command']}` on {machine['cores']} cores ({machine['processor']}), "
        f"commit {results['commit']}. An exponent says how that grows which is added to the second "
        "number.",
        table(
            [*header, "exponent of operations", "of time"],
            [
                [
                    f"{line['grows']}: {name}",
                    *(_series(line[key]) for key in SERIES),
                    f"{line['exponent, operations']:.2f}",
                    f"{line['exponent, time']:.2f}",
                ]
                for name, line in results["lines"].items()
            ],
            "llllllr",
        ),
        "ns per right-hand side and environment in a batch, calls included:",
        table(
            ["batch", *map(str, batch["x"])],
            [[name, *(f"{x:.3g}" for x in batch[name])] for name in DEFAULT_ARMS],
            "lr",
        ),
    )


def _series(values: list[float]) -> str:
    return ", ".join(f"{x:.3g}" if isinstance(x, float) else str(x) for x in values)


def main() -> None:
    """Measure, and write JSON, a table and the chart."""
    parser = argument_parser("speed.cost", __doc__, "cost.json")
    parser.add_argument(
        "--quick", action="store_true", help="at most four links and eight segments"
    )
    parser.add_argument("--charts", action="store_true", help="only draw the stored results")
    parser.add_argument("--images", type=Path, default=RESULTS)
    options = parser.parse_args()
    if options.charts:
        draw(json.loads(options.out.read_text(encoding="utf-8")), options.images / "cost")
        return
    sizes = [1, 16, 1024] if options.quick else [4**k for k in range(7)] + [8192]
    results = measure(4 if options.quick else 8, sizes)
    save_results(results, page, options.out)
    draw(results, options.images / "cost")


if __name__ == "__main__":
    main()
