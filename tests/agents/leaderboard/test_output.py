"""Files and pictures of a leaderboard, from entries made by hand."""

import bz2
import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.leaderboard import charts
from agents.leaderboard.output import (
    EPISODES,
    late,
    leaders,
    on_base,
    over_best,
    rivals,
    verdict,
    write,
)
from agents.leaderboard.statistics import Entry, Spectrum, compared, decisions, figures
from agents.leaderboard.stored import read
from agents.leaderboard.tracks import RANKED, TRACKS
from agents.metrics import METRICS, Best

REACH, TRACK = "FlexArm/OneLink-Reach-v0", "FlexArm/OneLink-Track-v0"
FREQUENCY = np.linspace(0.0, 25.0, 101)


SEEDS = [7, 8, 9, 10]
KNOWN = Best("settling_time", np.full(4, 0.3))
PATH = Best("tip_error_rms", np.full(4, 0.1))


def entry(
    score: Any, share: float = 1.0, best: Best | None = None, kind: str | None = "classical",
    base: str | None = None,
) -> Entry:  # fmt: skip
    """A controller with scores (runs, episodes) in episodes of 3 s; 0 stands for a failure."""
    score = np.array(score, float)
    metrics = {name: np.where(score > 0.0, 0.1 + score, np.inf) for name in METRICS}
    metrics |= {"score": score, "success": np.sign(score)}
    metrics["settling_time"] = np.where(score > 0.0, 3.0 * (1.0 - score), np.inf)
    found = figures(metrics, best) | decisions(np.array([9.0, 0.5, 1.5]), 0.02)
    found |= {"kind": kind, "base": base, "judged_late": 0.0}
    spectrum = Spectrum(FREQUENCY, np.ones_like(FREQUENCY), share)
    return Entry(found, metrics, spectrum, SEEDS[-score.shape[1] :])


