"""Charts and page of the work-precision benchmark, and its stored results.

They are packed JSON, in which an infinite error is the word "diverged".
"""

import json
import math
from itertools import groupby
from pathlib import Path
from typing import Any

from agents.files import pack, unpacked
from benchmarks import style
from benchmarks.output import RESULTS, paragraphs, save_figure, table
from dynamics.integrators.table import INTEGRATORS

STORED = RESULTS / "work_precision.json.bz2"
TARGETS = (1e-2, 1e-3, 1e-4)  # [reach]
SMALL = 0.3  # largest integration error over model error of a run that shows the model error
LOST = "every run diverged"  # of a model, at the cost of the costliest
LOOKS = {  # kind of a model: its colour and marker
    "rigid": ("k", "P"),
    "linear": (style.BLUE, "o"),
    "linear, in segments": (style.BLUE, "D"),
    "foreshortened": (style.VERMILLION, "o"),
    "foreshortened, in segments": (style.VERMILLION, "D"),
    LOST: ("k", "x"),
}
LOWEST, HIGHEST = 3e-8, 2.0  # errors drawn; diverged runs lie at 1
NEAR = 2.5  # models within this ratio of costs and of errors share one label
APART = 2.0  # least ratio of the errors of neighbouring points of a line
STEP = "The step: distance from the model's own exact motion"
MODEL = "The model: distance of its exact motion from the truth"
BOTH = "Both added: the cheapest runs"
PEERS = {"S1": "S1", "S3": "S3", "korayem-two-link": "korayem"}  # scene: name in peers.json
STAR: dict[str, Any] = {
    "color": "gold", "markeredgecolor": "k", "markersize": 18, "zorder": 5, "linestyle": "none",
}  # fmt: skip
CODE = "modes x segments, f: foreshortened"
BELOW: dict[str, Any] = {  # legend below the axes, where it hides no run
    "loc": "upper center", "bbox_to_anchor": (0.5, -0.08), "ncols": 2, "fontsize": 10,
    "title_fontsize": 10, "columnspacing": 1.0, "handletextpad": 0.4, "frameon": False,
}  # fmt: skip
COLUMNS = (
    "wanted", "model", "integrator", "step [ms]", "CPU [us/s]", "error", "of the model",
    "of the step", "measured",
)  # fmt: skip
Row = dict[str, Any]
Place = tuple[float, float, str]  # CPU time, error, model
Lines = dict[str, list[Row]]  # a peer: its cheapest runs
plt = style.pyplot()


def store(results: Row, file: Path) -> None:
    """Write results that are plain JSON."""
    pack(json.dumps(results, separators=(",", ":")), file)


def stored_results(file: Path) -> Row:
    """Results that a file holds."""
    found: Row = json.loads(unpacked(file).replace('"diverged"', "Infinity"))
    return found


def draw(results: Row, folder: Path, peers: Path = RESULTS / "peers.json") -> None:
    """Draw a figure per scene (step, model, both errors), and one of all scenes."""
    scenes, theirs = results["scenes"], peer_lines(peers)
    for name, scene in scenes.items():
        figure, axes = plt.subplots(1, 3, figsize=(16.0, 7.6), sharey=True, layout="constrained")
        _draw_steps(axes[0], scene)
        draw_models(axes[1], scene)
        _draw_runs(axes[2], scene, theirs.get(name, {}))
        axes[2].legend(**BELOW)
        axes[0].set_ylabel("tip error / reach [-]", fontsize=12)
        figure.suptitle(scene["title"], fontsize=14)
        scipy = " (SciPy and peers: one environment)"
        figure.supxlabel(_cost_label(results) + scipy, fontsize=12)
        save_figure(figure, folder / f"work_precision_{name}")
    columns = min(3, len(scenes))
    rows = math.ceil(len(scenes) / columns)
    figure, grid = plt.subplots(
        rows, columns, figsize=(5.4 * columns, 4.8 * rows), squeeze=False, sharey=True,
        layout="constrained",
    )  # fmt: skip
    found: dict[str, Any] = {}
    for axis, (name, scene) in zip(grid.flat, scenes.items(), strict=False):
        _draw_runs(axis, scene, theirs.get(name, {}))
        axis.set_title(scene["title"], fontsize=13)
        axis.set_ylim(2e-7, HIGHEST)
        handles, labels = axis.get_legend_handles_labels()
        found |= dict(zip(labels, handles, strict=True))
    for axis in grid[:, 0]:
        axis.set_ylabel("tip error / reach [-]", fontsize=12)
    figure.supxlabel(_cost_label(results) + " (peers: one environment)", fontsize=12)
    figure.legend(
        list(found.values()), list(found), loc="outside upper center", ncols=6, fontsize=12,
        frameon=False, title=f"models: {CODE}", title_fontsize=12,
    )  # fmt: skip
    save_figure(figure, folder / "work_precision")


