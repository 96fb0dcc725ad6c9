"""Specifications that `gymnasium.make` and `make_vec` store, and the limit of steps."""

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
OWN = flexarm_env.IDS[ID]["max_episode_steps"]
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


# ---- the limit of steps --------------------------------------------------------------------------


def length(envs: Any, most: int) -> int:
    """Steps of the first episode, at rest; 0 if it goes on for more than `most`."""
    envs.reset()
    rest = np.zeros(envs.action_space.shape, np.float32)
    shape = (envs.num_envs, *rest.shape[-1:])
    for k in range(1, most + 1):
        ends = envs.step(rest if rest.ndim > 1 else np.zeros(shape, np.float32))
        if np.any(ends[2] if len(ends) == 4 else ends[3]):
            return k
    return 0


@pytest.mark.parametrize(
    ("keywords", "steps"),
    [({}, OWN), ({"max_episode_steps": None}, OWN), ({"max_episode_steps": -1}, 0),
     ({"max_episode_steps": 9}, 9), ({"max_episode_steps": np.int64(9)}, 9)],
)  # fmt: skip
def test_a_batch_limits_steps_as_gymnasium_make_does(keywords: dict[str, Any], steps: int) -> None:
    """None is the id's own limit and -1 none; the spec says what happens."""
    limit = keywords.get("max_episode_steps")
    one = gym.make(ID, max_episode_steps=None if limit is None else int(limit))
    envs: Any = gym.make_vec(ID, num_envs=2, **keywords)
    twin: Any = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    assert one.spec is not None
    assert one.spec.max_episode_steps == (steps or None)
    for each in (envs, twin, flexarm_env.SB3VecEnv(ID, 2, **keywords).envs):
        assert each.spec.max_episode_steps == (steps or None)
        assert each.max_episode_steps == (steps or -1)
        assert length(each, OWN + 1) == steps
    assert length(flexarm_env.SB3VecEnv(ID, 2, **keywords), OWN + 1) == steps


@pytest.mark.parametrize("limit", [0, -2, True, 2.5, "9", 10**9])
def test_other_limits_of_steps_are_refused_with_both_remedies(limit: Any) -> None:
    makers: list[Any] = [gym.make_vec, flexarm_env.SB3VecEnv]
    for make in makers:
        with pytest.raises(
            ValueError, match=r"^max_episode_steps must be .*-1 stands for no limit, and None for"
        ):
            make(ID, num_envs=2, max_episode_steps=limit)


def test_without_an_id_none_is_no_limit() -> None:
    for limit in (None, -1):
        envs = flexarm_env.FlexArmVectorEnv(
            2, task="Reach", arm="slim", control_dt=0.02, max_episode_steps=limit
        )
        assert (envs.max_episode_steps, length(envs, OWN + 1)) == (-1, 0)


def test_the_limit_of_ones_own_id_holds_and_comes_back() -> None:
    """Also after a change to another and back to None."""
    gym.register(
        "Mine/Short-v0", vector_entry_point=flexarm_env.FlexArmVectorEnv, max_episode_steps=4,
        kwargs={"task": "Reach", "arm": "slim"},
    )  # fmt: skip
    try:
        envs: Any = gym.make_vec("Mine/Short-v0", num_envs=2, max_episode_steps=None)
    finally:
        del gym.registry["Mine/Short-v0"]
    for limit, steps in ((None, 4), (6, 6), (-1, 0), (None, 4)):
        envs.set_attr("max_episode_steps", limit)
        assert length(envs, 20) == steps


@pytest.mark.parametrize("batch", [flexarm_env.SB3VecEnv, flexarm_env.TorchVecEnv])
def test_an_id_of_single_environments_alone_says_how_to_register_a_batch(batch: Any) -> None:
    kwargs = {"task": "Reach", "arm": "slim"}
    gym.register("Mine/Single-v0", entry_point=flexarm_env.FlexArmEnv, kwargs=kwargs)
    try:
        for given in ("Mine/Single-v0", gym.spec("Mine/Single-v0")):
            with pytest.raises(
                ValueError, match=r"'Mine/Single-v0' .* vector_entry_point='flexarm"
            ):
                batch(given, 2)
    finally:
        del gym.registry["Mine/Single-v0"]


def test_an_environment_without_a_task_or_an_arm_says_what_is_missing() -> None:
    for kwargs, name in (({"arm": "slim"}, "task"), ({"task": "Reach"}, "arm")):
        with pytest.raises(ValueError, match=f"{name} is missing; make a registered id, or give"):
            flexarm_env.FlexArmEnv(**kwargs)
        with pytest.raises(ValueError, match=f"{name} is missing"):
            flexarm_env.FlexArmVectorEnv(num_envs=2, **kwargs)
