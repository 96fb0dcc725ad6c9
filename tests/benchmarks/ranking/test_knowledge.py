"""Controllers that are told an episode's plant and delay: the episodes are the ranking's own."""

import json
from typing import Any

import numpy as np
import pytest

from agents.controllers import controller
from agents.metrics import make_batch
from agents.tuned import parameters_of
from benchmarks.output import RESULTS
from benchmarks.ranking.knowledge import (
    COLUMNS,
    EXACT,
    TASKS,
    TOLD,
    chart,
    episode,
    main,
    page,
    scenes,
)

REACH, TRACK = "FlexArm/OneLink-Reach-v0", "FlexArm/OneLink-Track-v0"
SEEDS = range(10_000, 10_003)


@pytest.mark.parametrize("env_id", [REACH, TRACK, "FlexArm/TwoLink-Damp-v0"])
def test_episodes_are_those_of_the_laboratory(env_id: str) -> None:
    """Start, target, payload and stiffness, for which bounds are stored; delays take turns."""
    wanted = make_batch(env_id, 3, {"hardware": "laboratory"})
    wanted.reset(seed=list(SEEDS))
    here = wanted.unwrapped
    found = scenes(env_id, SEEDS)
    assert [scene.delay for scene in found] == [1, 2, 0]
    for i, (scene, seed) in enumerate(zip(found, SEEDS, strict=True)):
        exact: dict[str, Any] = {"obs": "state", "randomize": scene.plant}
        for kwargs in (scene.keywords("delay", "plant"), exact):
            env = make_batch(env_id, 1, kwargs)
            env.reset(seed=[seed])
            there = env.unwrapped
            np.testing.assert_array_equal(there.core.parameters[0], here.core.parameters[i])
            np.testing.assert_array_equal(there.core.q[0], here.core.q[i])
            np.testing.assert_array_equal(there.joint_target()[0], here.joint_target()[i])
            env.close()
    wanted.close()


def test_filters_are_as_many_as_what_is_not_told() -> None:
    """One filter where both are known, and more where they may be anything."""
    (scene, *_) = scenes(REACH, SEEDS)
    counts = {}
    for known in TOLD:
        env = make_batch(REACH, 1, scene.keywords(*TOLD[known]))
        subject: Any = controller(
            "mpc-kalman", env, parameters_of("mpc-kalman", REACH, "laboratory")
        )
        counts[known] = len(subject.observer.hypotheses)
        env.close()
    assert counts["both"] == 1
    assert counts["nothing"] == counts["the delay"] * counts["the plant"]
    assert min(counts["the delay"], counts["the plant"]) > 1


def test_who_knows_more_follows_a_path_more_closely() -> None:
    (scene, *_) = scenes(TRACK, SEEDS)
    told, exact = (episode(TRACK, SEEDS[0], scene, column) for column in ("both", EXACT))
    assert exact["tip_error_rms"] < 0.9 * told["tip_error_rms"]


def test_a_short_run_writes_the_page(tmp_path: Any) -> None:
    main(["--tasks", REACH, "--episodes", "2", "--jobs", "1", "--out", str(tmp_path)])
    data = json.loads((tmp_path / "knowledge.json").read_text())
    assert list(data["tasks"][REACH]) == list(COLUMNS)
    assert (tmp_path / "knowledge.png").stat().st_size > 5_000


def test_the_stored_page_is_made_from_the_stored_numbers() -> None:
    """If not: python -m benchmarks.ranking.knowledge"""
    data = json.loads((RESULTS / "knowledge.json").read_text(encoding="utf-8"))
    assert list(data["tasks"]) == list(TASKS)
    assert (RESULTS / "knowledge.md").read_text(encoding="utf-8") == page(data)
    chart(data)
