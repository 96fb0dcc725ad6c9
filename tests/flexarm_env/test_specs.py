"""Specifications that `gymnasium.make` and `make_vec` store."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

import flexarm_env
from dynamics import ARMS, Mode
from flexarm_env.hardware.sensors import Hardware

ID = "FlexArm/OneLink-Reach-v0"
SLIM = ARMS["slim"]
MODE = Mode(kind="clamped-free", index=1, direction="y")
OTHER = replace(SLIM, links=(replace(SLIM.links[0], EIz=9.0, modes=(MODE,)),))
KEYWORDS: dict[str, dict[str, Any]] = {
    "arrays": {
        "torque_limit": np.array([1.0]),
        "randomize": {"payload_mass": np.array([0.0, 0.1]), "stiffness": (1, 2)},
        "reward": {"tracking": np.float32(0.5), "effort": Fraction(1, 2)},
    },
    "scalars": {
        "torque_limit": np.float32(1.5), "deflection_limit": np.float64(0.2),
        "substeps": np.int64(3), "control_dt": np.float64(0.01), "integrator": np.str_("rk4"),
    },
    "tuple": {"torque_limit": (1.0,)},
    "arm": {"arm": OTHER},
    "arm by rule": {"arm": replace(SLIM, links=(replace(SLIM.links[0], modes="auto"),))},
    "dict of an arm": {"arm": {"links": [{"length": np.float64(0.8), "rho_A": np.float32(0.5)}]}},
    "hardware": {"hardware": Hardware(encoder_counts=4096, payload=(0.0, 0.5), delay=(0, 2))},
    "dict of hardware": {
        "hardware": {
            "encoder_counts": np.int64(4096), "payload": np.array([0.0, 0.5]),
            "delay": (np.int64(0), 2),
        },
    },
    "actuator": {"actuator": [{"type": "limited", "torque_limit": np.float32(1.0)}]},
}  # fmt: skip


def motion(env: Any, seed: int = 0, steps: int = 15) -> np.ndarray:
    """Observations and rewards under random torques."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    rows = [np.ravel(observation)]
    for _ in range(steps):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        observation, reward, *_ = env.step(action)
        rows += [np.ravel(observation), np.ravel(reward)]
    return np.concatenate(rows)


@pytest.mark.parametrize("keywords", KEYWORDS.values(), ids=KEYWORDS)
def test_a_spec_of_any_keywords_goes_through_json_and_makes_the_same_environment(
    keywords: dict[str, Any],
) -> None:
    """For one environment and for a batch, which also stores its own keywords."""
    env = gym.make(ID, **keywords)
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec == env.spec
    np.testing.assert_array_equal(motion(again), motion(env))
    mode = AutoresetMode.SAME_STEP
    envs: Any = gym.make_vec(ID, np.int64(2), autoreset_mode=mode, **keywords)
    twin: Any = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    assert twin.spec == envs.spec
    assert (twin.num_envs, twin.autoreset_mode) == (2, mode)
    np.testing.assert_array_equal(motion(twin), motion(envs))


def test_a_path_is_stored_as_text(tmp_path: Path) -> None:
    path = tmp_path / "arm.json"
    path.write_text(json.dumps(SLIM.to_dict()))
    env = gym.make(ID, arm=path)
    assert env.spec is not None
    assert json.loads(env.spec.to_json())["kwargs"]["arm"] == str(path)
    assert gym.make(env.spec).unwrapped.arm == SLIM  # type: ignore[attr-defined]


def test_weights_of_a_wrapper_go_through_json() -> None:
    weights = {"precision": np.float32(0.3)}
    env = flexarm_env.TipTrackingReward(gym.make(ID), weights)
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(motion(again), motion(env))


def test_what_cannot_be_json_is_named() -> None:
    """A keyword of a subclass may be a function; the environment works with it."""

    class Mine(flexarm_env.FlexArmEnv):
        def __init__(self, *, law: Any, **arguments: Any) -> None:
            super().__init__(**arguments)
            self.law = law

    keywords: dict[str, Any] = {"task": "Reach", "arm": "slim", "law": abs}
    gym.register("Mine/Law-v0", Mine, kwargs=keywords)
    try:
        env = gym.make("Mine/Law-v0")
        assert env.spec is not None
        assert env.spec.kwargs["law"] is abs
        with pytest.raises(TypeError, match=r"function_or_method is not JSON serializable"):
            replace(env.spec, entry_point=None).to_json()
    finally:
        del gym.registry["Mine/Law-v0"]
