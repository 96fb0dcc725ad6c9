"""Pictures of a leaderboard, each with a panel per task.

Controllers differ in marker and dashes as well as in colour; where colours stand for tracks, the
place or the marker tells controllers apart. No two controllers share a marker and its filling.
"""

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from agents.environments import title
from agents.figures import COLOURS, MARKERS, look, new_figure, tidy
from agents.leaderboard.bound import is_moving
from agents.leaderboard.kinds import KINDS
from agents.leaderboard.replay import OPTIMAL
from agents.leaderboard.statistics import Entry, Figures, profile
from dynamics.types import AnyArray
from flexarm_env import IDS

Results = Mapping[str, Mapping[str, Mapping[str, Entry]]]  # by task, track and controller

LETTERS = 9.5  # of a label in an inch
TRACK_LOOKS = {  # colour, marker and place
    "state": (COLOURS[0], "o", 0.27),
    "laboratory": (COLOURS[1], "s", 0.09),
    "transfer": (COLOURS[3], "^", -0.09),
    "wide": (COLOURS[4], "D", -0.27),
}
KIND_COLOURS = dict(
    zip((*KINDS, None), (COLOURS[2], COLOURS[1], COLOURS[0], COLOURS[7]), strict=True)
)
COLUMNS = 4
LINE = 0.21  # [in] of a controller in a panel
UNRANKED = ("zero", "random", OPTIMAL)  # not drawn
BEST = 5  # lines in a panel
FILLINGS: tuple[dict[str, Any], ...] = (  # of markers, the next where all markers are used
    {},
    {"markerfacecolor": "white"},
    {"fillstyle": "bottom", "markerfacecoloralt": "white"},
    {"fillstyle": "left", "markerfacecoloralt": "white"},
)
LEVELS = np.linspace(0.0, 1.0, 51)  # [-] scores of a profile


def pictures(results: Results) -> dict[str, Callable[[], Figure]]:
    """Functions that draw the pictures of these results, by file name."""
    tracks = dict.fromkeys(track for found in results.values() for track in found)
    found: dict[str, Callable[[], Figure]] = {"leaderboard.png": partial(scores, results)}
    for track in tracks:
        found[f"leaderboard_profiles_{track}.png"] = partial(profiles, results, track)
    if bounded(results):
        found["leaderboard_regret.png"] = partial(regrets, results)
    if resting(results):
        found["leaderboard_settling.png"] = partial(settling, results)
    found["leaderboard_decisions.png"] = partial(decisions, results)
    for track in tracks:
        found[f"leaderboard_spectra_{track}.png"] = partial(spectra, results, track)
    return found


def scores(results: Results) -> Figure:
    """Interquartile means of the score with their intervals, by track."""
    ranked = [
        [name for name in dict.fromkeys(chain(*tracks.values())) if name not in UNRANKED][::-1]
        for tracks in results.values()
    ]
    tallest = max(3.2, LINE * max(map(len, ranked)))
    figure, axes = panels([title(env_id) for env_id in results], tallest)
    for axis, names, tracks in zip(axes, ranked, results.values(), strict=True):
        for track, found in tracks.items():
            color, marker, off = TRACK_LOOKS[track]
            for name in [name for name in names if name in found]:
                x, (low, high) = (found[name].figures[key] for key in ("score_iqm", "score_ci"))
                axis.errorbar(
                    x, names.index(name) + off, xerr=beside(x, low, high), color=color,
                    marker=marker, markersize=6, linewidth=1.5,
                )  # fmt: skip
        axis.set_yticks(range(len(names)), names)
        axis.set(xlim=(-0.02, 1.0), ylim=(-0.7, len(names) - 0.3))
    legend(figure, track_handles(results))
    entitle_axes(figure, "score: mean of the middle half of the test episodes, 95 % interval")
    return figure


