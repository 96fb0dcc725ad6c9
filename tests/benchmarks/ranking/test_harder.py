"""The study of harder tasks: costs by the environment's own, and the page of stored results."""

import json

import numpy as np
import pytest

from agents.controllers.simple import Zero
from agents.metrics import make_batch, record
from benchmarks.output import RESULTS
from benchmarks.ranking import harder
from benchmarks.ranking.harder import acting, costs, page, wait, widely


class Full(Zero):
    """Full torque."""

    def predict(self, observation, state=None, start=None, deterministic=True):  # type: ignore[no-untyped-def]
        """Actions, and no memory."""
        return np.ones((len(observation), 1)), None


def test_the_page_is_what_its_results_say() -> None:
    stored = json.loads((RESULTS / "harder.json").read_text(encoding="utf-8"))
    assert (RESULTS / "harder.md").read_text(encoding="utf-8") == page(stored)


def test_shipped_policies_are_met_on_every_track(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(harder, "met", lambda *_: {"score": 0.0, "failed": 0.0})
    assert {"mpc-kalman", "rsl-ppo-warm-stacked"} <= set(widely([0]))
    assert {"lqr", "ppo", "dagger-of-mpc"} <= set(acting("FlexArm/OneLink-ReachPush-v0", "state"))


def test_costs_are_those_of_the_environment() -> None:
    envs = make_batch("FlexArm/OneLink-ReachStrain-v0", 3)
    found = costs(record(Full(n_torque=1), envs, range(3)), envs.unwrapped.core)
    envs.reset(seed=[0, 1, 2])
    sums, largest, running = np.zeros(3), 0.0, np.ones(3, bool)
    while running.any():
        _, _, terminated, truncated, info = envs.step(np.ones((3, 1), np.float32))
        sums += np.where(running, info["cost"], 0.0)
        largest = max(largest, info["cost"][running].max())
        running &= ~(terminated | truncated)
    assert found == pytest.approx({"cost": sums.mean(), "excess": largest}, rel=1e-9)
    assert largest > 0.1


def test_an_event_is_waited_for_a_move_time_and_a_half() -> None:
    assert wait("FlexArm/OneLink-ReachPush-v0") == pytest.approx(1.5 * 0.679 / 3.0, rel=1e-3)
    assert wait("FlexArm/OneLink-TrackDrop-v0") is None