@pytest.fixture
def results() -> charts.Results:
    return {
        REACH: {
            "state": compared(
                {
                    "pd": entry([[0.2, 0.4, 0.3, 0.9]], best=KNOWN),
                    "ppo": entry(
                        [[0.8, 0.4, 0.6, 0.1], [0.8, 0.5, 0.6, 0.7]], best=KNOWN, kind="learned"
                    ),
                    "zero": entry([[0.0, 0.0, 0.0, 0.0]], share=0.0, best=KNOWN),
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
    write(tmp_path, results, SEEDS)
    stored = json.loads((tmp_path / "leaderboard.json").read_text())
    assert {task: {t: set(x) for t, x in tracks.items()} for task, tracks in stored.items()} == {
        REACH: {"state": {"pd", "ppo", "zero"}, "laboratory": {"pd", "lqg"}},
        TRACK: {"state": {"pd"}},
    }
    found = stored[REACH]["state"]["ppo"]
    assert found["improvement"]["pd"]["p"] == (1.0 + 0.75 + 1.0 + 0.0) / 4
    assert set(found["improvement"]) == {"pd", "zero"}
    assert stored[REACH]["state"]["zero"]["settling_median"] is None
    with bz2.open(tmp_path / EPISODES, "rt", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 7
    (row,) = [r for r in rows if r["controller"] == "ppo" and r["run"] == "1" and r["seed"] == "9"]
    assert (row["task"], row["track"], float(row["score"])) == (REACH, "state", 0.6)


def test_trainings_are_counted_again_as_they_were_written(results: Any, tmp_path: Path) -> None:
    """One, two and none."""
    given = results[REACH]["state"]
    counts = {"pd": 1, "ppo": 2, "zero": 0}
    for name, count in counts.items():
        given[name].figures["training_seeds"] = count
    write(tmp_path, results, SEEDS)
    found = read(tmp_path, SEEDS)[REACH]["state"]
    assert {name: x.figures["training_seeds"] for name, x in found.items()} == counts


def test_figures_have_four_digits(results: Any, tmp_path: Path) -> None:
    figures = results[REACH]["state"]["ppo"].figures
    figures["score_mean"], figures["score_ci"] = 2.0 / 3.0, [1.0e-9 / 3.0, 123456789.0]
    figures["episodes"] = 123456789  # a count stays whole
    write(tmp_path, results, SEEDS)
    stored = json.loads((tmp_path / "leaderboard.json").read_text())[REACH]["state"]["ppo"]
    assert stored["score_mean"] == 0.6667
    assert stored["score_ci"] == [3.333e-10, 123500000.0]
    assert stored["episodes"] == 123456789


def test_the_page_shows_the_best_first_and_how_sure_that_is(results: Any, tmp_path: Path) -> None:
    write(tmp_path, results, SEEDS)
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert text.index("| ppo |") < text.index("| pd |") < text.index("| zero |")
    assert "| OneLink-Reach-v0 | state | ppo | pd | 69 % [" in text
    assert "| OneLink-Reach-v0 | laboratory | lqg | pd | 100 % [100, 100] |" in text
    assert "| OneLink-Track-v0 | state |" not in text.partition("## Kinds")[0]  # no runner-up
    for file in charts.pictures(results):
        assert f"]({file})" in text
    assert "control step 20 ms" in text
    assert "| 9, 1, 1.5 | 0.0 % |" in text  # decisions: the first, median and 99 %, and late ones
    assert "| ppo | learned | - | 100 % | 0.562 | 0.600 [" in text  # mean and interquartile mean


def test_idle_controllers_are_no_runners_up(results: Any) -> None:
    found = {name: entry([[x, x]]).figures for name, x in (("a", 0.5), ("zero", 0.1))}
    tables = {REACH: {"state": found}}
    assert "zero" not in leaders(tables)


def test_one_kind_leads_where_its_interval_is_above_all_others() -> None:
    """Scores that are alike in all episodes have an interval of no width; users' are no kind."""

    def leads(trained: Any, classical: Any) -> list[str]:
        found = {
            "pd": entry([[0.5] * 4]), "lqr": entry([classical]),
            "ppo": entry([trained], kind="learned"),
            "ppo-on-pd": entry([[0.6] * 4], kind="learned-on-model"),
            "my:Own": entry([[0.9] * 4], kind=None),
        }  # fmt: skip
        table = rivals({REACH: {"state": {k: x.figures for k, x in compared(found).items()}}})
        (line,) = table.splitlines()[4:]
        return line.strip("| ").split(" | ")

    cells = leads([0.8] * 4, [0.7] * 4)
    assert cells[:2] == ["OneLink-Reach-v0", "state"]
    assert cells[2] == "lqr 0.700 [0.700, 0.700]"
    assert cells[3:6] == ["ppo-on-pd 0.600 [0.600, 0.600]", "ppo 0.800 [0.800, 0.800]", "learned"]
    assert cells[6:] == ["-0.1000 [-0.1000, -0.1000]", "+0.1000 [+0.1000, +0.1000]"]
    assert leads([0.7] * 4, [0.8] * 4)[5] == "classical"
    assert leads([0.5, 0.8, 0.9, 0.7], [0.7] * 4)[5] == "none"
    alone = {"lqr": entry([[0.7] * 4]).figures}
    assert rivals({REACH: {"state": alone}}).endswith("[0.700, 0.700] | - | - | - | - | - |")


def test_a_gain_on_the_base_counts_where_its_interval_excludes_zero() -> None:
    """Half of the episodes better and half worse are none; without a ranked base there is none."""

    def gain(score: Any, base: str = "pd") -> tuple[str | None, str]:
        policy = entry([score], kind="learned-on-model", base=base)
        x = compared({"pd": entry([[0.5] * 8]), "policy": policy})["policy"].figures
        return verdict(x, base), on_base(x)

    assert gain([0.6] * 8) == ("gain", "+0.1000 [+0.1000, +0.1000]")
    assert gain([0.4] * 8) == ("loss", "-0.1000 [-0.1000, -0.1000]")
    found, text = gain([0.4, 0.6] * 4)
    assert found == "no gain"
    assert text.endswith("], no gain")
    assert gain([0.6] * 8, base="lqr") == (None, "-")


@pytest.mark.parametrize(
    ("share", "slow", "text"),
    [(0.125, 1.0, "12.5 %"), (None, 20.1, "≥ 1 %"), (None, 19.9, "≤ 1 %"), (0.0, 20.1, "0.0 %")],
)
def test_late_decisions_are_known_or_on_a_side_of_a_hundredth(
    share: float | None, slow: float, text: str
) -> None:
    figures = {"late_share": share, "ms_per_action_p99": slow, "ms_control_step": 20.0}
    assert late(figures | {"judged_late": 0.0}) == text
    if share:
        assert late(figures | {"judged_late": 0.24}) == f"{text}, 0.24 steps"


def test_slow_controllers_are_hollow_in_the_picture_of_decisions() -> None:
    found = {name: entry([[0.5] * 4]) for name in ("quick", "slow", "zero")}
    found["slow"].figures["ms_per_action_p99"] = 21.0
    (axis,) = charts.decisions({REACH: {"state": found}}).axes
    points = [line for line in axis.lines if line.get_marker() == "o"]
    assert [line.get_xydata().tolist() for line in points] == 2 * [[[1.0, 0.5]]]
    assert [line.get_markerfacecolor() == "white" for line in points] == [False, True]


def test_labels_of_axes_are_within_pictures_of_one_task(results: Any) -> None:
    """The page of controllers ranks one task."""
    for name, draw in charts.pictures({REACH: results[REACH]}).items():
        figure = draw()
        figure.canvas.draw()
        for text in figure.texts:
            (low, high), whole = text.get_window_extent().get_points(), figure.bbox.size
            assert (low >= 0.0).all(), name
            assert (high <= whole).all(), name


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
    assert [axis.get_title() for axis in regret] == ["OneLink-Reach-v0\nstate"]
    assert [label.get_text() for label in regret[0].get_yticklabels()] == ["pd", "ppo"]
    assert [axis.get_title() for axis in drawn["leaderboard_settling.png"].axes] == [
        "OneLink-Reach-v0"
    ]
    assert (
        len(drawn["leaderboard_settling.png"].axes[0].containers) == 3
    )  # pd failed in the laboratory
    assert set(drawn) == {
        "leaderboard.png",
        "leaderboard_decisions.png",
        "leaderboard_regret.png",
        "leaderboard_settling.png",
        *(f"leaderboard_{kind}_{track}.png" for kind in ("profiles", "spectra")
          for track in ("state", "laboratory")),
    }  # fmt: skip


def test_every_track_can_be_drawn() -> None:
    """A ranking without options has those that hold in a single task, too."""
    assert list(charts.TRACK_LOOKS) == list(TRACKS)
    for place in range(3):
        assert len({look[place] for look in charts.TRACK_LOOKS.values()}) == len(TRACKS)


def test_no_legend_is_wider_than_its_picture() -> None:
    """Names of controllers are as long as their parts are many."""
    tasks = [env_id for env_id in RANKED if "Track" not in env_id]
    many = {
        env_id: {
            "state": {f"ppo-on-lqg-extended-planned-{i}-{k}": entry([[0.5, 0.6]]) for k in range(4)}
        }
        for i, env_id in enumerate(tasks)
    }
    for draw in (charts.profiles, charts.spectra):
        figure = draw(many, "state")
        (box,) = figure.legends
        assert len(box.texts) == 4 * len(tasks)
        assert box.get_window_extent().width <= figure.bbox.width


def test_no_two_controllers_share_a_point() -> None:
    """Thirty controllers differ in the marker or its filling, and tracks have colours alone."""
    found = {f"c{k}": entry([[0.5, 0.6]]) for k in range(30)}
    many = {REACH: {"state": found, "laboratory": found}}
    points = {tuple(sorted(point.items())) for point in charts.points_of(many).values()}
    assert len(points) == len(found)

    (box,) = charts.settling(many).legends
    handles = {
        text.get_text(): handle for text, handle in zip(box.texts, box.legend_handles, strict=True)
    }
    assert handles["state"].get_marker() == ""
    assert handles["state"].get_color() != handles["laboratory"].get_color()
    assert handles["c0"].get_marker() == handles["c11"].get_marker()
    assert handles["c0"].get_markerfacecolor() != handles["c11"].get_markerfacecolor()


@pytest.fixture
def told() -> charts.Results:
    """A path, on which the RMS is 0.1 more than the score, and `optimal` in two episodes."""
    exact = entry([[0.9, 0.9]], best=Best("tip_error_rms", np.full(2, 1.0)))
    exact.figures["privileged"] = True
    found = {
        "lqr": entry([[0.002] * 4], best=PATH),
        "pd": entry([[0.07] * 4], best=PATH),
        "zero": entry([[0.0] * 4], best=PATH),
        "pid": entry([[0.0] * 4], best=PATH),
        "optimal": exact,
    }
    return {TRACK: {"state": compared(found)}}


def test_optimal_torques_stand_last_and_are_not_ranked(told: Any, tmp_path: Path) -> None:
    write(tmp_path, told, SEEDS)
    stored = json.loads((tmp_path / "leaderboard.json").read_text())[TRACK]["state"]
    assert stored["optimal"]["privileged"]
    assert stored["optimal"]["improvement"] == {}
    assert all("optimal" not in entry["improvement"] for entry in stored.values())
    assert not stored["lqr"]["privileged"]
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert text.index("| zero |") < text.index("| optimal |")
    assert "| OneLink-Track-v0 | state | pd | lqr |" in text
    with bz2.open(tmp_path / EPISODES, "rt", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["controller"] == "optimal"]
    assert [row["seed"] for row in rows] == ["9", "10"]


def test_a_path_has_its_excess_in_the_table_and_in_the_picture(told: Any, tmp_path: Path) -> None:
    """2 and 70 mm over the best; a failure has neither number nor point."""
    write(tmp_path, told, SEEDS)
    stored = json.loads((tmp_path / "leaderboard.json").read_text())[TRACK]["state"]
    assert stored["pd"]["excess_iqm"] == pytest.approx(0.07)
    assert stored["zero"]["excess_iqm"] is None
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert "excess [mm], IQM [95 %]" in text
    assert "| 70 [70, 70] |" in text
    assert "| failed |" in text
    (axis,) = charts.regrets(told).axes
    assert "excess [mm]" in axis.get_xlabel()
    assert axis.get_xscale() == "log"
    assert [label.get_text() for label in axis.get_yticklabels()] == ["pid", "pd", "lqr"]
    assert [text.get_text() for text in axis.texts] == [" failed", " 70", " 2"]
    low, high = axis.get_xlim()
    assert low < 2.0 < 70.0 < high


def test_pictures_without_bounds_and_resting_targets_are_left_out(results: Any) -> None:
    names = set(charts.pictures({TRACK: results[TRACK]}))
    assert names == {
        "leaderboard.png", "leaderboard_decisions.png", "leaderboard_profiles_state.png",
        "leaderboard_spectra_state.png",
    }  # fmt: skip


def test_a_dozen_controllers_look_different() -> None:
    looks = charts.looks_of({REACH: {"state": {f"c{k}": entry([[0.5, 0.5]]) for k in range(12)}}})
    seen = {(x["color"], x["marker"], str(x["linestyle"])) for x in looks.values()}
    assert len(seen) == 12
    assert len({(x["color"], str(x["linestyle"])) for x in looks.values()}) == 12


def test_an_excess_ends_at_a_ten_thousandth_of_a_millimetre_or_in_failures() -> None:
    figures = {"excess_iqm": -1e-19, "excess_ci": [-2e-19, 1e-5]}
    assert over_best(figures) == "0 [0, 0.01]"
    assert over_best({"excess_iqm": 0.1134, "excess_ci": [0.05, np.inf]}) == "113 [50, failed]"
    regret = {"excess_iqm": None, "regret_iqm": -1e-4, "regret_ci": [-2e-3, 0.126]}
    assert over_best(regret) == "0 % [0, 13]"
    failing = entry([[0.002, 0.002, 0.002, 0.0]], best=PATH)
    low, high = failing.figures["excess_ci"]
    assert low < 0.01
    assert high == np.inf
    (axis,) = charts.regrets({TRACK: {"state": compared({"lqr": failing})}}).axes
    assert [text.get_text() for text in axis.texts] == [" 2 to failed"]
