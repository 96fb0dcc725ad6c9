"""A stored policy is arrays and JSON, and acts exactly as the network it came from."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import A2C, TD3

from agents.policy import PolicyError, export_policy, load_policy, load_zip, save_policy
from tests.agents.toys import Toy, build


@pytest.fixture(scope="module", params=["ppo", "sac"])
def model(request: pytest.FixtureRequest) -> Any:
    model = build(request.param)
    model.learn(64)
    with_large_actions = model.policy.action_net if request.param == "ppo" else model.actor.mu
    with_large_actions.weight.data *= 30.0  # so that clipping and squashing have work to do
    return model


def test_stored_policy_acts_as_the_network(model: Any, tmp_path: Path) -> None:
    save_policy(export_policy(model, {"env_id": "toy"}), tmp_path)
    policy = load_policy(tmp_path)
    observations = np.random.default_rng(0).uniform(-5.0, 5.0, (200, 3)).astype(np.float32)

    expected, _ = model.predict(observations, deterministic=True)
    actions, _ = policy.predict(observations)

    np.testing.assert_allclose(actions, expected, atol=2e-6)  # float32 sums in another order
    assert (np.abs(actions) > 0.99).any()
    single, _ = policy.predict(observations[0])
    np.testing.assert_allclose(single, actions[0], atol=2e-6)
    assert policy.about["env_id"] == "toy"


def test_policy_files_hold_no_pickle(model: Any, tmp_path: Path) -> None:
    """Every array loads with pickling forbidden, and the rest is JSON."""
    save_policy(export_policy(model, {}), tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"policy.json", "weights.npz"}
    json.loads((tmp_path / "policy.json").read_text())
    with np.load(tmp_path / "weights.npz", allow_pickle=False) as arrays:
        assert all(arrays[name].dtype == np.float32 for name in arrays.files)


def test_a_zip_is_unpickled_only_on_trust(model: Any, tmp_path: Path) -> None:
    model.save(tmp_path / "model.zip")
    with pytest.raises(PolicyError, match="--trust"):
        load_zip(tmp_path / "model.zip")

    policy = load_zip(tmp_path / "model.zip", trust=True)

    observation = np.array([0.3, -0.2, 0.9], np.float32)
    expected = model.predict(observation, deterministic=True)[0]
    np.testing.assert_allclose(policy.predict(observation)[0], expected, atol=2e-6)


@pytest.mark.parametrize("algorithm", [A2C, TD3])
def test_a_zip_of_another_algorithm_is_refused_before_it_is_unpickled(
    algorithm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    algorithm("MlpPolicy", Toy()).save(tmp_path / "model.zip")
    monkeypatch.setattr("stable_baselines3.common.save_util.cloudpickle.loads", pytest.fail)
    with pytest.raises(PolicyError, match="Only PPO and SAC can be loaded"):
        load_zip(tmp_path / "model.zip", trust=True)


@pytest.mark.parametrize("error", [KeyError("x"), SyntaxError("x"), AssertionError("x\ny")])
def test_whatever_unpickling_raises_is_a_sentence(
    model: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*arguments: Any, **keywords: Any) -> None:
        raise error

    model.save(tmp_path / "model.zip")
    monkeypatch.setattr("stable_baselines3.common.base_class.load_from_zip_file", fail)
    with pytest.raises(PolicyError, match="cannot be loaded as a stable-baselines3 zip") as caught:
        load_zip(tmp_path / "model.zip", trust=True)
    assert "\n" not in str(caught.value)


def test_an_object_array_is_refused(model: Any, tmp_path: Path) -> None:
    """numpy can hide a pickle in an array; it is not opened."""
    policy = export_policy(model, {})
    save_policy(policy, tmp_path)
    arrays = {f"W{i}": W for i, W in enumerate(policy.weights)}
    arrays["b0"] = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "weights.npz", **arrays)
    with pytest.raises(PolicyError, match="must hold plain numbers, got object"):
        load_policy(tmp_path)


def test_policies_refuse_what_they_cannot_do(model: Any) -> None:
    policy = export_policy(model, {})
    with pytest.raises(ValueError, match="takes 3 observations"):
        policy.predict(np.zeros(4))
    with pytest.raises(ValueError, match="mean action only"):
        policy.predict(np.zeros(3), deterministic=False)