def profiles(results: Results, track: str) -> Figure:
    """Shares of episodes above every score, with 95 % bands, of a track's best controllers."""
    figure, axes, shown = panels_of(results, track)
    looks = looks_of(results)
    for axis, found in zip(axes, shown, strict=True):
        for k, name in enumerate(best(found)):
            share, low, high = profile(found[name].metrics["score"], LEVELS)
            axis.plot(LEVELS, share, markevery=(2 * k, 10), label=name, **looks[name])
            colour = looks[name]["color"]
            axis.fill_between(LEVELS, low, high, color=colour, alpha=0.15, linewidth=0.0)
        axis.set(xlim=(0.0, 1.0), ylim=(-0.02, 1.02))
    legend(figure, handles_of(axes))
    entitle_axes(figure, f"score, {track}; 95 % bands", "share of episodes above")
    return figure


def regrets(results: Results) -> Figure:
    """Losses of controllers to the best that is known, with intervals.

    Bars of the regret where the target rests; on a path, points of the excess of the RMS tip error,
    on a logarithmic scale.
    """
    shown = bounded(results)
    figure, axes = panels([f"{title(env_id)}\n{track}" for env_id, track in shown])
    for axis, (env_id, track) in zip(axes, shown, strict=True):
        drawn = excess_points if is_moving(env_id) else regret_bars
        drawn(axis, results[env_id][track], TRACK_LOOKS[track][0])
    entitle_axes(
        figure,
        "regret: settling time over the best known, less 1; "
        "excess: RMS tip error less the smallest",
    )
    return figure


def regret_bars(axis: Any, found: Mapping[str, Entry], colour: str) -> None:
    """Bars of the regrets of controllers in a panel, the least on top."""
    for k, (x, low, high) in enumerate(_sorted(axis, found, "regret", 100.0)):
        axis.barh(k, x, xerr=beside(x, low, high), color=colour, alpha=0.75, capsize=3)
        axis.annotate(f" {x:.0f}", (high, k), va="center", fontsize=8)
    axis.set(xlim=(0.0, 450.0), xlabel="regret [%]")


def excess_points(axis: Any, found: Mapping[str, Entry], colour: str) -> None:
    """Points of the excesses of controllers in a panel, the least on top; none of failures."""
    for k, (x, low, high) in enumerate(_sorted(axis, found, "excess", 1e3)):
        if math.isinf(x):
            axis.annotate(" failed", (0.0, k), ("axes fraction", "data"), va="center", fontsize=8)
            continue
        end = high if math.isfinite(high) else x
        axis.errorbar(x, k, xerr=beside(x, low, end), color=colour, marker="o", capsize=3)
        beyond = "" if math.isfinite(high) else " to failed"
        axis.annotate(f" {x:.3g}{beyond}", (end, k), va="center", fontsize=8)
    axis.set(xscale="log", xlabel="excess [mm]")
    low, high = axis.get_xlim()
    axis.set_xlim(low, 3.0 * high)
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter("")


def _sorted(
    axis: Any, found: Mapping[str, Entry], name: str, factor: float
) -> list[tuple[float, ...]]:
    """Values of a figure with their intervals, the largest first; the axis bears the names."""
    values = {
        key: tuple(factor * x for x in (entry.figures[f"{name}_iqm"], *entry.figures[f"{name}_ci"]))
        for key, entry in found.items()
        if key not in UNRANKED
    }
    names = sorted(values, key=values.__getitem__, reverse=True)
    axis.set_yticks(range(len(names)), names)
    return [values[key] for key in names]


