"""Rewards: the keyword, the wrappers and the table of terms agree."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from flexarm_env import kernels
from flexarm_env.rewards import REWARDS, resolve_weights

WRAPPERS = {
    "tip_tracking": flexarm_env.TipTrackingReward,
    "vibration_suppression": flexarm_env.VibrationSuppressionReward,
}
ENV_ID = "FlexArm/OneLink-Reach-v0"


def rewards_of(env: Any, steps: int = 60) -> list[float]:
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    return [env.step(rng.uniform(-0.6, 0.6, 1))[1] for _ in range(steps)]


@pytest.mark.parametrize("name", WRAPPERS)
def test_wrapper_and_keyword_give_the_same_numbers(name: str) -> None:
    assert rewards_of(WRAPPERS[name](gym.make(ENV_ID))) == rewards_of(gym.make(ENV_ID, reward=name))
    weights = {"tracking": 0.3, "effort": 0.1, "vibration": 2.0}
    wrapped = WRAPPERS[name](gym.make(ENV_ID), weights)
    assert rewards_of(wrapped) == rewards_of(gym.make(ENV_ID, reward=weights))


@pytest.mark.parametrize("name", REWARDS)
def test_the_reward_is_the_weighted_sum_of_its_terms(name: str) -> None:
    env = gym.make(ENV_ID, reward=name)
    weights = resolve_weights(name)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(np.ones(1))
    terms = info["reward_terms"]
    assert list(terms) == list(flexarm_env.TERMS)
    assert reward == pytest.approx(sum(w * terms[k] for k, w in weights.items()), rel=1e-14)


def test_every_term_of_the_table_is_scored_in_its_place() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        measured = kernels.Measured(*rng.uniform(0.0, 2.0, len(kernels.Measured._fields)))
        expected = [term.py_func(measured) for term in kernels.TERMS.values()]
        np.testing.assert_allclose(kernels.score(measured), expected, rtol=1e-14)


def test_goals_are_in_the_unit_interval_and_costs_are_not_positive() -> None:
    rng = np.random.default_rng(0)
    best = kernels.Measured(**dict.fromkeys(kernels.Measured._fields, 0.0))
    for name, term in kernels.TERMS.items():
        values = [term(kernels.Measured(*rng.exponential(1.0, 7))) for _ in range(100)]
        if term(best) == 1.0:
            assert min(values) >= 0.0, name
            assert max(values) <= 1.0, name
        else:
            assert term(best) == 0.0, name
            assert max(values) <= 0.0, name


def test_unknown_terms_are_refused_by_wrappers() -> None:
    with pytest.raises(ValueError, match=r"Unknown reward terms \['speed'\]"):
        flexarm_env.TipTrackingReward(gym.make(ENV_ID), {"speed": 1.0})


def test_standing_on_the_target_beats_every_other_rest() -> None:
    """Of resting arms, the one on its target is paid most, by every preset."""
    for name in REWARDS:
        env = gym.make(ENV_ID, reward=name)
        paid = []
        for angle in (0.0, 0.01, 0.03, 0.1, 0.3, 1.0):
            env.reset(seed=0, options={"state": {"q": [angle, 0.0, 0.0]}, "target": [0.0]})
            paid.append(env.step(np.zeros(1))[1])
        assert paid == sorted(paid, reverse=True), name
        assert len(set(paid)) == len(paid), name
