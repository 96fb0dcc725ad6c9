"""Learning curves over training seeds, and the overview of stored experiments."""

import json
from pathlib import Path

from benchmarks.experiments import band, learning_curves, overview, stored, stored_curves
from benchmarks.output import RESULTS


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


def test_every_experiment_has_its_curve() -> None:
    experiments = stored(RESULTS)
    assert len(experiments) > 5
    titles = [axis.get_title() for axis in learning_curves(experiments).axes]
    for data in experiments:
        (title,) = [x for x in titles if x.startswith(f"{data['name']}\n")]
        assert title.split("\n")[1].split()[0] == str(len(data["runs"]))


def test_the_stored_overview_is_that_of_the_stored_experiments() -> None:
    """If not: python -m benchmarks.experiments"""
    assert (RESULTS / "experiments.md").read_text(encoding="utf-8") == overview(stored(RESULTS))


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