def peer_lines(path: Path) -> dict[str, Lines]:
    """Lines of the peers by scene, from the results of `python -m benchmarks.peers`."""
    if not path.exists():
        return {}
    scenes = json.loads(path.read_text(encoding="utf-8"))["scenes"]
    return {
        name: {k: v for k, v in scenes[stored]["lines"].items() if not k.startswith("ours")}
        for name, stored in PEERS.items()
        if stored in scenes
    }


def _cost_label(results: Row) -> str:
    return (
        "CPU time per simulated second [s/s] of one environment in a batch of "
        f"{results['batch']}, one thread"
    )


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
    axis.set_title(title, fontsize=12)
    axis.grid(alpha=0.25)
    if title != STEP:
        axis.axhspan(
            LOWEST, scene["floor"], color="0.9", zorder=0, label="below the truth's accuracy"
        )


def _draw_steps(axis: Any, scene: Row) -> None:
    """Draw the integration error of the default model, a line per integrator.

    A cross marks the costliest diverged run of a method.
    """
    _prepare(axis, STEP, scene)
    model = scene["default"]["model"]
    runs = [p for p in scene["points"] if p["model"] == model]
    for name, group in groupby(runs, key=lambda p: p["integrator"]):
        mine = list(group)
        line = sorted((p for p in mine if p["integration"] < math.inf), key=lambda p: p["cpu"])
        line = style.thinned(line, [p["integration"] for p in line], APART**2)
        known, look = name in INTEGRATORS, style.method(name)
        axis.plot(
            [p["cpu"] for p in line], [_drawn(p["integration"]) for p in line],
            markersize=7, linewidth=1.8, linestyle="-" if known else ":", **look,
            label=f"{name} (order {INTEGRATORS[name].order})" if known else f"SciPy {name}",
        )  # fmt: skip
        diverged = [p["cpu"] for p in mine if p["integration"] == math.inf]
        if diverged:
            axis.plot(max(diverged), 1.0, "x", color=look["color"], markersize=9, mew=2.5)
    _draw_default(axis, scene, "integration")
    axis.legend(title=model, **BELOW)


def draw_models(axis: Any, scene: Row) -> None:
    """Draw each model's error over the least cost at which its integration error is small.

    Where every run diverged a cross marks the costliest, as that of a method in the left chart.
    """
    _prepare(axis, MODEL, scene)
    axis.margins(x=0.15)
    groups: dict[str, list[Place]] = {}
    for name, row in scene["models"].items():
        error = row["model error"]
        runs = [p for p in scene["points"] if p["model"] == name and "rtol" not in p]
        good = [p["cpu"] for p in runs if p["integration"] <= SMALL * error < math.inf]
        place = min(good) if good else max(p["cpu"] for p in runs)
        groups.setdefault(_kind(name, not good), []).append((place, _drawn(error), name))
    for kind, points in groups.items():
        colour, marker = LOOKS[kind]
        x, y, _ = zip(*points, strict=True)
        axis.plot(x, y, marker, color=colour, markersize=9, label=kind)
        own = [p[:2] for p in points if p[2] == scene["default"]["model"]]
        if own:
            axis.plot(*own[0], "*", label="default", **STAR)
        _label(axis, points, own[0] if own else (math.inf, math.inf))
    axis.legend(title=CODE, **BELOW)


