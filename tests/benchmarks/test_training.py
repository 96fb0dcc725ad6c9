"""Learning curves over training seeds, and the overview of experiments."""

import json
from pathlib import Path

from benchmarks.output import RESULTS
from benchmarks.training import band, learning_curves, overview, stored


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
        (title,) = [x for x in titles if x.startswith(f"{data['name']}, ")]
        assert title.split(", ")[1].split()[0] == str(len(data["runs"]))


def test_the_stored_overview_is_that_of_the_stored_experiments() -> None:
    """If not: python -m benchmarks.training --charts"""
    assert (RESULTS / "experiments.md").read_text(encoding="utf-8") == overview(stored(RESULTS))


def test_other_results_are_no_experiments(tmp_path: Path) -> None:
    (tmp_path / "speed.json").write_text(json.dumps({"runs": []}))
    assert stored(tmp_path) == []
