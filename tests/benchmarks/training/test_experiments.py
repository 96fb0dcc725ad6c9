"""Learning curves over training seeds, and the overview of stored experiments."""

import json
from pathlib import Path
from typing import Any

import pytest

from agents.experiments import shipped_experiments
from benchmarks.output import RESULTS
from benchmarks.training.experiments import (
    COLUMNS,
    band,
    cells_of_seeds,
    expected,
    learning_curves,
    overview,
    page,
    stored,
    stored_curves,
    summarise_experiments,
)


def test_band_is_the_median_and_the_range_of_the_seeds() -> None:
    """Seeds are compared at equal steps; a row without a finished episode is left out."""
    curves = {
        "seed 0": {"steps": [0, 10, 20, 30], "return": [None, 1.0, 2.0, 3.0]},
        "seed 1": {"steps": [0, 20, 40], "return": [0.0, 4.0, 8.0]},
        "seed 2": {"steps": [10, 30], "return": [-1.0, -1.0]},
    }
    steps, found = band(curves)
    assert steps.tolist() == [10, 20, 30]
    assert found.tolist() == [[-1.0, -1.0, -1.0], [1.0, 2.0, 3.0], [2.0, 4.0, 6.0]]


def test_a_seed_of_which_no_episode_has_ended_has_no_band() -> None:
    curves = {"a": {"steps": [1, 2], "return": [None, -1.0]},
              "b": {"steps": [1, 2], "return": [None, None]}}  # fmt: skip
    steps, returns = band(curves)
    assert (steps.shape, returns.shape) == ((0,), (3, 0))
    figure = learning_curves([{"name": "short", "curves": curves, "runs": [{}, {}]}])
    assert figure.axes[0].get_title().startswith("short")


def test_every_experiment_has_its_curve() -> None:
    experiments = stored(RESULTS)
    assert len(experiments) > 5
    titles = [axis.get_title() for axis in learning_curves(experiments).axes]
    for data in experiments:
        (title,) = [x for x in titles if x.startswith(f"{data['name']}\n")]
        assert title.split("\n")[1].split()[0] == str(len(data["runs"]))


def test_a_curve_of_one_point_is_shown() -> None:
    """Its median as a marker, the range of the seeds as a bar."""
    curves = {f"seed {k}": {"steps": [10, 20], "return": [None, float(k)]} for k in range(3)}
    data = {"name": "short", "runs": [{}] * 3, "curves": curves}
    (axis,) = learning_curves([data]).axes
    (bars,) = axis.containers
    marker, _, (line,) = bars
    assert (marker.get_marker(), marker.get_ydata().tolist()) == ("o", [1.0])
    assert line.get_segments()[0][:, 1].tolist() == [0.0, 2.0]


def test_the_stored_overview_is_that_of_the_stored_experiments() -> None:
    """If not: python -m benchmarks.training.experiments"""
    assert (RESULTS / "experiments.md").read_text(encoding="utf-8") == overview(stored(RESULTS))


@pytest.mark.parametrize("data", stored(RESULTS), ids=lambda data: data["name"])
def test_the_stored_page_is_that_of_the_stored_experiment(data: dict[str, Any]) -> None:
    """If not: python -m benchmarks.training.experiments"""
    assert (RESULTS / f"{data['name']}.md").read_text(encoding="utf-8") == page(data)


def test_other_results_are_no_experiments(tmp_path: Path) -> None:
    (tmp_path / "speed.json").write_text(json.dumps({"runs": []}))
    assert stored(tmp_path) == []


def test_stored_curves_are_rows_by_seed() -> None:
    curves = {"seed 0": {"steps": [1, 2], "return": [None, 3.0], "settled": [0.0, 1.0]}}
    assert stored_curves({"curves": curves}) == {
        "seed 0": [
            {"steps": 1, "return": None, "settled": 0.0},
            {"steps": 2, "return": 3.0, "settled": 1.0},
        ]
    }


@pytest.mark.parametrize(("name", "path"), shipped_experiments().items(), ids=shipped_experiments())
def test_every_experiment_states_what_its_seeds_gave(name: str, path: Path) -> None:
    """If not: python -m benchmarks.training.experiments"""
    data = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    assert f"\n{expected(data)}env:" in path.read_text(encoding="utf-8")


def test_cells_of_seeds_have_the_median_and_the_standard_deviation() -> None:
    """Of 0.5, 0.7 and 0.9 s it is 0.2 s; one seed has none, nor have seeds of which one fails."""
    summaries = [dict.fromkeys(COLUMNS, x) for x in (0.7, 0.5, 0.9)]
    place = list(COLUMNS).index("settling_time")
    assert cells_of_seeds(summaries)[place] == "0.70 ± 0.20"
    assert cells_of_seeds(summaries[:1])[place] == "0.70"
    failing = summaries[0] | {"settling_time": None}
    assert cells_of_seeds([failing, *summaries[1:]])[place] == "0.90"


def test_what_to_expect_has_the_median_and_the_range_of_the_seeds() -> None:
    def summary(success: float, settling: float | None, vibration: float) -> dict[str, object]:
        names = ("success_rate", "settling_time", "residual_vibration")
        return dict(zip(names, (success, settling, vibration), strict=True))

    data = {
        "name": "reach",
        "task": "Reach",
        "config": {"total_steps": 2_000_000, "base": {"learned": "residual"}},
        "runs": [
            {"summary": summary(0.5, None, 0.0025)},
            {"summary": summary(1.0, 0.5, 0.0005)},
            {"summary": summary(0.99, 0.75, 0.0)},
        ],
        "references": {
            "joint PD": summary(0.0, None, 0.1),
            "untrained policy": summary(1.0, 1.0, 3e-7),
        },
    }
    assert (
        expected(data)
        == """\
# Expected of 3 seeds after 2,000,000 steps:
#                            median  least   most  joint PD  untrained
#   success [%]                  99     50    100         0        100
#   settling [s]               0.75   0.50  never     never       1.00
#   residual vibration [mm]     0.5      0    2.5       100    < 0.001
# from docs/results/reach.json
"""
    )


def test_pictures_of_other_experiments_stay_as_they_are(tmp_path: Path) -> None:
    """All pages are written, since one names the others."""
    names = ("one_link_reach_ppo", "one_link_track_ppo")
    for name in names:
        (tmp_path / f"{name}.json").write_bytes((RESULTS / f"{name}.json").read_bytes())
    summarise_experiments(tmp_path, names[0])
    assert {path.stem for path in tmp_path.glob("*.md")} == {"experiments", *names}
    assert {path.stem for path in tmp_path.glob("*.png")} == {"experiments", names[0]}
