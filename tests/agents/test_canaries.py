"""Files can name only environments of this package and plain keywords, and import nothing."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml

import flexarm_env
from agents.config import ConfigError, config_from_dict, load_config
from agents.environments import KEYWORDS, check_keywords
from agents.evaluate import main as evaluate
from agents.metrics import make_batch
from agents.policy import Policy, save_policy

ENV_ID = "FlexArm/OneLink-Reach-v0"


@pytest.fixture
def canary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A file that appears when the module `evilmod` of the current folder is imported."""
    made = tmp_path / "made"
    (tmp_path / "evilmod.py").write_text(f"import pathlib\npathlib.Path({str(made)!r}).touch()\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield made
    sys.modules.pop("evilmod", None)


def experiment(env: dict[str, Any]) -> dict[str, Any]:
    return {"env": env, "agent": {"name": "ppo"}, "total_steps": 1000}


@pytest.mark.parametrize("env_id", sorted(flexarm_env.IDS))
def test_ids_of_this_package_are_known_with_and_without_their_prefix(env_id: str) -> None:
    assert flexarm_env.registered(env_id) == env_id
    assert flexarm_env.registered(f"flexarm_env:{env_id}") == env_id
    if "Goal" not in env_id:  # experiments take no dicts as observations
        assert config_from_dict(experiment({"id": f"flexarm_env:{env_id}"})).env.id == env_id


@pytest.mark.parametrize(
    ("env_id", "remedy"),
    [
        ("FlexArm/OneLink-Reech-v0", "did you mean 'FlexArm/OneLink-Reach-v0'"),
        ("evilmod:FlexArm/OneLink-Reach-v0", "did you mean 'FlexArm/OneLink-Reach-v0'"),
        ("flexarm_env:evilmod:FlexArm/OneLink-Reach-v0", "did you mean"),
        ("FlexArm/OneLink-Reach", "did you mean"),
        ("CartPole-v1", "known: FlexArm/OneLink-Reach-v0, "),
        ("", "known: "),
        ("x" * 10_000, "known: "),
    ],
)
def test_other_ids_of_a_file_are_refused(env_id: str, remedy: str, canary: Path) -> None:
    with pytest.raises(ValueError, match="is not an environment of flexarm") as caught:
        flexarm_env.registered(env_id)
    assert remedy in str(caught.value)
    assert len(str(caught.value)) < 500
    with pytest.raises(ConfigError, match="is not an environment of flexarm"):
        config_from_dict(experiment({"id": env_id}))
    assert not canary.exists()


def test_an_experiment_file_imports_nothing(canary: Path) -> None:
    path = canary.parent / "experiment.yaml"
    path.write_text(yaml.safe_dump(experiment({"id": f"evilmod:{ENV_ID}"})))
    with pytest.raises(ConfigError, match="is not an environment of flexarm"):
        load_config(path)
    assert not canary.exists()


@pytest.mark.parametrize(
    ("kwargs", "sentence"),
    [
        ({"wrappers": []}, "Unknown key 'wrappers' in env.kwargs; nearest known: "),
        ({"vector_kwargs": {}}, "Unknown key 'vector_kwargs'"),
        ({"vectorization_mode": "async"}, "Unknown key 'vectorization_mode'"),
        ({"render_mode": "human"}, "Unknown key 'render_mode'"),
        ({"task": "Track"}, "Unknown key 'task'"),
        ({"n_env": 5}, "Unknown key 'n_env'"),
        (
            {"tourque_limit": 5},
            "in env.kwargs; nearest known: 'torque_limit'",
        ),
        ({1: 5}, "Unknown key 1 in env.kwargs"),
        ({"torque_limit": float("inf")}, "must hold finite numbers, text, lists and tables only"),
        ({"randomize": {"a": b"bytes"}}, "must hold finite numbers, text, lists and tables only"),
        ([], "env.kwargs must be a"),
        ("obs", "env.kwargs must be a"),
    ],
)
def test_keywords_that_are_not_environment_data_are_refused(kwargs: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=r"env\.kwargs") as caught:
        check_keywords(kwargs, "env.kwargs")
    assert sentence in str(caught.value)
    with pytest.raises(ConfigError, match=r"env\.kwargs"):
        config_from_dict(experiment({"id": ENV_ID, "kwargs": kwargs}))


def test_the_known_keywords_are_those_of_an_environment() -> None:
    """Two documented keywords are known; keywords set by the id or the batch are not."""
    assert {"arm", "obs", "reward", "max_episode_steps"} <= set(KEYWORDS)
    assert not {"self", "task", "n_env", "single", "max_steps", "num_envs"} & set(KEYWORDS)
    assert json.loads(json.dumps(check_keywords({"obs": "sensors"}, "x"))) == {"obs": "sensors"}


def stored_policy(folder: Path, about: dict[str, Any]) -> Path:
    """A policy that fits the one-link arm, with the given `about`."""
    envs = make_batch(ENV_ID, 1)
    n = envs.single_observation_space.shape[0]
    envs.close()
    policy = Policy(
        weights=(np.zeros((1, n), np.float32),),
        biases=(np.zeros(1, np.float32),),
        activation="tanh",
        squashing="clip",
        observation_low=np.full(n, -1.0, np.float32),
        observation_high=np.full(n, 1.0, np.float32),
        about=about,
    )
    save_policy(policy, folder)
    return folder


@pytest.mark.parametrize(
    ("about", "sentence"),
    [
        ({"env_id": f"evilmod:{ENV_ID}"}, "is not an environment of flexarm; did you mean"),
        ({"env_id": "evilmod:Evil-v0", "env_kwargs": {}}, "is not an environment of flexarm"),
        ({"env_id": ENV_ID, "env_kwargs": {"wrappers": []}}, "Unknown key 'wrappers'"),
        ({"env_id": ENV_ID, "env_kwargs": 5}, "about.env_kwargs must be a mapping"),
        ({"env_id": ENV_ID, "env_kwargs": {"arm": "evil.yaml"}}, "evil.yaml"),
        ({"env_id": ENV_ID, "env_kwargs": {"arm": {"links": []}}}, "links"),
        ({"env_id": ENV_ID, "env_kwargs": {"reward": {"evil": 1.0}}}, "evil"),
        ({}, "--env is needed"),
    ],
)
def test_a_policy_imports_nothing(
    about: dict[str, Any], sentence: str, canary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = stored_policy(canary.parent / "policy", about)
    assert evaluate([str(folder), "--out", str(canary.parent / "out")]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not canary.exists()
    assert not (canary.parent / "out").exists()


def test_a_policy_with_an_unknown_environment_runs_in_a_known_one(canary: Path) -> None:
    folder = stored_policy(canary.parent / "policy", {"env_id": f"evilmod:{ENV_ID}"})
    out = canary.parent / "out"
    assert evaluate([str(folder), "--env", ENV_ID, "--episodes", "1", "--out", str(out)]) == 0
    assert json.loads((out / "evaluation.json").read_text())["env"] == ENV_ID
    assert not canary.exists()


HOSTILE_NAME = 'x."""\nimport pathlib; pathlib.Path("made").touch()\n"""'


def test_an_arm_inside_keywords_is_data(canary: Path) -> None:
    """The name would be code if it were pasted into the generated source."""
    link = {"length": 1.0, "rho_A": 1.0, "EIz": 10.0, "modes": []}
    arm = {"name": HOSTILE_NAME, "links": [link]}
    config = config_from_dict(experiment({"id": ENV_ID, "kwargs": {"arm": arm}}))
    envs = make_batch(config.env.id, 2, config.env.make_kwargs)
    envs.reset(seed=0)
    envs.step(np.zeros((2, 1), np.float32))
    envs.close()
    assert not canary.exists()


def test_a_command_line_may_import_but_makes_environments_of_this_package_only(
    canary: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    module = canary.parent / "evilmod.py"
    module.write_text(
        module.read_text()
        + "import gymnasium\n"
        + "gymnasium.register('Mine/Slow-v0', max_episode_steps=9, "
        + "vector_entry_point='flexarm_env.interfaces.vector:FlexArmVectorEnv', "
        + "entry_point='flexarm_env.interfaces.env:FlexArmEnv', "
        + "kwargs={'task': 'Reach', 'arm': 'slim'})\n"
    )
    out = ["--episodes", "1", "--out", str(canary.parent / "out")]
    try:
        assert evaluate(["zero", "--env", "evilmod:Mine/Slow-v0", *out]) == 0
        assert canary.exists()
    finally:
        gym.registry.pop("Mine/Slow-v0", None)
    for env_id in ("CartPole-v1", "Pendulum-v1"):
        assert evaluate(["pd", "--env", env_id, *out]) == 2
        assert f"{env_id} is not an environment of flexarm" in capsys.readouterr().err
    assert evaluate(["pd", "--env", "nosuchmod:Mine/Slow-v0", *out]) == 2
    error = capsys.readouterr().err
    assert "nosuchmod" in error
    assert error.count("\n") == 1
