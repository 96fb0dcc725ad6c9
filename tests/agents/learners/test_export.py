"""Every algorithm's trained actor, stored without code, acts as the learner itself."""

import base64
import json
import pickle
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers import FrameStackObservation, RescaleAction
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from agents import evaluate
from agents.export import command as export
from agents.learners.algorithms import ON_TENSORS, algorithms
from agents.learners.export import export_policy, load_zip
from agents.learners.wrapped import refuse_wrapped
from agents.policy import Policy, PolicyError, load_policy, save_policy
from flexarm_env import SB3VecEnv
from tests.agents.toys import KWARGS, NETWORK, Toy, build, trained

ROUND_OFF = 5e-6  # float32 sums in another order, over a sequence


def differences(model: Any, policy: Policy, steps: int = 60) -> tuple[float, float]:
    """Largest difference of actions over a batch's sequence with episode starts; largest action."""
    rng = np.random.default_rng(0)
    theirs, ours, starts = None, None, np.ones(3, bool)
    gap = largest = 0.0
    for _ in range(steps):
        observation = rng.uniform(-5.0, 5.0, (3, 3)).astype(np.float32)
        expected, theirs = model.predict(observation, theirs, starts, deterministic=True)
        actions, ours = policy.predict(observation, ours, starts)
        gap = max(gap, float(np.abs(actions - expected).max()))
        largest = max(largest, float(np.abs(actions).max()))
        starts = rng.random(3) < 0.1
    return gap, largest


@pytest.mark.parametrize("name", sorted(KWARGS))
def test_the_stored_actor_of_every_algorithm_acts_as_the_learner(name: str, tmp_path: Path) -> None:
    model = trained(name)
    save_policy(export_policy(model, {}), tmp_path)
    policy = load_policy(tmp_path)
    gap, largest = differences(model, policy)
    assert gap < ROUND_OFF
    assert largest > 0.5
    assert policy.about["algorithm"] == name


def test_every_algorithm_of_the_libraries_is_tested() -> None:
    assert sorted([*KWARGS, *ON_TENSORS, "dagger"]) == list(algorithms())  # test_dagger.py


@pytest.mark.parametrize("name", ["a2c", "crossq", "ppo", "sac", "tqc"])
def test_policies_whose_exploration_depends_on_the_state_are_stored(
    name: str, tmp_path: Path
) -> None:
    """Off-policy algorithms then limit the mean before it is squashed."""
    kwargs = {} if name in ("a2c", "ppo") else {"policy_kwargs": NETWORK | {"clip_mean": 0.5}}
    model = trained(name, use_sde=True, **kwargs)
    save_policy(export_policy(model, {}), tmp_path)
    policy = load_policy(tmp_path)
    gap, largest = differences(model, policy)
    assert gap < ROUND_OFF
    if kwargs:
        assert policy.mean_limit == 0.5
        assert largest == pytest.approx(np.tanh(0.5))


def test_networks_of_other_layers_are_refused() -> None:
    for activation, named in (
        (torch.nn.Sigmoid, "sigmoid"),
        (partial(torch.nn.ELU, alpha=0.3), "elu of alpha 0.3"),
    ):
        model = build("ppo", policy_kwargs={"activation_fn": activation})
        with pytest.raises(PolicyError, match=rf"one activation out of .* got \['{named}'\]"):
            export_policy(model, {})


class Doubled(FlattenExtractor):
    """Twice the observation."""

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return 2.0 * super().forward(observations)


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_a_network_before_the_actor_is_refused(name: str) -> None:
    network = KWARGS[name]["policy_kwargs"] | {"features_extractor_class": Doubled}
    with pytest.raises(PolicyError, match="extractor of features, got Doubled"):
        export_policy(build(name, policy_kwargs=network), {})


def test_wrappers_that_a_stored_policy_lacks_are_refused(tmp_path: Path) -> None:
    for wrapped, sentence in (
        (RescaleAction(Toy(), -2.0, 2.0), r"actions in .* got \[-2, 2\]; train without"),
        (FrameStackObservation(Toy(), 4), r"got shape \(4, 3\); let it see the latest"),
    ):
        with pytest.raises(PolicyError, match=sentence):
            export_policy(build("ppo", env=wrapped), {})
    model = build("ppo", env=VecNormalize(DummyVecEnv([Toy])))
    model.learn(64)
    model.save(tmp_path / "model.zip")
    with pytest.raises(PolicyError, match="VecNormalize, whose statistics it does not hold"):
        export_policy(type(model).load(tmp_path / "model.zip"), {})


