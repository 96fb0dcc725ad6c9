"""Running statistics of observations and rewards: as RL Zoo sets them, stored and resumed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from agents.config import Config, ConfigError, config_from_dict
from agents.evaluate import main as evaluate
from agents.hybrid.environment import HybridVecEnv
from agents.learners.export import export_policy, load_zip
from agents.learners.normalization import DEFAULTS, restore_statistics, statistics
from agents.learners.wrapped import refuse_wrapped
from agents.metrics import evaluated
from agents.policy import Policy, PolicyError, load_policy, save_policy
from agents.run_folder.checkpoints import (
    CheckpointError,
    cut_off,
    restore_checkpoint,
    save_checkpoint,
)
from agents.run_folder.folder import RunFolder
from agents.training import build_model
from agents.training import main as train
from flexarm_env import SB3VecEnv
from tests.agents.tiny import ENV_ID, write_config
from tests.agents.toys import KWARGS, Toy, build, check_alike, trained

ROUND_OFF = 5e-6  # float32 sums in another order, over a sequence
PROGRESS = {"session": 0, "seconds": 1.0}


def normalized_toys(name: str, stack: int = 1, **settings: Any) -> Any:
    """Toys whose observations a clip of 1.5 deviations cuts off, stacked as RL Zoo does."""
    toys: Any = DummyVecEnv([Toy] * (1 if name == "ars" else 2))
    envs: Any = VecNormalize(toys, **({"clip_obs": 1.5} | settings))
    return VecFrameStack(envs, stack) if stack > 1 else envs


def largest_difference(model: Any, policy: Policy) -> float:
    """Of actions over episodes that end, the policy's on the environment's own observations."""
    envs = model.get_vec_normalize_env()
    envs.training = False
    seen: Any = model.env.reset()
    starts, theirs, ours, gap, ends = np.ones(model.n_envs, bool), None, None, 0.0, 0
    for _ in range(60):
        expected, theirs = model.predict(seen, theirs, starts, deterministic=True)
        actions, ours = policy.predict(envs.get_original_obs(), ours, starts)
        gap = max(gap, float(np.abs(actions - expected).max()))
        seen, _, starts, _ = model.env.step(expected)
        ends += int(starts.sum())
    assert ends > 2
    return gap


@pytest.mark.parametrize("name", sorted(KWARGS))
def test_the_stored_actor_of_every_algorithm_sees_what_the_learner_saw(
    name: str, tmp_path: Path
) -> None:
    model = trained(name, normalized_toys(name))
    save_policy(export_policy(model, {}), tmp_path)
    policy = load_policy(tmp_path)
    assert largest_difference(model, policy) < ROUND_OFF
    assert policy.normalization is not None
    raw = np.random.default_rng(0).uniform(-2.0, 2.0, (500, 3)).astype(np.float32)
    expected = model.get_vec_normalize_env().normalize_obs(raw)
    np.testing.assert_array_equal(policy.normalization.apply(raw), expected)
    assert (np.abs(expected) == np.float32(1.5)).mean() > 0.3
    plain = replace(policy, normalization=None)
    assert np.abs(policy.predict(raw)[0] - plain.predict(raw)[0]).max() > 1e-2


@pytest.mark.parametrize("name", ["ppo", "recurrent-ppo"])
def test_observations_are_normalized_before_they_are_stacked(name: str, tmp_path: Path) -> None:
    """The zeros before an episode's first observation are none that were normalized."""
    model = trained(name, normalized_toys(name, stack=3))
    save_policy(export_policy(model, {"stack": 3}), tmp_path)
    assert largest_difference(model, load_policy(tmp_path)) < ROUND_OFF


