"""The charts and the table of work_precision.py."""

import math
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks.output import save_figure
from dynamics.integrators import INTEGRATORS

TARGETS = (1e-2, 1e-3, 1e-4)  # of the reach
SMALL = 0.3  # of a model's error: an integration error below leaves the model's to be seen
LOWEST, HIGHEST = 3e-8, 2.0  # errors drawn; diverged runs lie on the upper edge
KINDS = {"rigid": "*", "linear": "o", "foreshortened": "s"}  # markers; segments have their own
CUT = "D"
Row = dict[str, Any]


def draw(results: Row, folder: Path) -> None:
    """One figure per scene, its step, its model and both apart, and one of all scenes."""
    scenes = results["scenes"]
    for name, scene in scenes.items():
        figure, axes = plt.subplots(1, 3, figsize=(14.5, 5.2), sharey=True, layout="constrained")
        _draw_steps(axes[0], scene)
        _draw_models(axes[1], scene)
        _draw_runs(axes[2], scene)
        axes[0].set_ylabel("tip error / reach [-]")
        figure.suptitle(scene["title"], fontsize=12)
        figure.supxlabel(_cost_label(results), fontsize=10)
        save_figure(figure, folder / f"work_precision_{name}")
    columns = min(3, len(scenes))
    rows = math.ceil(len(scenes) / columns)
    figure, grid = plt.subplots(
        rows, columns, figsize=(5.0 * columns, 4.4 * rows), squeeze=False, sharey=True,
        layout="constrained",
    )  # fmt: skip
    for axis, scene in zip(grid.flat, scenes.values(), strict=False):
        _draw_runs(axis, scene)
        axis.set_title(scene["title"], fontsize=10)
        axis.set_ylim(1e-6, HIGHEST)
    for axis in grid[:, 0]:
        axis.set_ylabel("tip error / reach [-]")
    figure.supxlabel(_cost_label(results), fontsize=10)
    save_figure(figure, folder / "work_precision")


def _cost_label(results: Row) -> str:
    return (
        "CPU time per simulated second [s/s]: one environment of a batch of "
        f"{results['batch']}, one thread (SciPy: one environment, from Python)"
    )


def _colour(integrator: str) -> str:
    names = list(INTEGRATORS)
    return f"C{names.index(integrator)}" if integrator in names else "0.45"


def _drawn(error: float) -> float:
    return min(max(error, LOWEST), 1.0)


def _prepare(axis: Any, title: str, scene: Row) -> None:
    axis.set(xscale="log", yscale="log", ylim=(LOWEST, HIGHEST))
    axis.set_title(title, fontsize=10)
    axis.grid(alpha=0.25)
    if title != STEP_TITLE:
        axis.axhspan(LOWEST, scene["floor"], color="0.85", zorder=0)


STEP_TITLE = "The step: distance from the default model's own exact motion"


def _draw_steps(axis: Any, scene: Row) -> None:
    """Integration error of the default model, a line per integrator."""
    _prepare(axis, STEP_TITLE, scene)
    model = scene["default"]["model"]
    mine = [p for p in scene["points"] if p["model"] == model]
    for name, group in groupby(mine, key=lambda p: p["integrator"]):
        line = [p for p in group if p["integration"] < math.inf]
        known = name in INTEGRATORS
        label = f"{name} (order {INTEGRATORS[name].order})" if known else f"SciPy {name}"
        axis.plot(
            [p["cpu"] for p in line], [_drawn(p["integration"]) for p in line],
            marker="o" if known else "^", markersize=3.5, linewidth=1.3, color=_colour(name),
            linestyle="-" if known else ":", label=label,
        )  # fmt: skip
        lost = [p["cpu"] for p in mine if p["integrator"] == name and p not in line]
        axis.plot(lost, [1.0] * len(lost), "x", color=_colour(name), markersize=5)
    _draw_default(axis, scene, "integration")
    axis.legend(fontsize=8, loc="lower left", title=model, title_fontsize=8)


