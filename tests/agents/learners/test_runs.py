"""A run of every algorithm: trained, resumed from its checkpoint, stored and evaluated."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from stable_baselines3.common.callbacks import BaseCallback

from agents import training
from agents.config import load_config
from agents.evaluate import main as evaluate
from agents.metrics import make_batch
from agents.policy import PolicyError, load_policy
from agents.run_folder.checkpoints import list_checkpoints
from agents.run_folder.folder import RunFolder
from agents.training import main as train
from tests.agents.tiny import ENV_ID, KWARGS, one_sentence, write_config


@pytest.mark.parametrize("name", sorted(KWARGS))
def test_a_run_of_every_algorithm_resumes_and_is_evaluated(
    name: str, tmp_path: Path, unjudged: list[RunFolder], capsys: pytest.CaptureFixture[str]
) -> None:
    if name == "rsl-ppo":
        pytest.importorskip("rsl_rl")
    env = {"n_envs": 1 if name == "ars" else 8, "kwargs": {"max_episode_steps": 20}}
    run = RunFolder(tmp_path / "out")
    config = write_config(tmp_path, name, 256, **env)
    assert train(["--config", str(config), "--out", str(run.path)]) == 0
    steps = load_policy(run.policy).about["steps"]
    assert list_checkpoints(run.checkpoints)[-1].name == f"step_{steps:012d}"
    untrained, first = load_policy(run.untrained), load_policy(run.policy)
    assert any((a != b).any() for a, b in zip(untrained.weights, first.weights, strict=True))

    ended = run.rows()[-1]["episodes"]
    assert train(["--resume", str(run.path), "--steps", str(2 * steps)]) == 0
    assert f"Resuming at {steps:,}" in capsys.readouterr().out
    policy = load_policy(run.policy)
    assert policy.about["steps"] >= 2 * steps
    assert policy.about["algorithm"] == name
    assert [row["session"] for row in run.rows()][-1] == 1
    assert min(row["episodes"] for row in run.rows() if row["session"]) >= ended > 0

    out = tmp_path / "evaluated"
    assert evaluate([str(run.path), "--episodes", "1", "--out", str(out)]) == 0
    assert json.loads((out / "evaluation.json").read_text())["env_kwargs"] == env["kwargs"]


def test_a_policy_that_cannot_be_stored_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(model: Any, about: Any) -> None:
        raise PolicyError("Only networks with one activation can be stored.")

    monkeypatch.setattr(training, "export_policy", refused)
    config = write_config(tmp_path, "sac", 256)
    assert train(["--config", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "Only networks with one activation" in one_sentence(capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_exploration_that_depends_on_the_state_is_trained_and_resumed(
    name: str, tmp_path: Path, unjudged: list[RunFolder]
) -> None:
    """RL Zoo's `use_sde`."""
    run = RunFolder(tmp_path / "out")
    config = write_config(tmp_path, name, 256, kwargs={"max_episode_steps": 20})
    given = yaml.safe_load(config.read_text())
    given["agent"]["kwargs"] |= {"use_sde": True, "sde_sample_freq": 4}
    config.write_text(yaml.safe_dump(given))
    assert train(["--config", str(config), "--out", str(run.path)]) == 0
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    assert load_policy(run.policy).mean_limit == {"ppo": None, "sac": 2.0}[name]
    assert evaluate([str(run.path), "--episodes", "1", "--out", str(tmp_path / "seen")]) == 0


@pytest.mark.parametrize("name", ["ppo", "rsl-ppo", "shac"])
def test_a_resumed_session_begins_with_episodes_of_its_own_seed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "rsl-ppo":
        pytest.importorskip("rsl_rl")
    starts: list[Any] = []

    class Start(BaseCallback):
        def _on_training_start(self) -> None:
            starts.append(self.model._last_obs)

        def _on_step(self) -> bool:
            return False

    monkeypatch.setattr(training, "make_callback", lambda *given: Start())
    config, run = load_config(write_config(tmp_path, name, 256)), RunFolder(tmp_path / "out")
    model = training.build_model(config)
    training.run_session(run, config, model, {"session": 0, "seconds": 0.0})
    found = starts[0]["observation"] if isinstance(starts[0], dict) else starts[0]
    expected, _ = make_batch(ENV_ID, 8).reset(seed=training.SESSION_STRIDE)
    np.testing.assert_allclose(np.asarray(found), expected, atol=1e-6)
