"""A policy on a classical controller acts in its stored form as it did in training."""

import json
import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecFrameStack

from agents.config import ConfigError, config_from_dict
from agents.controllers import CONTROLLERS, controller
from agents.controllers.models.reading import Reading
from agents.evaluate import main as evaluate
from agents.hybrid.controller import Hybrid, Residual, acting, base_of, description
from agents.hybrid.environment import HybridVecEnv
from agents.leaderboard.shipped import name_of
from agents.learners.export import export_policy
from agents.metrics import make_batch
from agents.policy import PolicyError, load_policy, save_policy
from agents.run_folder.folder import RunFolder
from agents.training import base_description
from agents.training import main as train
from flexarm_env import SB3VecEnv
from tests.agents.tiny import ENV_ID, one_sentence, write_config
from tests.paths import ROOT

# With this torque episodes fail at different times.
LABORATORY: dict[str, Any] = {
    "hardware": "laboratory",
    "max_episode_steps": 25,
    "torque_limit": 6.0,
}


# One filter alone: where two are level, round-off would decide which is believed.
KNOWN_PLANT: dict[str, Any] = {
    **LABORATORY,
    "hardware": {
        "preset": "laboratory",
        "delay": 1,
        "payload": (0.5, 0.5),
        "stiffness": (0.9, 0.9),
    },
}


def described(name: str, learned: str = "residual", scale: float = 1.0) -> dict[str, Any]:
    parameters = CONTROLLERS[name].middle
    return {"controller": name, "learned": learned, "parameters": parameters, "scale": scale}


class Constant:
    """A policy of one correction."""

    def __init__(self, correction: float) -> None:
        self.correction = correction

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        return np.full((*observation.shape[:-1], 1), self.correction, np.float32), state


def on_lqg(learned: str, envs: Any) -> Hybrid:
    """A constant policy on LQG."""
    return Hybrid(base_of(described("lqg", learned, 0.5), envs), Constant(0.6))