def test_only_normalized_observations_change_the_stored_policy(tmp_path: Path) -> None:
    model = build("ppo", env=normalized_toys("ppo", norm_obs=False))
    model.learn(64)
    save_policy(export_policy(model, {}), tmp_path)
    assert "normalization" not in json.loads((tmp_path / "policy.json").read_text())
    assert largest_difference(model, load_policy(tmp_path)) < ROUND_OFF


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_a_zip_of_rl_zoo_is_loaded_with_the_statistics_beside_it(name: str, tmp_path: Path) -> None:
    """And without them refused, as RL Zoo's best_model.zip would be."""
    model = trained(name, normalized_toys(name))
    model.save(tmp_path / "toy.zip")
    if name == "sac":  # whose zip does not tell
        (tmp_path / "id").mkdir()
        (tmp_path / "id/vecnormalize.pkl").touch()
    with pytest.raises(PolicyError, match=r"trained with VecNormalize.*toy/vecnormalize\.pkl\.$"):
        load_zip(tmp_path / "toy.zip", trust=True)
    (tmp_path / "toy").mkdir()
    model.get_vec_normalize_env().save(tmp_path / "toy/vecnormalize.pkl")
    policy = load_zip(tmp_path / "toy.zip", trust=True)
    assert largest_difference(model, policy) < ROUND_OFF
    (tmp_path / "toy/vecnormalize.pkl").write_bytes(b"no pickle")
    with pytest.raises(PolicyError, match=r"toy/vecnormalize\.pkl: cannot be loaded"):
        load_zip(tmp_path / "toy.zip", trust=True)


def test_a_model_of_normalized_observations_is_not_evaluated_on_others() -> None:
    model = build("ppo", env=VecNormalize(SB3VecEnv(ENV_ID, 2)))
    with pytest.raises(ValueError, match=r"VecNormalize.*evaluate export_policy\(model, \{\}\)"):
        evaluated(model, ENV_ID, episodes=2)


def test_a_loaded_model_without_its_statistics_is_not_evaluated(tmp_path: Path) -> None:
    """Off-policy algorithms keep original observations in any case, so theirs are not told."""
    model = build("ppo", env=normalized_toys("ppo")).learn(32)
    model.save(tmp_path / "toy")
    with pytest.raises(ValueError, match="was trained with VecNormalize, whose statistics its zip"):
        evaluated(type(model).load(tmp_path / "toy", device="cpu"), ENV_ID, episodes=2)
    for free in (build("ppo").learn(32), build("sac").learn(2)):
        refuse_wrapped(free)


def test_a_model_of_scaled_actions_is_not_evaluated_on_those_of_an_arm() -> None:
    """An arm would take 0.8 of its torque for 0.4."""
    model = build("ppo", env=gym.wrappers.RescaleAction(Toy(), -2.0, 2.0))
    with pytest.raises(ValueError, match=r"The model acts in \[-2, 2\].*predict converts them"):
        evaluated(model, ENV_ID, episodes=2)


def test_statistics_of_stacked_observations_are_refused() -> None:
    envs = VecNormalize(VecFrameStack(DummyVecEnv([Toy]), 3))
    with pytest.raises(PolicyError, match="must be inside VecFrameStack: it has 9 means"):
        export_policy(build("ppo", env=envs), {"stack": 3})


