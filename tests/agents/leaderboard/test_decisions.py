"""Decisions that come late, beside what should act at every control step."""

from typing import Any

import numpy as np
import pytest

from agents.leaderboard import run
from agents.leaderboard.decisions import Late, decision_times, lateness
from agents.leaderboard.run import ranked
from agents.metrics import make_batch

REACH = "FlexArm/OneLink-Reach-v0"


class Counter:
    """Acts by the number of its decision in the episode, which is its memory."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, _: bool = True
    ) -> tuple[Any, Any]:
        count = np.zeros(len(observation)) if state is None else np.where(episode_start, 0, state)
        return 1.0 + count[:, None] * np.array([[1.0, -1.0]]), count + 1


def test_what_acts_is_the_latest_decision_that_is_made() -> None:
    """In two episodes each of three environments, the second of which begin apart; before: zero."""
    rng = np.random.default_rng(0)
    steps = rng.integers(0, 4, 7)
    late, state, begun = Late(Counter(), steps), None, np.zeros(3, int)
    for k in range(40):
        start = np.array([k in (0, begins) for begins in (11, 17, 30)])
        begun[start] = k
        acting, state = late.predict(np.zeros((3, 1)), state, start)
        for i, now in enumerate(k - begun):
            made = [j for j in range(now + 1) if j + steps[(i + j) % 7] <= now]
            wanted = (1.0 + made[-1], 1.0 - made[-1]) if made else (0.0, 0.0)
            np.testing.assert_array_equal(acting[i], wanted)


def test_delays_are_whole_steps_and_a_hundredth_of_late_decisions_is_tolerated() -> None:
    np.testing.assert_array_equal(
        lateness(np.array([5.0, 20.0, 20.1, 40.0, 61.0]), 0.02), [0, 0, 1, 1, 3]
    )
    few = np.full(200, 5.0)
    few[:2] = 90.0
    assert not lateness(few, 0.02).any()
    few[2] = 90.0
    assert lateness(few, 0.02).sum() == 3 * 4


def test_starts_of_later_episodes_are_not_among_the_times() -> None:
    env = make_batch(REACH, 1, {"max_episode_steps": 20})
    times = decision_times(Counter1(), env, 0)
    assert len(times) == 200 - 200 // 21


class Counter1(Counter):
    """For one joint."""

    def predict(self, *arguments: Any) -> tuple[Any, Any]:
        action, state = super().predict(*arguments)
        return action[:, :1] * 0.0, state


def test_a_controller_that_misses_its_step_is_judged_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint PD that decides two steps late swings, and the ranking says how late it was."""
    found = []
    for ms in (1.0, 45.0):
        times = np.array([20.0 * ms, *199 * [ms]])
        monkeypatch.setattr(run, "decision_times", lambda *_, times=times: times)
        found.append(ranked("pd", REACH, "state", range(8)).figures)
    prompt, late = found
    assert (prompt["judged_late"], late["judged_late"]) == (0.0, 2.0)
    assert late["score_mean"] < prompt["score_mean"] - 0.05
