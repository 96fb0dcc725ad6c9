"""Rewards: the keyword, the wrappers and the table of terms agree."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from flexarm_env.task.rewards import REWARDS, TERMS, Measured, resolve_weights

WRAPPERS = {
    "tip_tracking": flexarm_env.TipTrackingReward,
    "vibration_suppression": flexarm_env.VibrationSuppressionReward,
}
ENV_ID = "FlexArm/OneLink-Reach-v0"
ROUND_OFF = 1e-12


def rewards_of(env: Any, steps: int = 60) -> list[float]:
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    return [env.step(rng.uniform(-0.6, 0.6, 1))[1] for _ in range(steps)]


@pytest.mark.parametrize("name", WRAPPERS)
def test_wrapper_and_keyword_give_the_same_numbers(name: str) -> None:
    wrapped = rewards_of(WRAPPERS[name](gym.make(ENV_ID)))
    np.testing.assert_allclose(wrapped, rewards_of(gym.make(ENV_ID, reward=name)), rtol=ROUND_OFF)
    weights = {"tracking": 0.3, "effort": 0.1, "vibration": 2.0}
    wrapped = rewards_of(WRAPPERS[name](gym.make(ENV_ID), weights))
    keyword = rewards_of(gym.make(ENV_ID, reward=weights))
    np.testing.assert_allclose(wrapped, keyword, rtol=ROUND_OFF)


@pytest.mark.parametrize("name", REWARDS)
def test_the_reward_is_the_weighted_sum_of_its_terms(name: str) -> None:
    env = gym.make(ENV_ID, reward=name)
    weights = resolve_weights(name)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(np.ones(1))
    terms = info["reward_terms"]
    assert list(terms) == list(flexarm_env.TERMS)
    assert reward == pytest.approx(sum(w * terms[k] for k, w in weights.items()), rel=1e-14)


def test_compiled_terms_are_the_terms_on_floats() -> None:
    """Every term, computed from the info and state of the environment."""
    env = gym.make("FlexArm/TwoLink-Damp-v0")
    base: Any = env.unwrapped
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    before = np.zeros(2)
    for _ in range(20):
        action = rng.uniform(-0.6, 0.6, 2).astype(np.float32)
        *_, info = env.step(action)
        rate = base.joint_state()[1] / base.core.rate_scale
        measured = Measured(
            error=info["tip_error"] / base.reach,
            speed=info["tip_speed"] / (base.reach * base.core.rate_scale),
            vibration=info["tip_deflection"] / (0.1 * base.reach),
            rate=np.mean(rate**2),
            effort=np.mean(action.astype(float) ** 2),
            change=np.mean((action - before) ** 2),
            failed=0.0,
        )
        before = action.astype(float)
        for name, term in TERMS.items():
            assert info["reward_terms"][name] == pytest.approx(term(measured), rel=1e-12), name


def test_unknown_terms_are_refused_by_wrappers() -> None:
    with pytest.raises(ValueError, match=r"Unknown reward terms \['speed'\]"):
        flexarm_env.TipTrackingReward(gym.make(ENV_ID), {"speed": 1.0})


def test_rest_on_the_target_is_rewarded_more_than_rest_elsewhere() -> None:
    """For every preset, the reward at rest decreases with the distance from the target."""
    for name in REWARDS:
        env = gym.make(ENV_ID, reward=name)
        rewards_at = []
        for angle in (0.0, 0.01, 0.03, 0.1, 0.3, 1.0):
            env.reset(seed=0, options={"state": {"q": [angle, 0.0, 0.0]}, "target": [0.0]})
            rewards_at.append(env.step(np.zeros(1))[1])
        assert rewards_at == sorted(rewards_at, reverse=True), name
        assert len(set(rewards_at)) == len(rewards_at), name