# ---- policy files of strangers ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        ({"mean": [0.0, 0.0]}, "normalization.mean must have 3 numbers, got 2"),
        ({"mean": [0.0, float("nan"), 0.0]}, "normalization.mean[1] must be a finite number"),
        ({"mean": None}, "normalization.mean must be a list, got None"),
        ({"variance": [1.0] * 4}, "normalization.variance must have 3 numbers, got 4"),
        ({"variance": [1.0, 1.0, -1e-9]}, "normalization.variance[2] must not be negative"),
        ({"variance": [1.0, 1.0, float("inf")]}, "normalization.variance[2] must be a finite"),
        ({"epsilon": 0.0}, "normalization.epsilon must be positive, got 0.0"),
        ({"clip": -10.0}, "normalization.clip must be positive, got -10.0"),
        ({"clip": "10"}, "normalization.clip [-] must be a number, got the text"),
        ({"code": "import os"}, "Unknown key 'code' in normalization"),
    ],
)
def test_wrong_statistics_of_a_policy_are_refused(
    damage: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    save_policy(export_policy(build("ppo", env=normalized_toys("ppo")), {}), tmp_path)
    path = tmp_path / "policy.json"
    description = json.loads(path.read_text())
    description["normalization"] |= damage
    path.write_text(json.dumps(description))
    with pytest.raises(PolicyError) as caught:
        load_policy(tmp_path)
    assert sentence in str(caught.value)
    path.write_text(json.dumps(description | {"normalization": None}))
    with pytest.raises(PolicyError, match="normalization must be a mapping"):
        load_policy(tmp_path)


# ---- checkpoints -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ppo", "recurrent-ppo", "sac"])
def test_a_restored_learner_goes_on_as_the_one_that_was_never_stopped(
    name: str, tmp_path: Path
) -> None:
    """Bit for bit, statistics included, in the episodes that a new session starts."""
    models = [build(name, env=normalized_toys(name), seed=seed) for seed in (0, 1)]
    first, second = models
    first.learn(96)
    folder = save_checkpoint(first, tmp_path, PROGRESS)
    restore_checkpoint(second, folder)
    assert statistics(second)["normalize/obs_rms/count"] > 90.0
    if name == "sac":  # the episodes of a stored buffer end with it
        first.replay_buffer.timeouts = cut_off(first.replay_buffer)
    assert "normalize/ret_rms/var" in check_alike(models, 96, tmp_path)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"obs_rms/mean": np.zeros(4)}, r"obs_rms/mean must have shape \(3,\), got \(4,\)"),
        ({"obs_rms/mean": np.full(3, np.nan)}, "obs_rms/mean must hold finite numbers"),
        ({"obs_rms/var": np.array([1.0, -1.0, 1.0])}, "obs_rms/var must not be negative"),
        ({"ret_rms/count": np.array(-1.0)}, "ret_rms/count must not be negative"),
        ({"ret_rms/mean": np.array("x")}, "ret_rms/mean must hold numbers"),
        ({"act_rms/mean": np.zeros(3)}, "act_rms/mean belongs to a run with other settings"),
    ],
)
def test_wrong_statistics_of_a_checkpoint_are_refused(
    changes: dict[str, Any], sentence: str
) -> None:
    model = build("ppo", env=normalized_toys("ppo"))
    changes = {f"normalize/{name}": value for name, value in changes.items()}
    with pytest.raises(ValueError, match=sentence):
        restore_statistics(model, statistics(model) | changes)


def test_a_checkpoint_fits_runs_of_its_own_settings_only(tmp_path: Path) -> None:
    plain, normalized = build("ppo"), build("ppo", env=normalized_toys("ppo"))
    folders = {x: save_checkpoint(x, tmp_path / str(k), PROGRESS) for k, x in enumerate((plain,
               normalized))}  # fmt: skip
    with pytest.raises(CheckpointError, match=r"does not fit this run \('normalize/obs_rms/mean"):
        restore_checkpoint(normalized, folders[plain])
    with pytest.raises(CheckpointError, match=r"other settings of env\.normalize"):
        restore_checkpoint(plain, folders[normalized])


# ---- experiments -----------------------------------------------------------------------------


def experiment(name: str = "ppo", zoo: Any = None, **env: Any) -> Config:
    kwargs = {} if zoo is None else {"normalize": zoo}
    more = {"n_steps": 16, "batch_size": 32} if name == "ppo" else {}
    data = {"env": {"id": ENV_ID, "n_envs": 2} | env, "total_steps": 128}
    return config_from_dict(data | {"agent": {"name": name, "kwargs": kwargs | more}})


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (False, False),
        (True, DEFAULTS),
        ("dict(norm_obs=True, norm_reward=False)", DEFAULTS | {"norm_reward": False}),
        ("{'norm_obs': False, 'gamma': 0.99}", DEFAULTS | {"norm_obs": False}),
        ({"clip_obs": 5, "epsilon": 1e-6}, DEFAULTS | {"clip_obs": 5.0, "epsilon": 1e-6}),
    ],
)
def test_every_form_of_the_zoo_becomes_one_setting(given: Any, expected: Any) -> None:
    config = experiment(zoo=given)
    assert config.env.normalize == expected
    assert config_from_dict(config.to_dict()) == config
    if not isinstance(given, str):
        assert experiment(normalize=given) == config


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"norm_observations": True}, "Unknown key 'norm_observations' in env.normalize"),
        ("dict(training=False)", "Unknown key 'training' in env.normalize"),
        ({"norm_obs": 1}, "env.normalize.norm_obs must be true or false, got 1"),
        ({"clip_obs": 0.0}, "env.normalize.clip_obs must be between 0.001 and 1e"),
        ({"clip_reward": "10"}, "env.normalize.clip_reward must be a number, got the text"),
        ({"epsilon": float("nan")}, "env.normalize.epsilon must be a finite number"),
        ({"gamma": 0.9}, r"env.normalize.gamma is always agent.kwargs.gamma \(0.99\), got 0.9"),
        ("__import__('os').mkdir('made')", "such as 'dict(norm_obs=True"),
        ("true", "agent.kwargs.normalize must be a table"),
    ],
)
def test_other_settings_are_refused(given: Any, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence.replace("(norm", r"\(norm")):
        experiment(zoo=given)


