"""Pictures of the peers' benchmark, from its stored results."""

from pathlib import Path
from typing import Any

from benchmarks import style
from benchmarks.output import save_figure

LARGE = 14  # [pt] text of the headline, which a README shows at two thirds of its size
APART = 2.0  # ratio of errors from one drawn run to the next
COST = "processor time per simulated second [s]"
ERROR = "largest tip error / reach"
Row = dict[str, Any]
plt = style.pyplot()


def draw(results: Row, path: Path) -> None:
    """Draw a panel per scene: each engine's cheapest runs, and the errors that are demanded."""
    scenes = results["scenes"].values()
    figure, axes = plt.subplots(1, len(scenes), figsize=(16.0, 5.8), layout="constrained")
    for axis, scene in zip(axes, scenes, strict=True):
        draw_lines(axis, scene["lines"])
        demanded = {r["error"] for r in results["comparisons"] if r["scene"] == scene["title"]}
        for error in demanded:
            axis.axhline(error, color="0.5", linewidth=1.0, linestyle=":")
        axis.set_title(scene["title"], fontsize=13)
        axis.set_xlabel(COST, fontsize=12)
    axes[0].set_ylabel(ERROR, fontsize=12)
    _legend(figure, axes[0], 12, 5)
    save_figure(figure, path)


def headline(results: Row, path: Path) -> None:
    """Draw error against speed for a README: large text, one panel per scene."""
    scenes = results["scenes"].values()
    figure, axes = plt.subplots(
        1, len(scenes), figsize=(12.0, 5.0), sharey=True, layout="constrained"
    )
    for axis, scene in zip(axes, scenes, strict=True):
        draw_lines(axis, scene["lines"], linewidth=2.5, markersize=8)
        words = scene["title"].split(": ")[-1]
        axis.set_title(words[0].upper() + words[1:], fontsize=LARGE)
        axis.tick_params(labelsize=LARGE - 2)
    axes[0].set_ylabel(ERROR, fontsize=LARGE)
    figure.supxlabel(f"{COST}: further left is faster", fontsize=LARGE)
    _legend(figure, axes[0], LARGE - 1, 3)
    save_figure(figure, path)


def draw_lines(axis: Any, lines: dict[str, list[Row]], **changes: Any) -> None:
    """Draw every engine's cheapest runs, at errors that are at least APART from each other."""
    for engine, runs in lines.items():
        line = sorted(runs, key=lambda p: p["cpu_seconds_per_second"])
        line = style.thinned(line, [p["error"] for p in line], APART)
        axis.plot(
            [p["cpu_seconds_per_second"] for p in line], [p["error"] for p in line], label=engine,
            **{"linewidth": 2.0, "markersize": 7, **style.engine(engine), **changes},
        )  # fmt: skip
    axis.set(xscale="log", yscale="log")
    axis.grid(alpha=0.3)


def _legend(figure: Any, axis: Any, size: int, columns: int) -> None:
    """Draw a legend with our lines first; it fills column by column."""
    pairs = sorted(zip(*axis.get_legend_handles_labels(), strict=True), key=_theirs)
    figure.legend(
        [line for line, _ in pairs], [name.replace("ours", "flexarm") for _, name in pairs],
        loc="outside upper center", ncols=columns, fontsize=size, frameon=False,
    )  # fmt: skip


def _theirs(pair: tuple[Any, str]) -> bool:
    return not pair[1].startswith("ours")