@pytest.mark.parametrize(
    ("name", "learned"),
    [
        ("lqg", "residual"),
        ("lqg", "advised"),
        ("lqg", "alone"),
        ("pd-zv", "residual"),
        ("pd", "reference"),
    ],
)
def test_a_stored_policy_on_a_base_acts_as_in_training(
    name: str, learned: str, tmp_path: Path
) -> None:
    """Over ends of episodes, with stacked observations, in two environments with equal seeds."""
    scale = {"reference": 50.0, "residual": 2.0}.get(learned, 1.0)
    about: dict[str, Any] = {"stack": 2, "base": described(name, learned, scale)}
    short: dict[str, Any] = {**KNOWN_PLANT, "max_episode_steps": 15}
    plain, inner = (SB3VecEnv(ENV_ID, 3, **short) for _ in range(2))
    learner = VecFrameStack(HybridVecEnv(inner, base_of(about["base"], inner.envs)), 2)
    model = PPO("MlpPolicy", learner, n_steps=8, batch_size=8, seed=0)
    model.policy.action_net.weight.data *= 200.0  # corrections that matter
    save_policy(export_policy(model, about), tmp_path)
    subject = acting(load_policy(tmp_path), plain.envs)
    n = plain.observation_space.shape[0]
    learner.seed(5)
    plain.seed(5)
    stacked, observation = learner.reset(), plain.reset()
    state, starts, ends, corrections = None, np.ones(3, bool), 0, []
    for _ in range(100):
        latest = stacked[:, stacked.shape[1] // 2 :][:, :n]
        np.testing.assert_allclose(latest, observation, atol=1e-3)
        correction, _ = model.predict(stacked, deterministic=True)
        action, state = subject.predict(observation, state, starts)
        corrections.append(correction)
        stacked = learner.step(correction)[0]
        observation, _, starts, _ = plain.step(action)
        ends += int(starts.any())
    assert np.std(corrections) > 0.1
    assert ends > 3
    plain.close()
    learner.close()


def test_the_last_observation_of_an_episode_has_the_base_s_action_too() -> None:
    """Joint PD needs no memory, so its action there is known."""
    inner = SB3VecEnv(ENV_ID, 2, **LABORATORY)
    base = base_of(described("pd"), inner.envs)
    learner = HybridVecEnv(inner, base)
    learner.reset()
    ended = []
    for _ in range(25):
        _, _, dones, infos = learner.step(np.zeros((2, 1), np.float32))
        ended += [infos[i]["terminal_observation"] for i in np.flatnonzero(dones)]
    assert ended
    for last in ended:
        assert last.shape == learner.observation_space.shape
        seen, _ = base.begin(last[:-1], None, None)
        np.testing.assert_array_equal(seen, last)
    learner.close()


@pytest.mark.parametrize("name", ["lqg", "lqg-planned", "mpc-kalman", "pd-zvd", "irc"])
def test_the_last_observation_of_an_episode_goes_on_from_its_memory(name: str) -> None:
    """As if the base had gone on with all environments, also those that have not ended."""
    plain, inner = (SB3VecEnv(ENV_ID, 3, **KNOWN_PLANT) for _ in range(2))
    own, base = (base_of(described(name, scale=2.0), envs.envs) for envs in (inner, plain))
    learner = HybridVecEnv(inner, own)
    for envs in (plain, learner):
        envs.seed(5)
    learner.reset()
    observation, state, start, apart = plain.reset(), None, np.ones(3, bool), 0
    learned = np.array([[1.0], [0.0], [-0.7]], np.float32)  # the arm breaks at different times
    for _ in range(60):
        action, state = base.complete(base.begin(observation, state, start)[1], learned)
        observation, _, start, infos = plain.step(action)
        seen = learner.step(learned)[3]
        apart += start.any() and not start.all()
        last = np.array(observation)
        for i in np.flatnonzero(start):
            last[i] = infos[i]["terminal_observation"]
        whole, _ = base.begin(last, deepcopy(state), None)
        for i in np.flatnonzero(start):
            np.testing.assert_allclose(seen[i]["terminal_observation"], whole[i], atol=1e-5)
    assert apart > 3
    for envs in (plain, learner):
        envs.close()


def test_without_corrections_the_base_acts_alone() -> None:
    envs = make_batch(ENV_ID, 2, LABORATORY)
    alone = controller("lqg", envs, CONTROLLERS["lqg"].middle)
    silent = Hybrid(base_of(described("lqg", scale=0.0), envs), Constant(1.0))
    observation, _ = envs.reset(seed=0)
    states: list[Any] = [None, None]
    for _ in range(10):
        own, states[0] = alone.predict(observation, states[0])
        action, states[1] = silent.predict(observation, states[1])
        np.testing.assert_allclose(action, own, atol=1e-7)
        observation = envs.step(action)[0]
    envs.close()


def test_a_policy_alone_sees_the_estimates_and_acts_without_the_base() -> None:
    """It sees what a residual sees but the base's actions; the filters are told of its own."""
    envs = make_batch(ENV_ID, 2, LABORATORY)
    alone, residual = (on_lqg(kind, envs) for kind in ("alone", "residual"))
    observation, _ = envs.reset(seed=0)
    both, states, start = (alone, residual), [None, None], np.ones(2, bool)
    for _ in range(4):
        seen = [
            x.base.begin(observation, deepcopy(y), start)[0]
            for x, y in zip(both, states, strict=True)
        ]
        own = observation.shape[1]
        np.testing.assert_array_equal(seen[0], np.delete(seen[1], own, axis=1))
        action, (belief, _) = alone.predict(observation, (states[0], None), start)
        np.testing.assert_allclose(action, 0.3)
        torque = belief.torque[:, -1] + belief.forward
        np.testing.assert_allclose(torque, 0.3 * LABORATORY["torque_limit"], rtol=1e-6)
        _, states[1] = residual.base.controller.predict(observation, states[1], start)
        states = [belief, residual.base.controller.told(states[1], action)]
        observation, start = envs.step(action)[0], np.zeros(2, bool)
    envs.close()


def test_an_experiment_may_fix_the_parameters_of_its_base() -> None:
    own = {"frequency_ratio": 0.2, "damping_ratio": 0.7}
    env = {"hardware": {"delay": 1}}  # where nothing was tuned
    given = description("pd", "residual", 0.2, ENV_ID, env, own)
    assert given["parameters"] == own
    data = {"env": {"id": ENV_ID}, "agent": {"name": "ppo"}, "total_steps": 1}
    config = config_from_dict(data | {"base": {"controller": "pd", "parameters": own}})
    assert config.base is not None
    assert base_description(config.base, config.env)["parameters"] == own


@pytest.mark.parametrize("yielding", [-1.115, 0.0])
def test_a_base_takes_parameters_of_any_sign_where_their_range_has_both(yielding: float) -> None:
    inner = SB3VecEnv(ENV_ID, 1, **LABORATORY)
    own = CONTROLLERS["strain"].middle | {"yielding": yielding}
    about = description("strain", "residual", 0.2, ENV_ID, LABORATORY, own)
    assert isinstance(base_of(about, inner.envs), Residual)
    inner.close()


def test_an_advised_policy_sees_what_a_residual_one_sees() -> None:
    """Its actions are taken in place of the base's, and the filters are told."""
    envs = make_batch(ENV_ID, 2, LABORATORY)
    advised, residual = (on_lqg(kind, envs) for kind in ("advised", "residual"))
    observation, _ = envs.reset(seed=0)
    seen = [hybrid.base.begin(observation, None, None)[0] for hybrid in (advised, residual)]
    np.testing.assert_array_equal(*seen)
    action, (belief, _) = advised.predict(observation)
    np.testing.assert_allclose(action, 0.3)
    torque = belief.torque[:, -1] + belief.forward
    np.testing.assert_allclose(torque, 0.3 * LABORATORY["torque_limit"], rtol=1e-6)
    envs.close()


def test_a_policy_alone_needs_a_base_with_estimates() -> None:
    envs = make_batch(ENV_ID, 1, LABORATORY)
    with pytest.raises(ValueError, match=r"base\.learned: alone .* such as lqg"):
        base_of(described("pd", "alone", 0.5), envs)
    envs.close()


def test_lqg_knows_the_actions_that_were_taken() -> None:
    """Its innovations stay small under a correction; untold, it takes it for a disturbance."""
    envs = make_batch(ENV_ID, 4, {"obs": "sensors"})
    surprises = []
    for told in (True, False):
        base = base_of(described("lqg", scale=0.2), envs)
        assert isinstance(base, Residual)
        lqg: Any = base.controller
        subject = Hybrid(base, Constant(1.0))
        observation, _ = envs.reset(seed=0)
        state: Any = None
        for _ in range(20):
            action, state = subject.predict(observation, state)
            if not told:
                lqg.told(state[0], action - np.float32(0.2))
            observation = envs.step(action)[0]
        surprises.append(state[0].surprise.sum())
    assert surprises[0] < 0.1 * surprises[1]
    envs.close()


def test_a_controller_goes_to_the_reference_instead_of_the_target() -> None:
    envs = make_batch(ENV_ID, 2, {"max_episode_steps": 300})
    base = base_of(description("pd", "reference", 0.2, ENV_ID, {}), envs)
    subject = Hybrid(base, Constant(-0.5))
    observation, _ = envs.reset(seed=0)
    state: Any = None
    for _ in range(200):
        action, state = subject.predict(observation, state)
        observation, _, terminated, truncated, _ = envs.step(action)
        assert not (terminated | truncated).any()
    error = Reading.of(envs)(observation, "joint_error")
    np.testing.assert_allclose(error, -0.1, atol=5e-3)
    envs.close()


def experiment(**base: Any) -> dict[str, Any]:
    return {
        "env": {"id": ENV_ID, "kwargs": {"hardware": "laboratory"}},
        "agent": {"name": "ppo"},
        "base": base,
        "total_steps": 1000,
    }


@pytest.mark.parametrize(
    ("base", "sentence"),
    [
        ({"scale": 0.3}, r"base\.controller is missing"),
        (
            {"controller": "lqg", "scale": 3.0},
            r"base\.scale must be between 0\.0 and 2\.0, got 3\.0",
        ),
        ({"controller": "lqg", "scal": 0.3}, r"unknown key 'base\.scal'\. Did you mean 'scale'"),
        ({"controller": 3}, r"base\.controller must be text, got 3"),
    ],
)
def test_a_wrong_base_of_an_experiment_is_refused(base: Any, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        config_from_dict(experiment(**base))


@pytest.mark.parametrize(
    ("base", "env", "sentence"),
    [
        ({"controller": "lqq"}, {}, "base.controller must be one of"),
        ({"controller": "pd", "learned": "gains"}, {}, "base.learned must be one of"),
        (
            {"controller": "lqr"},
            {"hardware": "laboratory"},
            "base.controller: lqr was not tuned for",
        ),
        ({"controller": "pd"}, {"max_episode_steps": 9}, "base.controller: pd was not tuned for"),
        (
            {"controller": "lqg", "learned": "reference"},
            {"hardware": "laboratory"},
            "base.learned: reference moves the readings",
        ),
        (
            {"controller": "pd", "parameters": {"frequency_ratio": 0.2}},
            {},
            "base.parameters lacks damping_ratio; give all of",
        ),
    ],
)
def test_a_base_that_cannot_act_is_refused_before_the_run(
    base: Any, env: Any, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, "ppo", 256, kwargs=env)
    given = yaml.safe_load(config.read_text()) | {"base": base}
    config.write_text(yaml.safe_dump(given))
    assert train(["--config", str(config), "--out", str(tmp_path / "out")]) == 2
    assert sentence in one_sentence(capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"controller": "os.system"}, "base.controller must be one of"),
        ({"scale": "large"}, "base.scale [-] must be a number"),
        ({"scale": -1.0}, "base.scale must not be negative"),
        ({"parameters": {}}, "base.parameters lacks frequency_ratio, damping_ratio"),
        ({"parameters": {"code": 1.0}}, "Unknown key 'code' in base.parameters"),
        ({"controller": "zero"}, "in base.parameters; it takes none."),
        ({"learned": None}, "base.learned must be one of"),
        ({"code": 1.0}, "Unknown key 'code' in base"),
        ({"controller": "lqr", "parameters": CONTROLLERS["lqr"].middle}, "needs obs='state'"),
    ],
)
def test_a_stranger_s_base_is_refused(changes: dict[str, Any], sentence: str) -> None:
    inner = SB3VecEnv(ENV_ID, 1, **LABORATORY)
    model = PPO(
        "MlpPolicy",
        HybridVecEnv(inner, base_of(described("pd"), inner.envs)),
        n_steps=8,
        batch_size=8,
    )
    policy = export_policy(model, {"base": described("pd") | changes})
    with pytest.raises(PolicyError, match="The policy's base cannot act here") as caught:
        acting(policy, inner.envs)
    assert sentence in str(caught.value)
    inner.close()