def test_one_setting_has_one_place_and_one_type() -> None:
    with pytest.raises(ConfigError, match=r"kwargs\.normalize and env\.normalize are one setting"):
        experiment(zoo=True, normalize=True)
    with pytest.raises(ConfigError, match=r"env\.normalize must be true or false or a table"):
        experiment(normalize="yes")


def test_a_replay_buffer_cannot_hold_stacked_observations_of_the_zoo() -> None:
    experiment("sac", normalize=True)
    with pytest.raises(ConfigError, match=r"env\.stack \(2\) exclude each other for sac"):
        experiment("sac", normalize=True, stack=2)


def test_the_batch_is_normalized_then_stacked_and_discounted_as_the_agent() -> None:
    config = experiment(normalize={"clip_obs": 3.0, "norm_reward": False}, stack=2)
    config = replace(
        config, agent=replace(config.agent, kwargs=config.agent.kwargs | {"gamma": 0.9})
    )
    envs: Any = build_model(config).env
    assert isinstance(envs, VecFrameStack)
    inner: Any = envs.venv
    assert isinstance(inner, VecNormalize)
    assert isinstance(inner.venv, SB3VecEnv)
    assert (inner.gamma, inner.clip_obs, inner.norm_reward) == (0.9, 3.0, False)
    envs.close()
    assert not isinstance(build_model(experiment()).env, VecNormalize)


@pytest.mark.parametrize(("name", "stack"), [("ppo", 2), ("recurrent-ppo", 1), ("sac", 1)])
def test_a_normalized_run_is_trained_resumed_and_evaluated(
    name: str, stack: int, tmp_path: Path, unjudged: list[RunFolder]
) -> None:
    """Its log has the task's own returns, whatever the learner sees."""
    env = {"kwargs": {"max_episode_steps": 20}, "stack": stack}
    path = write_config(tmp_path, name, 512, normalize={"clip_reward": 0.001}, **env)
    run = RunFolder(tmp_path / "out")
    assert train(["--config", str(path), "--out", str(run.path)]) == 0
    first = load_policy(run.policy).normalization
    assert train(["--resume", str(run.path), "--steps", "1024"]) == 0
    second, none = load_policy(run.policy).normalization, load_policy(run.untrained).normalization
    assert first is not None
    assert second is not None
    assert none is not None
    assert (first.variance != second.variance).all()
    np.testing.assert_array_equal(none.variance, 1.0)
    assert run.read_config().env.normalize == DEFAULTS | {"clip_reward": 0.001}
    returns = [row["return"] for row in run.rows() if row["return"] is not None]
    assert max(np.abs(returns)) > 20 * 0.001
    assert evaluate([str(run.path), "--episodes", "1", "--out", str(tmp_path / "seen")]) == 0


def test_a_policy_on_a_controller_sees_the_controller_normalized(
    tmp_path: Path, unjudged: list[RunFolder]
) -> None:
    path = write_config(tmp_path, "ppo", 256, normalize=True, kwargs={"hardware": "laboratory"})
    path.write_text(path.read_text() + "base: {controller: lqg, scale: 0.2}\n")
    run = RunFolder(tmp_path / "out")
    assert train(["--config", str(path), "--out", str(run.path)]) == 0
    envs: Any = build_model(run.read_config()).env
    assert isinstance(envs.venv, HybridVecEnv)
    statistics = load_policy(run.policy).normalization
    assert statistics is not None
    assert statistics.mean.shape == envs.observation_space.shape
    assert statistics.mean.size > envs.venv.venv.observation_space.shape[0]
    assert evaluate([str(run.path), "--episodes", "1", "--out", str(tmp_path / "seen")]) == 0
