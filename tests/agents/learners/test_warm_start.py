"""Trainings that begin with the weights of a stored policy."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from agents.config import ConfigError
from agents.leaderboard.shipped import name_of, named_policy
from agents.learners.export import COLD, begin_with, export_policy
from agents.policy import PolicyError, load_policy
from agents.run_folder.folder import RunFolder
from agents.training import begin, build_model
from agents.training import main as train
from tests.agents.tiny import ENV_ID, one_sentence, write_config
from tests.agents.toys import KWARGS, NETWORK, build

TRACK = "FlexArm/OneLink-Track-v0"
ON_LQG = {"controller": "lqg", "learned": "residual"}
LEARNED = [name for name in sorted(KWARGS) if name not in COLD]


@pytest.mark.parametrize("name", LEARNED)
def test_a_model_acts_as_the_policy_that_it_begins_with(name: str) -> None:
    policy, model = export_policy(build(name, seed=1), {}), build(name, seed=2)
    observations = np.random.default_rng(0).uniform(-5.0, 5.0, (9, 3)).astype(np.float32)
    expected = policy.predict(observations)[0]
    assert np.abs(model.predict(observations, deterministic=True)[0] - expected).max() > 1e-3
    begin_with(model, policy, {})
    actions = model.predict(observations, deterministic=True)[0]
    np.testing.assert_allclose(actions, expected, atol=5e-6)
    if hasattr(model, "actor_target"):
        for ours, theirs in zip(
            model.actor_target.parameters(), model.actor.parameters(), strict=True
        ):
            assert (ours == theirs).all()


@pytest.mark.parametrize(
    ("name", "kwargs", "sentence"),
    [
        (
            "ppo",
            {"policy_kwargs": {"net_arch": [16]}},
            "layer_sizes .* change agent.kwargs.policy_kwargs.net_arch",
        ),
        (
            "sac",
            {"policy_kwargs": {"net_arch": [16, 8]}},
            "activation of .* 'tanh', .* 'relu'; change",
        ),
        ("td3", {"policy_kwargs": NETWORK}, "layer_sizes"),
        ("recurrent-ppo", {}, "recurrent of the policy is 0, .* 2; change agent.policy"),
        ("crossq", {}, r"is not for .*crossq.* got a policy of ppo for crossq"),
    ],
)
def test_another_network_is_refused(name: str, kwargs: dict, sentence: str) -> None:
    with pytest.raises(PolicyError, match=rf"agent\.warm_start.*{sentence}"):
        begin_with(build(name, **kwargs), export_policy(build("ppo"), {}), {})


@pytest.mark.parametrize(
    ("theirs", "ours", "sentence"),
    [
        ({}, {"env_kwargs": {"hardware": "laboratory"}}, "observation .* 'state', .* 'sensors'"),
        ({"env_kwargs": {"obs": "sensors"}}, {}, "observation .* 'sensors', .* 'state'; change"),
        ({}, {"env_id": TRACK}, "observation .* 'state', .* 'state with a path'"),
        ({}, {"base": ON_LQG}, "base of the policy is 'none', .* 'residual on lqg'; change base"),
        ({"base": ON_LQG}, {}, "base of the policy is 'residual on lqg', .* 'none'"),
        ({}, {"stack": 3}, "stack of the policy is 1, .* 3; change env.stack"),
        ({"env_kwargs": {"obj": "state"}}, {}, "Unknown key 'obj' in about.env_kwargs"),
    ],
)
def test_a_policy_of_other_observations_or_on_another_base_is_refused(
    theirs: dict, ours: dict, sentence: str
) -> None:
    """Two frames of four readings are as many numbers as one exact state of one link."""
    policy = export_policy(build("ppo"), {"env_id": ENV_ID} | theirs)
    with pytest.raises(PolicyError, match=rf"agent\.warm_start: {sentence}"):
        begin_with(build("ppo"), policy, {"env_id": ENV_ID} | ours)
    begin_with(build("ppo"), replace(policy, about={"stack": policy.stack}), {"env_id": ENV_ID})


def test_a_run_keeps_its_warm_start(
    tmp_path: Path, unjudged: list[RunFolder], capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where the policy is gone when the run is resumed."""
    config = write_config(tmp_path, "ppo", 256)
    first, run = RunFolder(tmp_path / "first"), RunFolder(tmp_path / "run")
    assert train(["--config", str(config), "--out", str(first.path)]) == 0
    experiment = yaml.safe_load(config.read_text())
    experiment["agent"]["warm_start"] = str(first.path)
    config.write_text(yaml.safe_dump(experiment))
    assert train(["--config", str(config), "--out", str(run.path), "--seed", "3"]) == 0
    assert name_of(load_policy(run.policy)) == "ppo-warm"
    weights = load_policy(first.policy).weights
    shutil.rmtree(first.policy)
    assert train(["--resume", str(run.path), "--steps", "384"]) == 0
    again = build_model(run.read_config())  # as without a checkpoint
    begin(run, run.read_config(), again, {})
    for policy in (load_policy(run.untrained), export_policy(again, {})):
        for ours, theirs in zip(policy.weights, weights, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    capsys.readouterr()
    assert train(["--config", str(config), "--out", str(tmp_path / "late")]) == 2
    assert "agent.warm_start: neither a run nor a shipped experiment" in one_sentence(capsys)
    assert not (tmp_path / "late").exists()


def test_of_a_shipped_experiment_the_policy_of_the_same_seed_begins() -> None:
    seeds = [named_policy("one_link_reach_ppo", seed).about["seed"] for seed in (2, 3, 99)]
    assert seeds == [2, 3, 0]
    with pytest.raises(ConfigError, match="no policy of one_link_reach_shac is shipped; train it"):
        named_policy("one_link_reach_shac", 0)
