"""Rewards: the keyword, the wrappers and the table of terms agree."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from flexarm_env.rewards import REWARDS, TERMS, Measured, resolve_weights

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
