"""Charts and page of the work-precision benchmark."""

import math
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks.output import save_figure, table
from dynamics.integrators.table import INTEGRATORS

TARGETS = (1e-2, 1e-3, 1e-4)  # [reach]
SMALL = 0.3  # largest integration error over model error of a run that shows the model error
LOWEST, HIGHEST = 3e-8, 2.0  # errors drawn; diverged runs lie at 1
NEAR = 1.6  # models within this ratio of costs and of errors share one label
STEP = "The step: distance from the default model's own exact motion"
MODEL = "The model: distance of its exact motion from the truth"
BOTH = "Both added: every run"
STAR: dict[str, Any] = {
    "color": "gold", "markeredgecolor": "k", "markersize": 14, "zorder": 5, "linestyle": "none",
}  # fmt: skip
CODE = "modes x segments, f: foreshortened"
BELOW: dict[str, Any] = {  # legend below the axes, where it hides no run
    "loc": "upper center", "bbox_to_anchor": (0.5, -0.07), "ncols": 3, "fontsize": 7.5,
    "title_fontsize": 8, "columnspacing": 1.0, "handletextpad": 0.4,
}  # fmt: skip
COLUMNS = (
    "wanted", "model", "integrator", "step [ms]", "CPU [us/s]", "error", "of the model",
    "of the step", "measured",
)  # fmt: skip
Row = dict[str, Any]


def draw(results: Row, folder: Path) -> None:
    """Draw a figure per scene (step, model, both errors), and one of all scenes."""
    scenes = results["scenes"]
    for name, scene in scenes.items():
        figure, axes = plt.subplots(1, 3, figsize=(14.5, 6.4), sharey=True, layout="constrained")
        _draw_steps(axes[0], scene)
        _draw_models(axes[1], scene)
        _draw_runs(axes[2], scene)
        axes[0].set_ylabel("tip error / reach [-]")
        figure.suptitle(scene["title"], fontsize=12)
        scipy = " (SciPy: one environment, from Python)"
        figure.supxlabel(_cost_label(results) + scipy, fontsize=10)
        save_figure(figure, folder / f"work_precision_{name}")
    columns = min(3, len(scenes))
    rows = math.ceil(len(scenes) / columns)
    figure, grid = plt.subplots(
        rows, columns, figsize=(5.0 * columns, 4.4 * rows), squeeze=False, sharey=True,
        layout="constrained",
    )  # fmt: skip
    for axis, scene in zip(grid.flat, scenes.values(), strict=False):
        _draw_runs(axis, scene)
        axis.get_legend().remove()
        axis.set_title(scene["title"], fontsize=10)
        axis.set_ylim(1e-6, HIGHEST)
    for axis in grid[:, 0]:
        axis.set_ylabel("tip error / reach [-], model and step added")
    figure.supxlabel(_cost_label(results), fontsize=10)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=8, fontsize=9, title=CODE)
    save_figure(figure, folder / "work_precision")


def _cost_label(results: Row) -> str:
    return (
        "CPU time per simulated second [s/s] of one environment in a batch of "
        f"{results['batch']}, one thread"
    )


def _colour(integrator: str) -> str:
    names = list(INTEGRATORS)
    return f"C{names.index(integrator)}" if integrator in names else "0.45"


def _drawn(error: float) -> float:
    return min(max(error, LOWEST), 1.0)


def _short(model: str) -> str:
    """Label of a model at its point: modes x segments, then f if foreshortened."""
    if model == "rigid":
        return model
    cut = model.split(" segments")[0].split()[-1] if "segments" in model else ""
    return model.split()[0] + (f"x{cut}" if cut else "") + "f" * ("foreshortened" in model)


def _prepare(axis: Any, title: str, scene: Row) -> None:
    axis.set(xscale="log", yscale="log", ylim=(LOWEST, HIGHEST))
    axis.set_title(title, fontsize=10)
    axis.grid(alpha=0.25)
    if title != STEP:
        axis.axhspan(
            LOWEST, scene["floor"], color="0.88", zorder=0, label="below the truth's accuracy"
        )


def _draw_steps(axis: Any, scene: Row) -> None:
    """Draw the integration error of the default model, a line per integrator."""
    _prepare(axis, STEP, scene)
    model = scene["default"]["model"]
    runs = [p for p in scene["points"] if p["model"] == model]
    for name, group in groupby(runs, key=lambda p: p["integrator"]):
        line = [p for p in group if p["integration"] < math.inf]
        known = name in INTEGRATORS
        label = f"{name} (order {INTEGRATORS[name].order})" if known else f"SciPy {name}"
        marker = "o" if known else "^v"[name == "bdf"]
        axis.plot(
            [p["cpu"] for p in line], [_drawn(p["integration"]) for p in line],
            marker=marker, markersize=3.5, linewidth=1.3, color=_colour(name),
            linestyle="-" if known else ":", label=label,
        )  # fmt: skip
        diverged = [p["cpu"] for p in runs if p["integrator"] == name and p not in line]
        axis.plot(diverged, [1.0] * len(diverged), "x", color=_colour(name), markersize=5)
    _draw_default(axis, scene, "integration")
    axis.legend(title=model, **BELOW)