def _draw_models(axis: Any, scene: Row) -> None:
    """Model error against what it costs to integrate a model so well that only that is left."""
    _prepare(axis, "The model: distance of its exact motion from the truth", scene)
    lost = []
    drawn: dict[str, list[tuple[float, float]]] = {}
    for name, row in scene["models"].items():
        error = row["model error"]
        mine = [p for p in scene["points"] if p["model"] == name and "rtol" not in p]
        good = [p["cpu"] for p in mine if p["integration"] <= SMALL * error]
        if not error < math.inf or not good:
            lost.append(name)
            continue
        kind = name.split("modes, ")[-1].split("mode, ")[-1]
        drawn.setdefault(kind, []).append((min(good), error))
        if kind != "rigid":
            axis.annotate(
                name.split()[0], (min(good), _drawn(error)), textcoords="offset points",
                xytext=(6, 3), fontsize=8,
            )  # fmt: skip
    for k, (kind, points) in enumerate(drawn.items()):
        axis.plot(
            [x for x, _ in points], [_drawn(y) for _, y in points], KINDS.get(kind, CUT),
            linestyle="-", linewidth=0.8, color=f"C{k}", markersize=6, label=kind,
        )  # fmt: skip
    if lost:
        axis.annotate(
            "diverged: " + "; ".join(lost), (0.02, 0.98), xycoords="axes fraction", va="top",
            fontsize=7, wrap=True,
        )  # fmt: skip
    title = f"numbers: modes per link or segment\ndefault: {scene['default']['model']}"
    axis.legend(fontsize=8, loc="lower left", title=title, title_fontsize=8)


def _draw_runs(axis: Any, scene: Row) -> None:
    """Every run, the Pareto line, and the default."""
    _prepare(axis, "Both: every run, distance from the truth", scene)
    names = dict.fromkeys(p["integrator"] for p in scene["points"])
    for name in names:
        mine = [p for p in scene["points"] if p["integrator"] == name]
        axis.plot(
            [p["cpu"] for p in mine], [_drawn(p["total"]) for p in mine], ".",
            color=_colour(name), alpha=0.45, markersize=5 if name in INTEGRATORS else 7,
            rasterized=True, label=name if name in INTEGRATORS else f"SciPy {name}",
        )  # fmt: skip
    front = scene["front"]
    axis.step(
        [p["cpu"] for p in front], [_drawn(p["total"]) for p in front], "k-", where="post",
        linewidth=1.4, label="Pareto line",
    )  # fmt: skip
    _draw_default(axis, scene, "total")
    axis.legend(fontsize=7, loc="lower left")


def _draw_default(axis: Any, scene: Row, error: str) -> None:
    """A star where the default is."""
    for point in scene["points"]:
        if point["default"]:
            axis.plot(
                point["cpu"], _drawn(point[error]), "*", color="gold", markeredgecolor="k",
                markersize=15, zorder=5, label="default",
            )  # fmt: skip


def table(results: Row) -> str:
    """Per scene the cheapest runs within each target, and the default's place."""
    machine = results["machine"]
    lines = [
        "# Speed against accuracy: the cheapest runs",
        "",
        f"Made by `{results['command']}` on {machine['cores']} cores ({machine['processor']}), "
        f"commit {results['commit']}. Errors are the largest distance of the tip from the truth "
        "over the reach; cost is CPU time of one environment in a batch of "
        f"{results['batch']}, one thread, per simulated second.",
        "",
    ]
    for scene in results["scenes"].values():
        lines += [
            f"## {scene['title']}", "",
            f"Truth good to {scene['floor']:.1e} of the reach ({scene['reach [m]']:.4g} m).", "",
            "| error wanted | model | integrator | step [ms] | CPU [us/s] | error | of it model |",
            "|---|---|---|---:|---:|---:|---:|",
        ]  # fmt: skip
        for target in TARGETS:
            found = cheapest(scene, target)
            none = f"| {target:.0e} | none | | | | | |"
            lines.append(_line(f"{target:.0e}", found, scene) if found else none)
        default = next(p for p in scene["points"] if p["default"])
        lines.append(_line("default", default, scene))
        equal = cheapest(scene, default["total"])
        if equal is not None:
            lines.append(_line("as good as it", equal, scene))
        lines.append("")
    return "\n".join(lines)


def cheapest(scene: Row, target: float) -> Row | None:
    """The cheapest run whose tip stays within `target` of the truth, if there is one."""
    good = [p for p in scene["front"] if p["total"] <= target]
    return min(good, key=lambda p: p["cpu"], default=None)


def _line(label: str, point: Row, scene: Row) -> str:
    cells = [
        label, point["model"], point["integrator"],
        f"{1e3 * point['dt']:.3g}" if "dt" in point else "",
        f"{1e6 * point['cpu']:.3g}", f"{point['total']:.1e}",
        f"{scene['models'][point['model']]['model error']:.1e}",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"
