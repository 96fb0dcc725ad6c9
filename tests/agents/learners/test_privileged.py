"""Critics that see the true state, with actors that are stored as any others."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.utils import obs_as_tensor

from agents.config import ConfigError, config_from_dict
from agents.evaluate import main as evaluate
from agents.export.command import main as export
from agents.learners.export import begin_with, export_policy, load_zip
from agents.learners.normalization import statistics
from agents.learners.privileged import PrivilegedCriticPolicy
from agents.metrics import evaluated
from agents.policy import load_policy, save_policy
from agents.run_folder.folder import RunFolder
from agents.training import build_model
from agents.training import main as train
from flexarm_env import SB3VecEnv
from tests.agents.tiny import ENV_ID, KWARGS, write_config

ROUND_OFF = 5e-6  # float32 sums in another order
SHORT = {"hardware": "laboratory", "max_episode_steps": 12}
AGENTS: dict[str, dict[str, Any]] = {
    "a2c": {"policy_kwargs": {"net_arch": []}},
    "ppo": KWARGS["ppo"] | {"policy_kwargs": {"net_arch": {"pi": [8], "vf": [16, 16]}}},
    "trpo": {"n_steps": 32, "batch_size": 64},
}


def model(name: str = "ppo", seed: int = 0, base: Any = None, **env: Any) -> Any:
    """An untrained learner on arms of the laboratory, with a privileged critic unless told."""
    arms = {"id": ENV_ID, "n_envs": 8, "kwargs": SHORT, "privileged": True} | env
    agent = {"name": name, "kwargs": AGENTS.get(name, KWARGS.get(name, {}))}
    experiment = {"env": arms, "agent": agent, "total_steps": 512, "seed": seed}
    return build_model(config_from_dict(experiment | ({"base": base} if base else {})))


@pytest.mark.parametrize(
    ("name", "env"),
    [
        ("a2c", {}),
        ("ppo", {"stack": 3}),
        ("trpo", {"normalize": True}),
        ("ppo", {"stack": 3, "normalize": True}),
    ],
)
def test_the_stored_policy_needs_the_sensors_alone(
    name: str, env: dict[str, Any], tmp_path: Path
) -> None:
    """It acts as the learner over ends of episodes."""
    learner = model(name, **env)
    learner.learn(512)
    learner.policy.action_net.weight.data *= 20.0
    frames, scaling = env.get("stack", 1), learner.get_vec_normalize_env()
    if scaling:
        scaling.training = False
    save_policy(export_policy(learner, {"stack": frames}), tmp_path)
    policy = load_policy(tmp_path)
    assert policy.n_observation == 4
    seen, state, starts, ends = learner.env.reset(), None, np.ones(8, bool), 0
    for _ in range(30):
        raw = (scaling.get_original_obs() if scaling else seen)["observation"][:, -4:]
        actions, state = policy.predict(raw, state, starts)
        expected, _ = learner.predict(seen, deterministic=True)
        np.testing.assert_allclose(actions, expected, atol=ROUND_OFF)
        seen, _, starts, _ = learner.env.step(expected)
        ends += int(starts.sum())
    assert ends >= 16


def test_a_model_is_not_evaluated_with_its_critic() -> None:
    with pytest.raises(ValueError, match=r"evaluate export_policy\(model, \{\}\).* the actor"):
        evaluated(model(), ENV_ID, episodes=2, **SHORT)


def test_only_the_critic_learns_from_the_true_state() -> None:
    learner = model()
    learner.learn(256)
    policy, seen = learner.policy, obs_as_tensor(learner.env.reset(), "cpu")
    with torch.no_grad():
        action, value, _ = policy(seen, deterministic=True)
        told = seen | {"privileged": seen["privileged"] + 0.1}
        assert torch.equal(policy(told, deterministic=True)[0], action)
        assert torch.equal(policy.get_distribution(told).mode(), action)
        assert bool((policy(told)[1] != value).all())
        assert torch.equal(policy.predict_values(seen), value)
        blind = seen | {"observation": 0.0 * seen["observation"]}
        assert bool((policy.predict_values(blind) != value).all())


def test_frames_are_of_the_sensors_alone() -> None:
    envs = model(stack=3).env
    one, seen = SB3VecEnv(ENV_ID, 8, privileged=True, **SHORT), envs.reset()
    truth = one.observation_space["privileged"]
    assert envs.observation_space["privileged"] == truth
    for _ in range(12):
        before = seen
        seen, _, _, infos = envs.step(np.ones((8, 1), np.float32))
    last = infos[0]["terminal_observation"]
    np.testing.assert_array_equal(last["observation"][:8], before["observation"][0, -8:])
    assert last["privileged"].shape == truth.shape
    np.testing.assert_array_equal(seen["observation"][:, :8], 0.0)


def test_policies_begin_with_those_of_other_critics() -> None:
    """A plain one with one that had a privileged critic, and the other way."""
    for mine, other in ({"privileged": False}, {}), ({}, {"privileged": False}):
        learner = model(**mine)
        first = export_policy(model(seed=1, **other), {})
        begin_with(learner, first, {})
        for ours, theirs in zip(export_policy(learner, {}).weights, first.weights, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_a_zip_of_a_stranger_is_loaded(tmp_path: Path) -> None:
    envs = SB3VecEnv(ENV_ID, 4, privileged=True)
    learner = PPO(PrivilegedCriticPolicy, envs, n_steps=32, batch_size=64, device="cpu").learn(128)
    learner.save(tmp_path / "model.zip")
    seen: Any = envs.reset()
    policy = load_zip(tmp_path / "model.zip", trust=True)
    expected, _ = learner.predict(seen, deterministic=True)
    np.testing.assert_allclose(policy.predict(seen["observation"])[0], expected, atol=ROUND_OFF)
    with pytest.raises(ValueError, match=r"takes the observations of SB3VecEnv\(\.\.\., privileg"):
        PPO(PrivilegedCriticPolicy, SB3VecEnv(ENV_ID, 4), device="cpu")


def test_a_run_is_resumed_evaluated_and_exported(
    tmp_path: Path, unjudged: list[RunFolder], capsys: pytest.CaptureFixture[str]
) -> None:
    """With the statistics of both parts of its observations."""
    env = {"kwargs": SHORT, "stack": 2, "normalize": True, "privileged": True}
    path = write_config(tmp_path, "ppo", 256, **env)
    run = RunFolder(tmp_path / "out")
    assert train(["--config", str(path), "--out", str(run.path)]) == 0
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    assert "Resuming at 256" in capsys.readouterr().out
    names = {name.split("/")[1:-1][-1] for name in statistics(build_model(run.read_config()))}
    assert names == {"observation", "privileged", "ret_rms"}
    assert evaluate([str(run.path), "--episodes", "1", "--out", str(tmp_path / "seen")]) == 0
    header = tmp_path / "policy.h"
    assert export([str(run.path), "--format", "c", "--out", str(header)]) == 0


@pytest.mark.parametrize(
    ("name", "base", "sentence"),
    [
        ("sac", None, "env.privileged is for a2c, ppo, trpo, got sac; leave it out"),
        ("recurrent-ppo", None, "env.privileged is for a2c, ppo, trpo, got recurrent-ppo"),
        ("rsl-ppo", None, r"got rsl-ppo; .*rsl-ppo has agent\.kwargs\.privileged_critic"),
        ("ppo", {"controller": "pd"}, "env.privileged and base exclude each other; leave one out"),
    ],
)
def test_other_learners_are_refused(name: str, base: Any, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        model(name, base=base)


def test_trpo_must_learn_from_whole_rollouts(tmp_path: Path) -> None:
    """It cannot take parts of dicts."""
    experiment = yaml.safe_load(write_config(tmp_path, "trpo", 256, privileged=True).read_text())
    experiment["agent"]["kwargs"]["sub_sampling_factor"] = 2
    with pytest.raises(ConfigError, match=r"kwargs\.sub_sampling_factor exclude each other"):
        config_from_dict(experiment)
