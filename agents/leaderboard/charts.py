"""Picture of a leaderboard: scores of all controllers, one panel per task."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agents.figures import COLOURS, new_figure, save_figure, tidy

LOOKS = {  # colour, marker and place of a track
    "state": (COLOURS[0], "o", 0.22),
    "laboratory": (COLOURS[1], "s", 0.0),
    "transfer": (COLOURS[3], "^", -0.22),
}
COLUMNS = 4
IDLE = ("zero", "random")  # not drawn


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw the interquartile means of the score with their intervals."""
    columns = min(COLUMNS, len(results))
    rows = math.ceil(len(results) / columns)
    figure = new_figure(4.2 * columns, 3.2 * rows, dpi=110)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    shown: dict[str, Any] = {}
    for axis, (env_id, tracks) in zip(axes, results.items(), strict=False):
        shown |= _panel(axis, tracks)
        axis.set(xlim=(-0.02, 1.0), title=env_id.removeprefix("FlexArm/"))
        tidy(axis)
    for axis in axes[len(results) :]:
        axis.set_axis_off()
    figure.legend(
        list(shown.values()), list(shown), loc="outside upper center", ncols=3, frameon=False
    )
    figure.supxlabel("score: mean of the middle half of the test episodes, 95 % interval")
    save_figure(figure, path)


def _panel(axis: Any, tracks: Mapping[str, Any]) -> dict[str, Any]:
    """Draw one task; return the tracks' handles for the legend."""
    every = dict.fromkeys(name for found in tracks.values() for name in found)
    names = [name for name in every if name not in IDLE][::-1]
    shown = {}
    for track, found in tracks.items():
        color, marker, off = LOOKS[track]
        for name in [name for name in names if name in found]:
            x, (low, high) = found[name]["score_iqm"], found[name]["score_ci"]
            error = [[max(x - low, 0.0)], [max(high - x, 0.0)]]
            shown[track] = axis.errorbar(
                x, names.index(name) + off, xerr=error, color=color, marker=marker, markersize=6,
                linewidth=1.5,
            )  # fmt: skip
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(-0.5, len(names) - 0.5)
    return shown