def settling(results: Results) -> Figure:
    """Settling time against residual vibration, medians with quartiles, of all that settle."""
    shown = resting(results)
    figure, axes = panels([title(env_id) for env_id in shown])
    points = points_of(results)
    drawn: dict[str, Any] = {}
    for axis, env_id in zip(axes, shown, strict=True):
        longest = IDS[env_id]["max_episode_steps"] * IDS[env_id]["kwargs"]["control_dt"]
        for track, found in results[env_id].items():
            for name in [x for x in points if x in found and settles(found[x])]:
                x, left, right = _middle(found[name], "settling")
                y, low, high = _middle(found[name], "residual_vibration", 1e3)
                drawn[name] = points[name]
                axis.errorbar(
                    x, y, xerr=beside(x, left, min(right, longest)), yerr=beside(y, low, high),
                    color=TRACK_LOOKS[track][0], linewidth=1.0, **points[name],
                )  # fmt: skip
        axis.set(yscale="log", xlim=(0.0, longest))
    markers = {
        name: Line2D([], [], color="black", linestyle="", **drawn[name])
        for name in points
        if name in drawn
    }
    tracks = track_handles(results)
    for handle in tracks.values():
        handle.set_marker("")  # a marker stands for a controller
    legend(figure, tracks | markers)
    entitle_axes(figure, "settling time [s]: median and quartiles", "residual vibration [mm]")
    return figure


