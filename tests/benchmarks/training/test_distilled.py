"""Distilled policies beside their experts: the stored page, and the gain in the same episodes."""

import json
from pathlib import Path

import numpy as np
import pytest

from agents.leaderboard.shipped import shipped_policies
from benchmarks.output import RESULTS
from benchmarks.training.distilled import distilled, gain, page, stored_rows
from benchmarks.training.experiments import stored_seconds


def test_the_stored_page_is_that_of_the_stored_results() -> None:
    """If not: python -m benchmarks.training.distilled"""
    results = json.loads((RESULTS / "distilled.json").read_text(encoding="utf-8"))
    assert (RESULTS / "distilled.md").read_text(encoding="utf-8") == page(results)
    seeds = {row["name"]: row["seeds"] for row in results["rows"]}
    shipped = {c.name: [p.about["seed"] for p in shipped_policies(c)] for c, _ in distilled()}
    assert seeds == shipped
    assert {name: list(stored_seconds(name)) for name in seeds} == shipped


def test_a_gain_in_the_same_episodes_is_without_what_makes_them_hard() -> None:
    """Its interval is that of the differences, far narrower than that of the scores."""
    rng = np.random.default_rng(0)
    expert = rng.uniform(size=400)
    policy = expert - 0.01 + 0.05 * rng.normal(size=(3, 400))
    mean, low, high = gain(policy, expert)
    assert low < mean < high
    assert abs(mean + 0.01) < 0.005
    expected = 2 * 1.96 * 0.05 / np.sqrt(3 * 400)  # of independent differences
    assert expected < high - low < 2.0 * expected  # whole seeds and whole episodes are drawn


def test_rows_that_are_not_measured_stay_as_they_are_stored(tmp_path: Path) -> None:
    path, names = tmp_path / "distilled.json", [config.name for config, _ in distilled()]

    def kept(stored: list[str], only: list[str] | None) -> list[str]:
        path.write_text(json.dumps({"rows": [{"name": name} for name in stored]}))
        return list(stored_rows(path, only))

    assert kept(names, None) == []
    assert kept(names, names[:1]) == names[1:]
    with pytest.raises(ValueError, match=f"no row of .*{names[0]}.*; name them too"):
        kept(names[1:], names[1:])
    with pytest.raises(ValueError, match="two_links"):
        kept(names, ["two_links"])
