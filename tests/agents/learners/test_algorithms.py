"""Algorithms and their keywords are found by the signatures of the libraries' own classes."""

import inspect

import pytest
import stable_baselines3

from agents.config import ConfigError, config_from_dict
from agents.learners.algorithms import DISCRETE, algorithms, policies, policy_settings, settings

NAMES = ["a2c", "ars", "crossq", "ddpg", "ppo", "recurrent-ppo"]
NAMES += ["rsl-ppo", "sac", "shac", "td3", "tqc", "trpo"]
ENV = {"id": "FlexArm/OneLink-Reach-v0"}


def configured(name: str, policy: str | None = None, **kwargs: object) -> None:
    agent = {"name": name, "kwargs": kwargs} | ({} if policy is None else {"policy": policy})
    config_from_dict({"env": ENV, "agent": agent, "total_steps": 1000})


def test_algorithms_with_continuous_actions_are_known_by_their_lower_case_names() -> None:
    assert list(algorithms()) == sorted([*NAMES, "dagger"])  # which needs an expert
    assert algorithms()["ppo"] is stable_baselines3.PPO


@pytest.mark.parametrize("name", NAMES)
def test_every_accepted_keyword_is_one_of_the_algorithm_and_of_its_policy(name: str) -> None:
    known = set(inspect.signature(algorithms()[name]).parameters) | {"noise_type", "noise_std"}
    assert {"learning_rate", "policy_kwargs"} <= set(settings(name)) <= known
    for policy in policies(name):
        accepted = set(policy_settings(name, policy))
        assert accepted <= set(
            inspect.signature(algorithms()[name].policy_aliases[policy]).parameters
        )
        assert not accepted & {"observation_space", "lr_schedule", "optimizer_class"}


@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_may_name_every_algorithm(name: str) -> None:
    configured(name, learning_rate="lin_1.0e-3")


@pytest.mark.parametrize(
    ("name", "kwargs", "sentence"),
    [
        ("tqc", {"top_quantiles_to_drop": 2}, "Did you mean 'top_quantiles_to_drop_per_net'"),
        ("a2c", {"batch_size": 64}, r"unknown key 'agent\.kwargs\.batch_size'"),
        ("td3", {"ent_coef": 0.1}, r"unknown key 'agent\.kwargs\.ent_coef'"),
        ("sac", {"replay_buffer_class": "x"}, r"unknown key 'agent\.kwargs\.replay_buffer_class'"),
        ("ppo", {"seed": 1}, r"unknown key 'agent\.kwargs\.seed'"),
        ("td3", {"policy_delay": 0}, "policy_delay must be between 1 and 10_000, got 0"),
        ("td3", {"noise_std": 0.1, "noise_type": "pink"}, "must be 'normal' or 'ornstein-uhl"),
        ("td3", {"noise_type": "normal"}, r"needs agent\.kwargs\.noise_std"),
        ("td3", {"learning_rate": "fast"}, "must be a number or 'lin_NUMBER', got 'fast'"),
        ("ppo", {"policy_kwargs": {"lstm_hidden_size": 8}}, r"policy_kwargs\.lstm_hidden_size'"),
        ("sac", {"policy_kwargs": {"n_quantiles": 8}}, r"policy_kwargs\.n_quantiles'"),
        (
            "recurrent-ppo",
            {"policy_kwargs": {"n_lstm_layers": 3, "net_arch": [4] * 6}},
            "at most 5 layers",
        ),
        ("trpo", {"n_steps": 100}, r"batch_size \(128\) must divide n_steps x n_envs \(100\)"),
    ],
)
def test_keywords_that_an_algorithm_does_not_have_are_refused(
    name: str, kwargs: dict[str, object], sentence: str
) -> None:
    with pytest.raises(ConfigError, match=sentence):
        configured(name, **kwargs)


@pytest.mark.parametrize("name", DISCRETE)
def test_algorithms_of_discrete_actions_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name} chooses among discrete actions.*'a2c'"):
        configured(name)


def test_policies_of_other_observations_are_refused() -> None:
    configured("ars", "LinearPolicy")
    configured("recurrent-ppo", "MlpLstmPolicy")
    with pytest.raises(ConfigError, match=r"must be one of \['MlpPolicy'\], got 'CnnPolicy'"):
        configured("ppo", "CnnPolicy")


def test_ars_takes_one_environment() -> None:
    with pytest.raises(ConfigError, match=r"n_envs must be 1 for ars.* got 4"):
        config_from_dict({"env": ENV | {"n_envs": 4}, "agent": {"name": "ars"}, "total_steps": 9})