def test_a_run_on_a_base_is_trained_resumed_and_evaluated_without_torch(
    tmp_path: Path, unjudged: list[RunFolder]
) -> None:
    config = write_config(tmp_path, "ppo", 256, kwargs={"hardware": "laboratory"}, stack=2)
    given = yaml.safe_load(config.read_text()) | {"base": {"controller": "lqg", "scale": 0.2}}
    config.write_text(yaml.safe_dump(given))
    run = RunFolder(tmp_path / "out")
    assert train(["--config", str(config), "--out", str(run.path)]) == 0
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    tuned = description("lqg", "residual", 0.2, ENV_ID, {"hardware": "laboratory"})
    assert load_policy(run.policy).about["base"] == tuned
    policy = load_policy(run.policy)
    assert name_of(policy) == "ppo-on-lqg-stacked"
    for learned, name in (("alone", "watching"), ("advised", "advised-by")):
        policy.about["base"]["learned"] = learned
        assert name_of(policy) == f"ppo-{name}-lqg-stacked"
    code = (
        "import sys; from agents.evaluate import main; "
        f"main([{str(run.path)!r}, '--episodes', '2', '--out', {str(tmp_path / 'seen')!r}]); "
        "assert not {'torch', 'stable_baselines3'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True)
    found = json.loads((tmp_path / "seen" / "evaluation.json").read_text())
    assert found["env_kwargs"] == {"hardware": "laboratory"}
    assert evaluate([str(run.path), "--env", ENV_ID, "--out", str(tmp_path / "other")]) == 2
