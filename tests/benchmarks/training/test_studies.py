"""Studies of learning: what is trained and judged where, and pages of the stored results."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.config import load_config
from agents.metrics import make_batch
from benchmarks.output import RESULTS
from benchmarks.training.studies import (
    LEARNER,
    STUDIES,
    figures,
    limits,
    memory,
    model_based,
    recipe,
    trained,
)

CONFIG = load_config(LEARNER)


def test_bounds_are_those_of_the_plants_that_are_judged() -> None:
    """Start, target, payload and stiffness are the track's; the torque limit is the named one."""
    for training in limits(CONFIG):
        found = []
        plain = {} if training.track == "state" else {"hardware": "laboratory"}
        for kwargs in (training.kwargs, plain):
            envs = make_batch(training.config.env.id, 4, kwargs)
            envs.reset(seed=list(training.seeds[:4]))
            base = envs.unwrapped
            drawn = base.core.parameters if base.core.parameters.size else np.full((4, 2), [0, 1])
            found.append(np.hstack([base.core.q, base.joint_target(), drawn]))
            assert training.place[0] == f"{base.torque_limit[0]:g} N m"
            envs.close()
        np.testing.assert_array_equal(*found)


def test_memory_is_judged_in_the_laboratory_alone() -> None:
    trainings = memory(CONFIG)
    assert len({(str(one.config.env.kwargs), one.config.env.stack) for one in trainings}) == 9
    assert {str(one.kwargs) for one in trainings} == {"{'hardware': 'laboratory'}"}


def test_a_recipe_loses_one_part_at_a_time() -> None:
    whole, *others = (
        one.config.to_dict() for one in recipe(load_config(STUDIES["recipe"].learner))
    )
    kwargs = whole["agent"]["kwargs"]
    assert whole["env"]["stack"] > 1
    assert kwargs["std_floor"] > 0.0
    for config in others:
        changed = [config["env"]["stack"] != whole["env"]["stack"]]
        theirs = config["agent"]["kwargs"]
        changed += [theirs.get(key) != kwargs.get(key) for key in {*theirs, *kwargs}]
        assert sum(changed) == 1


def test_a_study_trains_once_and_continues_a_run(tmp_path: Path) -> None:
    """A second call finds the finished policy; model-based control is judged alike."""
    config = replace(CONFIG, total_steps=4096)
    config = replace(config, evaluation=replace(config.evaluation, episodes=4))
    (first, *_) = limits(config)
    found = [trained(first, 0, tmp_path) for _ in range(2)]
    np.testing.assert_array_equal(found[0]["score"], found[1]["score"])
    assert figures(first, found)["success_rates"] == [0.0, 0.0]
    assert figures(first, [model_based(first, "lqg")])["success_rates"] == [1.0]


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_the_stored_page_is_that_of_the_stored_figures(name: str) -> None:
    """If not: python -m benchmarks.training.studies NAME"""
    data: dict[str, Any] = json.loads((RESULTS / f"study_{name}.json").read_text("utf-8"))
    study = STUDIES[name]
    assert (RESULTS / f"study_{name}.md").read_text("utf-8") == study.page(data)
    trainings = study.trainings(load_config(study.learner))
    assert [tuple(row["place"]) for row in data["rows"]] == [one.place for one in trainings]
    study.chart(data)
    assert "7 test episodes" in study.page(data | {"episodes": 7})
