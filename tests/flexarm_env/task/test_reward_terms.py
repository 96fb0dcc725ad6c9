"""Reward terms, weights and wrappers whose values are known by hand; nothing is compiled."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env.task.rewards import (
    REWARDS,
    TERMS,
    Measured,
    TipTrackingReward,
    VibrationSuppressionReward,
    goal_reward,
    resolve_weights,
)


class Stub(gym.Env):
    """An environment whose terms are 1, 2, 3, ..."""

    def step(self, action: Any) -> Any:
        terms = dict(zip(TERMS, range(1, len(TERMS) + 1), strict=True))
        return action, -1.0, False, True, {"reward_terms": terms}


@pytest.mark.parametrize(
    ("term", "quantities", "value"),
    [
        ("tracking", {"error": 0.1}, 1 / 2),
        ("tracking", {"error": 0.3}, 1 / 4),
        ("precision", {"error": 0.02}, 1 / 2),
        ("precision", {"error": 0.06}, 1 / 10),
        ("stillness", {"error": 0.05}, 1 / 2),
        ("stillness", {"speed": 0.1}, 1 / 2),
        ("stillness", {"error": 0.05, "speed": 0.1}, 1 / 3),
        ("stillness", {"error": 0.1, "speed": 0.3}, 1 / 14),
        ("distance", {"error": 0.3}, -0.3),
        ("tip_speed", {"speed": 2.0}, -4.0),
        ("tip_speed", {"speed": 2.0, "error": 0.1}, -2.0),
        ("tip_speed", {"speed": 1.0, "error": 0.2}, -0.2),
        ("vibration", {"vibration": 3.0}, -9.0),
        ("effort", {"effort": 0.25}, -0.25),
        ("smoothness", {"change": 0.5}, -0.5),
        ("joint_rate", {"rate": 0.7}, -0.7),
        ("failure", {"failed": 1.0}, -1.0),
    ],
)
def test_terms_have_the_values_of_their_sentences(
    term: str, quantities: dict[str, float], value: float
) -> None:
    rest = dict.fromkeys(Measured._fields, 0.0)
    assert TERMS[term](Measured(**{**rest, **quantities})) == pytest.approx(value, rel=1e-12)


def test_presets_have_their_weights() -> None:
    """A change of the judge has to be meant."""
    assert REWARDS == {
        "reach": {
            "tracking": 0.5, "precision": 0.25, "stillness": 0.25, "tip_speed": 0.02,
            "smoothness": 0.02, "failure": 100.0,
        },
        "track": {"tracking": 0.6, "precision": 0.4, "smoothness": 0.02, "failure": 100.0},
        "damp": {"stillness": 1.0, "tip_speed": 0.5, "smoothness": 0.02, "failure": 100.0},
        "tip_tracking": {"tracking": 0.7, "precision": 0.3, "failure": 100.0},
        "vibration_suppression": {
            "tracking": 0.4, "stillness": 0.6, "vibration": 0.1, "smoothness": 0.02,
            "failure": 100.0,
        },
    }  # fmt: skip


def test_goals_are_in_the_unit_interval_and_costs_are_not_positive() -> None:
    rng = np.random.default_rng(0)
    best = Measured(**dict.fromkeys(Measured._fields, 0.0))
    for name, term in TERMS.items():
        values = [term(Measured(*rng.exponential(1.0, 7))) for _ in range(100)]
        if term(best) == 1.0:
            assert min(values) >= 0.0, name
            assert max(values) <= 1.0, name
        else:
            assert term(best) == 0.0, name
            assert max(values) <= 0.0, name


def test_rewards_of_goals_are_one_within_two_percent_of_the_reach() -> None:
    goal = np.zeros((4, 2))
    tips = np.array([[0.0, 0.0], [0.0199, 0.0], [0.02, 0.0], [0.015, -0.015]])
    assert goal_reward(tips, goal).tolist() == [1.0, 1.0, 0.0, 0.0]
    assert goal_reward(tips[0], goal[0]) == 1.0
    assert goal_reward(tips[3], goal[3]).dtype == np.float64


def test_distances_of_goals_are_those_of_double_precision() -> None:
    """Single precision rounds this distance, 5.7e-10 below the band, up to the band."""
    tip = np.array([0.0008194705, 0.019983204], np.float32)
    assert np.linalg.norm(tip) == np.float32(0.02)
    assert goal_reward(tip, np.zeros(2, np.float32)) == 1.0


def test_weights_of_a_preset_are_a_copy() -> None:
    resolve_weights("reach")["tracking"] = 7.0
    assert resolve_weights("reach") == REWARDS["reach"]
    assert REWARDS["reach"]["tracking"] == 0.5


def test_weights_are_kept_up_to_the_heaviest() -> None:
    assert resolve_weights({"effort": 1e9, "tracking": 0}) == {"effort": 1e9, "tracking": 0.0}
    assert resolve_weights({"failure": -1e9}) == {"failure": -1e9}


@pytest.mark.parametrize(
    ("reward", "words"),
    [
        ("reech", r"Unknown reward 'reech'. Known: \['damp', 'reach'.*or give a dict of weights"),
        (3.0, r"reward must be a name or a dict of weights, got 3.0\."),
        ({"effort": 1000000000.5}, r"weight of 'effort' must be at most 1e\+09 in size"),
        ({"effort": -1000000000.5}, r"weight of 'effort' must be at most 1e\+09 in size"),
        ({"tracking": 0.0, "effort": 0.0}, r"At least one weight must differ from zero"),
        ({"tracking": 1.0, "speed": 1.0, 4: 1.0}, r"Unknown reward terms \['4', 'speed'\]"),
    ],
)
def test_bad_weights_are_refused(reward: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        resolve_weights(reward)


def test_wrappers_weigh_the_terms_of_the_step() -> None:
    """The k-th term of the stub is k."""
    place = {name: k for k, name in enumerate(TERMS, 1)}
    for wrapper, preset in (
        (TipTrackingReward, "tip_tracking"),
        (VibrationSuppressionReward, "vibration_suppression"),
    ):
        expected = sum(weight * place[name] for name, weight in REWARDS[preset].items())
        assert wrapper(Stub()).step(5)[:4] == (5, pytest.approx(expected), False, True)
        assert wrapper(Stub(), {"effort": 2.0}).step(5)[1] == 2.0 * place["effort"]


def test_wrappers_need_every_term() -> None:
    class Short(Stub):
        def step(self, action: Any) -> Any:
            return action, -1.0, False, True, {"reward_terms": {"tracking": 1.0}}

    with pytest.raises(ValueError, match="zip"):
        TipTrackingReward(Short()).step(5)


def test_wrapped_environments_can_be_made_again() -> None:
    """Their arguments stand in the spec, as Gymnasium's recorder leaves them."""
    assert TipTrackingReward(Stub(), {"effort": 2.0})._saved_kwargs == {"weights": {"effort": 2.0}}
