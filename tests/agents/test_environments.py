"""Files name environments of this package and plain keywords; nothing they name is imported."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import flexarm_env
from agents.config import ConfigError, config_from_dict, load_config
from agents.environments import KEYWORDS, check_keywords

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
        ({"wrappers": []}, "unknown key 'wrappers' in env.kwargs; known: actuator, arm, "),
        ({"vector_kwargs": {}}, "unknown key 'vector_kwargs'"),
        ({"vectorization_mode": "async"}, "unknown key 'vectorization_mode'"),
        ({"render_mode": "human"}, "unknown key 'render_mode'"),
        ({"task": "Track"}, "unknown key 'task'"),
        ({"n_env": 5}, "unknown key 'n_env'"),
        ({"tourque_limit": 5}, "unknown key 'tourque_limit' in env.kwargs; did you mean 'torque_l"),
        ({1: 5}, "unknown key 1 in env.kwargs"),
        ({"torque_limit": float("inf")}, "must hold finite numbers, text, lists and tables only"),
        ({"randomize": {"a": b"bytes"}}, "must hold finite numbers, text, lists and tables only"),
        ([], "env.kwargs must be a table such as"),
        ("obs", "env.kwargs must be a table such as"),
    ],
)
def test_keywords_that_are_no_data_of_an_environment_are_refused(
    kwargs: Any, sentence: str
) -> None:
    with pytest.raises(ValueError, match=r"env\.kwargs") as caught:
        check_keywords(kwargs, "env.kwargs")
    assert sentence in str(caught.value)
    with pytest.raises(ConfigError, match=r"env\.kwargs"):
        config_from_dict(experiment({"id": ENV_ID, "kwargs": kwargs}))


def test_the_known_keywords_are_those_of_an_environment() -> None:
    """Two that are in every documentation, and none that the id or the batch sets."""
    assert {"arm", "obs", "reward", "max_episode_steps"} <= set(KEYWORDS)
    assert not {"self", "task", "n_env", "single", "max_steps", "num_envs"} & set(KEYWORDS)
    assert json.loads(json.dumps(check_keywords({"obs": "sensors"}, "x"))) == {"obs": "sensors"}