def _draw_models(axis: Any, scene: Row) -> None:
    """Draw each model's error over the least cost at which its integration error is small."""
    _prepare(axis, MODEL, scene)
    groups: dict[str, list[tuple[float, float, str]]] = {}
    for name, row in scene["models"].items():
        error = row["model error"]
        runs = [p for p in scene["points"] if p["model"] == name and "rtol" not in p]
        good = [p["cpu"] for p in runs if p["integration"] <= SMALL * error < math.inf]
        place = min(good) if good else min(p["cpu"] for p in runs)
        kind = "foreshortened" if "foreshortened" in name else "linear"
        kind = f"{kind}, in segments" if "segments" in name else kind
        kind = "rigid" if name == "rigid" else kind if good else "diverged"
        groups.setdefault(kind, []).append((place, _drawn(error), name))
    for kind, points in groups.items():
        colour = {"rigid": "0.3", "diverged": "C3"}.get(kind, "C4" if "linear" in kind else "C2")
        marker = {"rigid": "P", "diverged": "x"}.get(kind, "D" if "segments" in kind else "o")
        x, y, names = zip(*points, strict=True)
        axis.plot(x, y, marker, color=colour, markersize=7, label=kind)
        for place, error, name in zip(x, y, names, strict=True):
            axis.annotate(
                _short(name), (place, error), textcoords="offset points", xytext=(6, 4), fontsize=8
            )
            if name == scene["default"]["model"]:
                axis.plot(place, error, "*", label="default", **STAR)
    axis.legend(title=CODE, **BELOW)


def _draw_runs(axis: Any, scene: Row) -> None:
    """Draw every run of the compiled integrators, the Pareto line, and the default."""
    _prepare(axis, BOTH, scene)
    for name in INTEGRATORS:
        runs = [p for p in scene["points"] if p["integrator"] == name]
        finite = [p for p in runs if p["error"] < math.inf]
        axis.plot(
            [p["cpu"] for p in finite], [_drawn(p["error"]) for p in finite], ".",
            color=_colour(name), alpha=0.45, markersize=5, rasterized=True, label=name,
        )  # fmt: skip
        diverged = [p["cpu"] for p in runs if p["error"] == math.inf]
        axis.plot(
            diverged, [1.0] * len(diverged), "x", color=_colour(name), alpha=0.3, markersize=3,
            rasterized=True,
        )  # fmt: skip
    line = scene["front"]
    axis.step(
        [p["cpu"] for p in line], [_drawn(p["error"]) for p in line], "k-", where="post",
        linewidth=1.4, label="Pareto line",
    )  # fmt: skip
    first: dict[str, Row] = {}
    for point in line:
        first.setdefault(point["model"], point)
    names: dict[tuple[float, float], str] = {}  # by place
    for name, point in first.items():
        place = point["cpu"], _drawn(point["error"])
        last = next(reversed(names), (0.0, math.inf))
        if place[0] < NEAR * last[0] and place[1] > last[1] / NEAR:
            names[last] += f", {_short(name)}"
        else:
            names[place] = _short(name)
    for place, text in names.items():
        axis.annotate(
            text, place, textcoords="offset points", xytext=(2, 3), fontsize=7.5, weight="bold",
            zorder=6,
        )  # fmt: skip
    _draw_default(axis, scene, "error")
    axis.legend(title=CODE, **BELOW)


def _draw_default(axis: Any, scene: Row, error: str) -> None:
    """Draw a star at the default."""
    for point in scene["points"]:
        if point["default"]:
            axis.plot(point["cpu"], _drawn(point[error]), "*", label="default", **STAR)


def page(results: Row) -> str:
    """Markdown page: the cheapest runs of every scene within each target, and the default."""
    machine = results["machine"]
    lines = [
        "# Speed against accuracy: the cheapest runs",
        "",
        f"Made by `{results['command']}` on {machine['cores']} cores ({machine['processor']}), "
        f"commit {results['commit']}. Errors are distances of the tip over the reach, the largest "
        "of the motion; cost is CPU time per simulated second of one environment in a batch of "
        f"{results['batch']}, one thread. The error of a run is the sum of its model's and its "
        "step's, and at least the measured distance from the truth.",
        "",
    ]
    for scene in results["scenes"].values():
        lines += [
            f"## {scene['title']}", "",
            f"Truth good to {scene['floor']:.1e} of the reach ({scene['reach [m]']:.4g} m).", "",
        ]  # fmt: skip
        default = next(p for p in scene["points"] if p["default"])
        wanted = {f"{target:.0e}": cheapest(scene, target) for target in TARGETS}
        wanted |= {"default": default, "as good as it": cheapest(scene, default["error"])}
        rows = [_cells(label, point, scene) for label, point in wanted.items()]
        lines += [table(COLUMNS, rows, "lllr"), ""]
    return "\n".join(lines)


def cheapest(scene: Row, target: float) -> Row | None:
    """The cheapest run whose error is at most `target`, if there is one."""
    return next((p for p in scene["front"] if p["error"] <= target), None)


def _cells(label: str, point: Row | None, scene: Row) -> list[str]:
    if point is None:
        return [label, "none", *[""] * 7]
    return [
        label, point["model"], point["integrator"],
        f"{1e3 * point['dt']:.3g}" if "dt" in point else "by error control",
        f"{1e6 * point['cpu']:.3g}", f"{point['error']:.1e}",
        f"{scene['models'][point['model']]['model error']:.1e}",
        f"{point['integration']:.1e}", f"{point['total']:.1e}",
    ]  # fmt: skip