def spectra(results: Results, track: str) -> Figure:
    """Spectra of the curvature at the links' roots after reaching the target, of a track's best.

    Only of controllers that reach it in half of the episodes or more.
    """
    figure, axes, shown = panels_of(results, track)
    looks = looks_of(results)
    for axis, found in zip(axes, shown, strict=True):
        for k, name in enumerate(best(found)):
            frequency, density, share = found[name].spectrum
            axis.set_xlim(0.0, frequency[-1])
            if share >= 0.5:
                every = (4 * k, len(frequency) // 6)
                axis.plot(frequency, np.sqrt(density), markevery=every, label=name, **looks[name])
        axis.set_yscale("log")
    legend(figure, handles_of(axes))
    entitle_axes(
        figure,
        f"frequency [Hz], {track}; from where the tip first reached the target",
        "curvature [1/m/√Hz]",
    )
    return figure


def decisions(results: Results) -> Figure:
    """Score against the time of a decision, from the median to the 99 % time, by kind and track.

    A dotted line is the control step; a controller whose 99 % time is beyond it is hollow.
    """
    figure, axes = panels([title(env_id) for env_id in results])
    for axis, tracks in zip(axes, results.values(), strict=True):
        for track, found in tracks.items():
            for name in [name for name in found if name not in UNRANKED]:
                _decision(axis, found[name].figures, TRACK_LOOKS[track][1])
        axis.set(xscale="log", ylim=(-0.03, 1.03))
    black = partial(Line2D, [], [], color="black")
    handles = {kind: Line2D([], [], color=KIND_COLOURS[kind], linewidth=3.0) for kind in KINDS}
    for track in track_handles(results):
        handles[track] = black(linestyle="", marker=TRACK_LOOKS[track][1])
    handles["99 % time beyond the control step"] = black(
        linestyle="", marker="o", markerfacecolor="white"
    )
    handles["control step"] = black(linewidth=1.0, linestyle=":")
    legend(figure, handles)
    entitle_axes(
        figure,
        "decision [ms], from the median to the 99 % time",
        "score: mean of the middle half of the test episodes",
    )
    return figure


def _decision(axis: Any, x: Figures, marker: str) -> None:
    median, slow = x["ms_per_action"], x["ms_per_action_p99"]
    colour, step = KIND_COLOURS[x["kind"]], x["ms_control_step"]
    axis.axvline(step, color="black", linewidth=1.0, linestyle=":")
    axis.plot([median, slow], 2 * [x["score_iqm"]], color=colour, linewidth=1.0, alpha=0.4)
    axis.plot(
        median, x["score_iqm"], color=colour, marker=marker, markersize=5,
        markerfacecolor=colour if slow <= step else "white",
    )  # fmt: skip


def settles(entry: Entry) -> bool:
    """True if three quarters of the episodes end without a failure, and half of them settled."""
    known = [entry.figures["settling_median"], *entry.figures["residual_vibration_quartiles"]]
    return bool(np.isfinite(known).all())


def bounded(results: Results) -> list[tuple[str, str]]:
    """Tasks and tracks whose controllers have a regret."""
    return [
        (env_id, track)
        for env_id, tracks in results.items()
        for track, found in tracks.items()
        if any(entry.figures["regret_iqm"] is not None for entry in found.values())
    ]


def resting(results: Results) -> list[str]:
    """Tasks with a resting target."""
    return [env_id for env_id in results if not is_moving(env_id)]


def best(found: Mapping[str, Entry]) -> list[str]:
    """Controllers with the highest scores, best first."""
    names = [name for name in found if name not in UNRANKED]
    return sorted(names, key=lambda name: -found[name].figures["score_iqm"])[:BEST]


def panels_of(results: Results, track: str) -> tuple[Figure, list[Any], list[Mapping[str, Entry]]]:
    """A figure with a panel per task of a track, and the controllers of each."""
    shown = {env_id: tracks[track] for env_id, tracks in results.items() if track in tracks}
    return *panels([title(env_id) for env_id in shown]), list(shown.values())


def panels(titles: list[str], height: float = 3.2) -> tuple[Figure, list[Any]]:
    """A figure with a panel per title; their height [in]."""
    columns = min(COLUMNS, len(titles))
    rows = math.ceil(len(titles) / columns)
    figure = new_figure(4.2 * columns, height * rows, dpi=110)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axis, text in zip(axes, titles, strict=False):
        axis.set_title(text)
        tidy(axis)
    for axis in axes[len(titles) :]:
        axis.set_axis_off()
    return figure, axes[: len(titles)]


def entitle_axes(figure: Figure, x: str, y: str = "") -> None:
    """Labels of the axes of all panels, on as many lines as the figure needs."""
    width, height = (round(LETTERS * inches) for inches in figure.get_size_inches())
    figure.supxlabel(textwrap.fill(x, width))
    if y:
        figure.supylabel(textwrap.fill(y, height))


def looks_of(results: Results) -> dict[str, dict[str, Any]]:
    """Colour, marker and dashes of every controller, equal in all pictures."""
    every = (name for tracks in results.values() for found in tracks.values() for name in found)
    names = [name for name in dict.fromkeys(every) if name not in UNRANKED]
    return {name: look(k) for k, name in enumerate(names)}


def points_of(results: Results) -> dict[str, dict[str, Any]]:
    """Marker and filling of every controller, which no other has."""
    return {
        name: {
            "marker": MARKERS[k % len(MARKERS)],
            "markersize": 6,
            **FILLINGS[k // len(MARKERS) % len(FILLINGS)],
        }
        for k, name in enumerate(looks_of(results))
    }


def beside(x: float, low: float, high: float) -> AnyArray:
    """(2, 1) lengths of an error bar."""
    return np.array([[max(x - low, 0.0)], [max(high - x, 0.0)]])


def track_handles(results: Results) -> dict[str, Any]:
    """Handles for a legend of tracks."""
    tracks = dict.fromkeys(track for found in results.values() for track in found)
    looks = ((track, *TRACK_LOOKS[track][:2]) for track in tracks)
    return {
        track: Line2D([], [], color=color, marker=marker, linewidth=1.5)
        for track, color, marker in looks
    }


def handles_of(axes: Iterable[Any]) -> dict[str, Any]:
    """Handles of all labelled lines, for one legend."""
    lines = (line for axis in axes for line in axis.get_legend_handles_labels()[0])
    return {line.get_label(): line for line in lines}


def legend(figure: Figure, handles: Mapping[str, Any]) -> None:
    """One legend above all panels, in as many columns as the figure is wide enough for."""
    for columns in range(len(handles), 0, -1):
        found = figure.legend(
            list(handles.values()), list(handles), loc="outside upper center", ncols=columns,
            frameon=False,
        )  # fmt: skip
        if columns == 1 or found.get_window_extent().width <= figure.bbox.width:
            return
        found.remove()


def _middle(entry: Entry, name: str, factor: float = 1.0) -> list[float]:
    """Median and quartiles of a metric."""
    values = [entry.figures[f"{name}_median"], *entry.figures[f"{name}_quartiles"]]
    return [factor * value for value in values]