def _kind(model: str, lost: bool) -> str:
    """Key of LOOKS of a model; `lost` if no run has a small integration error."""
    if model == "rigid":
        return model
    if lost:
        return LOST
    form = "foreshortened" if "foreshortened" in model else "linear"
    return f"{form}, in segments" if "segments" in model else form


def _draw_runs(axis: Any, scene: Row, theirs: Lines) -> None:
    """Draw the Pareto line with the method of each run, the default, and the peers' lines."""
    _prepare(axis, BOTH, scene)
    for engine, runs in theirs.items():
        ordered = sorted(runs, key=lambda p: p["cpu_seconds_per_second"])
        line = style.thinned(ordered, [p["error"] for p in ordered], APART**2)
        axis.plot(
            [p["cpu_seconds_per_second"] for p in line], [_drawn(p["error"]) for p in line],
            label=engine, linewidth=1.5, markersize=6,
            **style.engine(engine) | {"linestyle": "--", "markerfacecolor": "white"},
        )  # fmt: skip
    front = scene["front"]
    line = style.thinned(front, [p["error"] for p in front], APART)
    axis.plot(
        [p["cpu"] for p in line], [_drawn(p["error"]) for p in line], "k-", linewidth=1.6,
        label="our cheapest runs",
    )  # fmt: skip
    for name in INTEGRATORS:
        runs = [p for p in line if p["integrator"] == name]
        if runs:
            axis.plot(
                [p["cpu"] for p in runs], [_drawn(p["error"]) for p in runs], linestyle="none",
                **style.method(name), markersize=9, label=name,
            )  # fmt: skip
    first: dict[str, Row] = {}
    for point in line:
        first.setdefault(point["model"], point)
    star = _default(scene, "error")
    _label(axis, [(p["cpu"], _drawn(p["error"]), name) for name, p in first.items()], star)
    _draw_default(axis, scene, "error")


def _label(axis: Any, points: list[Place], star: tuple[float, float]) -> None:
    """Write the models of points beside them, those of near points together, none on the star."""
    names: dict[tuple[float, float], str] = {}  # by place
    for cost, error, model in points:
        near = [place for place in names if _are_near(place, (cost, error))]
        if near:
            names[near[0]] += f", {_short(model)}"
        else:
            names[cost, error] = _short(model)
    for place, text in names.items():
        below = _are_near(place, star)
        axis.annotate(
            text, place, textcoords="offset points", xytext=(-8, -14) if below else (7, 5),
            ha="right" if below else "left", fontsize=10, zorder=6,
        )  # fmt: skip


def _are_near(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return all(max(x / y, y / x) < NEAR for x, y in zip(a, b, strict=True))


def _draw_default(axis: Any, scene: Row, error: str) -> None:
    """Draw a star at the default."""
    axis.plot(*_default(scene, error), "*", label="default", **STAR)


def _default(scene: Row, error: str) -> tuple[float, float]:
    """CPU time and error of the default."""
    point = next(p for p in scene["points"] if p["default"])
    return point["cpu"], _drawn(point[error])


def page(results: Row) -> str:
    """Markdown page: the cheapest runs of every scene within each target, and the default."""
    parts = [
        "# Speed against accuracy: the cheapest runs",
        "Errors are distances of the tip over the reach, the largest of the motion; cost is CPU "
        "time per simulated second of one environment in a batch of "
        f"{results['batch']}, one thread. The error of a run is the sum of its model's and its "
        "step's, and at least the measured distance from the truth.",
    ]
    for scene in results["scenes"].values():
        made, machine = scene["made"], scene["made"]["machine"]
        parts += [
            f"## {scene['title']}",
            f"Made by `{made['command']}` on {machine['cores']} cores ({machine['processor']}), "
            f"commit {made['commit']}. Truth good to {scene['floor']:.1e} of the reach "
            f"({scene['reach [m]']:.4g} m).",
        ]
        default = next(p for p in scene["points"] if p["default"])
        wanted = {f"{target:.0e}": cheapest(scene, target) for target in TARGETS}
        wanted |= {"default": default, "as good as it": cheapest(scene, default["error"])}
        rows = [_cells(label, point, scene) for label, point in wanted.items()]
        parts.append(table(COLUMNS, rows, "lllr"))
    return paragraphs(*parts)


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