class Listed(Toy):
    """Two actions to choose from."""

    action_space = gym.spaces.Discrete(2)


def test_a_choice_of_listed_actions_is_no_policy_of_an_arm(tmp_path: Path) -> None:
    """Its two logits would be taken for the torques of two joints."""
    model = build("ppo", env=Listed())
    model.save(tmp_path / "model.zip")
    with pytest.raises(PolicyError, match=r"actions in .* got Discrete\(2\); train without"):
        load_zip(tmp_path / "model.zip", trust=True)
    with pytest.raises(ValueError, match=r"The model acts in Discrete\(2\), but an arm takes"):
        refuse_wrapped(model)


class Mine:
    """Code that leaves a file behind when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return Path.touch, (self.mark,)


@pytest.mark.parametrize("where", ["data", "statistics"])
def test_a_hostile_zip_runs_nothing_before_it_is_trusted(
    where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pickle in the zip, or beside it; trusted, the very same files run their code."""
    file, mark = tmp_path / "model.zip", tmp_path / "mark"
    build("ppo").save(tmp_path / "own.zip")
    hostile = pickle.dumps(Mine(mark))
    with ZipFile(tmp_path / "own.zip") as own, ZipFile(file, "w") as made:
        for name in own.namelist():
            content = own.read(name)
            if name == "data" and where == "data":
                text = base64.b64encode(hostile).decode()
                entry = {"lr_schedule": {":type:": "function", ":serialized:": text}}
                content = json.dumps(json.loads(content) | entry).encode()
            made.writestr(name, content)
    if where == "statistics":
        (tmp_path / "model").mkdir()
        (tmp_path / "model" / "vecnormalize.pkl").write_bytes(hostile)
    for load in (load_zip, load_policy):
        with pytest.raises(PolicyError):
            load(file)
    assert export.main([str(file), "--format", "c"]) == 2
    assert capsys.readouterr().err.endswith("name the folder of a run or of a policy.\n")
    out = ["--env", "FlexArm/OneLink-Reach-v0", "--out", str(tmp_path / "out")]
    assert evaluate.main([str(file), *out]) == 2
    assert "pass --trust if you trust its author" in capsys.readouterr().err
    assert not mark.exists()
    with suppress(PolicyError):
        load_zip(file, trust=True)
    assert mark.exists()


def test_a_zip_of_goals_is_refused_as_such(tmp_path: Path) -> None:
    envs = SB3VecEnv("FlexArm/OneLink-ReachGoal-v0", 2)
    replay = {"replay_buffer_class": HerReplayBuffer, "buffer_size": 100}
    SAC("MultiInputPolicy", envs, **replay).save(tmp_path / "goals.zip")
    with pytest.raises(PolicyError, match="got one of goals"):
        load_zip(tmp_path / "goals.zip", trust=True)


def test_a_network_with_too_many_layers_is_refused() -> None:
    model = build("ppo", policy_kwargs={"net_arch": [4] * 9})
    with pytest.raises(PolicyError, match="at most 10 layers of at most 2048 units"):
        export_policy(model, {})


def test_memory_and_stacked_observations_go_together(tmp_path: Path) -> None:
    """Across ends of episodes, against stable-baselines3's own stacking."""
    envs = VecFrameStack(DummyVecEnv([Toy, Toy]), 3)
    envs.seed(0)
    model = build("recurrent-ppo", env=envs)
    save_policy(export_policy(model, {"stack": 3}), tmp_path)
    policy = load_policy(tmp_path)
    stacked: Any = envs.reset()
    starts, theirs, ours, ends = np.ones(2, bool), None, None, 0
    for _ in range(60):
        expected, theirs = model.predict(stacked, theirs, starts, deterministic=True)
        actions, ours = policy.predict(stacked[:, -3:], ours, starts)
        np.testing.assert_allclose(actions, expected, atol=ROUND_OFF)
        stacked, _, starts, _ = envs.step(expected)
        ends += int(starts.sum())
    assert ends > 2
    single, memory = policy.predict(stacked[0, -3:])
    assert (single.shape, memory.shape) == ((2,), (policy.n_state,))


@pytest.mark.parametrize("name", sorted(KWARGS))
def test_a_trusted_zip_of_every_algorithm_loads(name: str, tmp_path: Path) -> None:
    model = build(name)
    model.save(tmp_path / "model.zip")
    policy = load_zip(tmp_path / "model.zip", trust=True)
    assert policy.about["algorithm"] == {"ddpg": "td3"}.get(name, name)  # their zips look alike
    assert differences(model, policy)[0] < ROUND_OFF
