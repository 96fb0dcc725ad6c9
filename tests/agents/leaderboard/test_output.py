"""Files and pictures of a leaderboard, from entries made by hand."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.leaderboard import charts
from agents.leaderboard.output import leaders, write
from agents.leaderboard.statistics import Entry, Spectrum, compared, figures
from agents.metrics import METRICS, Best

REACH, TRACK = "FlexArm/OneLink-Reach-v0", "FlexArm/OneLink-Track-v0"
FREQUENCY = np.linspace(0.0, 25.0, 101)


def entry(score: Any, share: float = 1.0, bounded: bool = False) -> Entry:
    """A controller with scores (runs, episodes) in episodes of 3 s; 0 stands for a failure."""
    score = np.array(score, float)
    metrics = {name: np.where(score > 0.0, 0.1 + score, np.inf) for name in METRICS}
    metrics |= {"score": score, "success": np.sign(score)}
    metrics["settling_time"] = np.where(score > 0.0, 3.0 * (1.0 - score), np.inf)
    best = Best("settling_time", np.full(score.shape[1], 0.3)) if bounded else None
    found = figures(metrics, np.array([0.5, 1.5]), 0.02, best)
    return Entry(found, metrics, Spectrum(FREQUENCY, np.ones_like(FREQUENCY), share))


@pytest.fixture
def results() -> charts.Results:
    return {
        REACH: {
            "state": compared(
                {
                    "pd": entry([[0.2, 0.4, 0.3, 0.9]], bounded=True),
                    "ppo": entry([[0.8, 0.4, 0.6, 0.1], [0.8, 0.5, 0.6, 0.7]], bounded=True),
                    "zero": entry([[0.0, 0.0, 0.0, 0.0]], share=0.0, bounded=True),
                }
            ),
            "laboratory": compared(
                {
                    "pd": entry([[0.0, 0.0, 0.0, 0.3]], share=0.25),
                    "lqg": entry([[0.5, 0.6, 0.7, 0.8]]),
                }
            ),
        },
        TRACK: {"state": compared({"pd": entry([[0.5, 0.5, 0.5, 0.5]])})},
    }


def test_files_hold_every_figure_and_every_episode(results: Any, tmp_path: Path) -> None:
    write(tmp_path, results, [7, 8, 9, 10])
    stored = json.loads((tmp_path / "leaderboard.json").read_text())
    assert {task: {t: set(x) for t, x in tracks.items()} for task, tracks in stored.items()} == {
        REACH: {"state": {"pd", "ppo", "zero"}, "laboratory": {"pd", "lqg"}},
        TRACK: {"state": {"pd"}},
    }
    found = stored[REACH]["state"]["ppo"]
    assert found["improvement"]["pd"]["p"] == (1.0 + 0.75 + 1.0 + 0.0) / 4
    assert set(found["improvement"]) == {"pd", "zero"}
    assert stored[REACH]["state"]["zero"]["settling_median"] is None
    with open(tmp_path / "leaderboard.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 7
    (row,) = [r for r in rows if r["controller"] == "ppo" and r["run"] == "1" and r["seed"] == "9"]
    assert (row["task"], row["track"], float(row["score"])) == (REACH, "state", 0.6)


def test_the_page_shows_the_best_first_and_how_sure_that_is(results: Any, tmp_path: Path) -> None:
    write(tmp_path, results, [7, 8, 9, 10])
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert text.index("| ppo |") < text.index("| pd |") < text.index("| zero |")
    assert "| OneLink-Reach-v0 | state | ppo | pd | 69 % [" in text
    assert "| OneLink-Reach-v0 | laboratory | lqg | pd | 100 % [100, 100] |" in text
    assert "| OneLink-Track-v0 | state |" not in text  # nobody to compare with
    for file in charts.pictures(results):
        assert f"]({file})" in text
    assert "| 1, 1.5 | 20 |" in text  # decisions beside the control step


def test_idle_controllers_are_no_runners_up(results: Any) -> None:
    found = {name: entry([[x, x]]).figures for name, x in (("a", 0.5), ("zero", 0.1))}
    tables = {REACH: {"state": found}}
    assert "zero" not in leaders(tables)


def test_pictures_show_what_there_is(results: Any) -> None:
    """No idle controllers, no spectrum of few episodes, no point of a controller that fails."""
    drawn = {name: draw() for name, draw in charts.pictures(results).items()}
    panels = {
        name: [(axis.get_title(), axis.get_legend_handles_labels()[1]) for axis in figure.axes]
        for name, figure in drawn.items()
    }
    assert panels["leaderboard_profiles_state.png"] == [
        ("OneLink-Reach-v0", ["ppo", "pd"]),
        ("OneLink-Track-v0", ["pd"]),
    ]
    assert panels["leaderboard_spectra_laboratory.png"] == [("OneLink-Reach-v0", ["lqg"])]
    regret = drawn["leaderboard_regret.png"].axes
    assert [axis.get_title() for axis in regret] == ["OneLink-Reach-v0, state"]
    assert [label.get_text() for label in regret[0].get_yticklabels()] == ["pd", "ppo"]
    assert [axis.get_title() for axis in drawn["leaderboard_settling.png"].axes] == [
        "OneLink-Reach-v0"
    ]
    assert (
        len(drawn["leaderboard_settling.png"].axes[0].containers) == 3
    )  # pd failed in the laboratory
    assert set(drawn) == {
        "leaderboard.png",
        "leaderboard_regret.png",
        "leaderboard_settling.png",
        *(f"leaderboard_{kind}_{track}.png" for kind in ("profiles", "spectra")
          for track in ("state", "laboratory")),
    }  # fmt: skip


def test_pictures_without_bounds_and_resting_targets_are_left_out(results: Any) -> None:
    names = set(charts.pictures({TRACK: results[TRACK]}))
    assert names == {
        "leaderboard.png", "leaderboard_profiles_state.png", "leaderboard_spectra_state.png"
    }  # fmt: skip


def test_a_dozen_controllers_look_different() -> None:
    looks = charts.looks_of({REACH: {"state": {f"c{k}": entry([[0.5, 0.5]]) for k in range(12)}}})
    seen = {(x["color"], x["marker"], str(x["linestyle"])) for x in looks.values()}
    assert len(seen) == 12
    assert len({(x["color"], str(x["linestyle"])) for x in looks.values()}) == 12
