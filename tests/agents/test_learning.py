"""Learners built from experiments: their settings, and that PPO and SAC improve the policy."""

from typing import Any

import numpy as np
import pytest

from agents.config import Config, config_from_dict
from agents.learners.export import export_policy
from agents.metrics import make_batch
from agents.policy import Policy
from agents.training import build_model

ENV_ID = "FlexArm/OneLink-Reach-v0"
KWARGS = {"control_dt": 0.05, "max_episode_steps": 60}
REWARD = {"tracking": 1.0}  # between 0 and 1 per step, so a return is at most 60
EPISODES = range(10_000, 10_032)  # seeds
# Over seeds 0 to 7, PPO gains 40 to 42 and SAC 31 to 41 (untrained 8 to 12).
MARGIN = 20.0
STEPS = {"ppo": 30_720, "sac": 8_000}
AGENTS: dict[str, dict[str, Any]] = {
    "ppo": {
        "n_steps": 32,
        "batch_size": 512,
        "n_epochs": 6,
        "learning_rate": 3.0e-3,
        "gamma": 0.9,
        "gae_lambda": 0.9,
        "policy_kwargs": {"net_arch": [32, 32], "log_std_init": -0.5},
    },
    "sac": {
        "batch_size": 128,
        "buffer_size": 50_000,
        "learning_starts": 320,
        "train_freq": 1,
        "gradient_steps": 2,
        "learning_rate": 3.0e-3,
        "gamma": 0.9,
        "tau": 0.05,
        "ent_coef": 0.02,
        "policy_kwargs": {"net_arch": [32, 32], "activation_fn": "relu"},
    },
}


def mean_return(policy: Policy) -> float:
    """Mean return of the deterministic policy over the evaluation episodes."""
    envs = make_batch(ENV_ID, len(EPISODES), KWARGS | {"reward": REWARD})
    observation, _ = envs.reset(seed=list(EPISODES))
    total, running = np.zeros(len(EPISODES)), np.ones(len(EPISODES), bool)
    while running.any():
        observation, reward, terminated, truncated, _ = envs.step(policy.predict(observation)[0])
        total += np.where(running, reward, 0.0)
        running &= ~(terminated | truncated)
    envs.close()
    return float(total.mean())


def returns(name: str, steps: int, **changes: Any) -> tuple[float, float]:
    """Mean returns before and after training with seed 0."""
    config = config_from_dict(
        {
            "env": {
                "id": ENV_ID,
                "kwargs": KWARGS,
                "reward": REWARD,
                "n_envs": {"ppo": 64, "sac": 16}[name],
            },
            "agent": {"name": name, "kwargs": AGENTS[name] | changes},
            "total_steps": steps,
        }
    )
    model = build_model(config)
    before = mean_return(export_policy(model, {}))
    model.learn(config.total_steps)
    after = mean_return(export_policy(model, {}))
    model.env.close()
    return before, after


@pytest.mark.parametrize("name", AGENTS)
def test_training_raises_the_return_of_the_deterministic_policy(name: str) -> None:
    before, after = returns(name, STEPS[name])
    assert after > before + MARGIN


@pytest.mark.parametrize("name", AGENTS)
def test_a_learning_rate_of_zero_changes_no_return(name: str) -> None:
    """The gain above is due to learning and not to the evaluation."""
    before, after = returns(name, 2_048, learning_rate=0.0)
    assert after == before


def experiment(name: str, **kwargs: Any) -> Config:
    """A minimal experiment with the given agent keywords."""
    agent = {"name": name, "kwargs": kwargs}
    return config_from_dict({"env": {"id": ENV_ID}, "agent": agent, "total_steps": 1000})


@pytest.mark.parametrize("value", ["auto", "auto_0.1", 0.05])
def test_sac_takes_a_number_or_auto_for_its_entropy(value: str | float) -> None:
    model = build_model(experiment("sac", ent_coef=value, target_entropy="auto"))
    assert model.ent_coef == value
    assert model.target_entropy == -1.0  # minus the number of actions
    model.env.close()


def test_a_linear_schedule_falls_to_zero() -> None:
    model = build_model(experiment("ppo", learning_rate="lin_3.0e-4"))
    assert [model.lr_schedule(remaining) for remaining in (1.0, 0.5, 0.0)] == [3e-4, 1.5e-4, 0.0]
    model.env.close()


@pytest.mark.parametrize("kind", ["normal", "ornstein-uhlenbeck"])
def test_noise_of_actions_is_named_as_in_rl_zoo(kind: str) -> None:
    model = build_model(experiment("td3", noise_std=0.2, noise_type=kind))
    model.action_noise.reset()
    drawn = np.array([model.action_noise() for _ in range(100)])
    assert drawn.shape == (100, 1)
    assert 0.0 < drawn.std() < 0.4
    assert kind.partition("-")[0] in type(model.action_noise).__name__.lower()
    model.env.close()


def test_td3_has_no_noise_unless_it_is_given() -> None:
    model = build_model(experiment("td3"))
    assert model.action_noise is None
    model.env.close()
