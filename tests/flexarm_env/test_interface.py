"""Environments meet the interfaces of Gymnasium and stable-baselines3."""

import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numba
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env as gym_check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import flexarm_env
from dynamics import ARMS

FLYING = {
    "links": [{"length": 1.0, "rho_A": 1.0}],
    "base": {"type": "free", "mass": 2.0, "inertia": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]},
}
ALL_IDS = [i for i in flexarm_env.IDS if "Goal" not in i]  # test_goals.py has the others
ONE = "FlexArm/OneLink-Reach-v0"
ONE_PER_TASK = [env_id for env_id in ALL_IDS if "OneLink" in env_id]


def rollout(env: Any, steps: int, seed: int = 0) -> np.ndarray:
    """(steps, n_obs + 1) observations and rewards under random small actions."""
    rng = np.random.default_rng(seed)
    rows = []
    env.reset(seed=seed)
    for _ in range(steps):
        obs, reward, *_ = env.step(rng.uniform(-0.2, 0.2, env.action_space.shape))
        rows.append(np.append(obs, reward))
    return np.array(rows)


@pytest.mark.parametrize("obs", ["state", "sensors"])
@pytest.mark.parametrize("env_id", ALL_IDS)
def test_both_checkers_pass_without_a_warning(env_id: str, obs: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym_check_env(gym.make(env_id, obs=obs).unwrapped)
        sb3_check_env(gym.make(env_id, obs=obs), warn=True)


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_spec_round_trip_makes_the_same_environment(env_id: str) -> None:
    env = gym.make(env_id, obs="sensors", reward={"tracking": 1.0}, torque_limit=0.5)
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec == env.spec
    np.testing.assert_array_equal(rollout(again, 20), rollout(env, 20))


def test_wrapped_specs_round_trip() -> None:
    env = flexarm_env.TipTrackingReward(gym.make("FlexArm/OneLink-Reach-v0"), {"precision": 2.0})
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(rollout(again, 20), rollout(env, 20))


def test_the_prefixed_id_registers_by_itself() -> None:
    code = (
        "import gymnasium as gym; "
        "gym.make('flexarm_env:FlexArm/OneLink-Reach-v0').reset(seed=0); "
        "import flexarm_env, importlib; importlib.reload(flexarm_env); "
        "print(sum(name.startswith('FlexArm/') for name in gym.registry))"
    )
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == [str(len(flexarm_env.IDS))]


@pytest.mark.parametrize("env_id", ONE_PER_TASK)
def test_equal_seeds_give_equal_trajectories(env_id: str) -> None:
    first, second = (rollout(gym.make(env_id), 200, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, rollout(gym.make(env_id), 200, seed=4))


@pytest.mark.parametrize("env_id", ONE_PER_TASK)
def test_a_pickled_environment_continues_where_it_was(env_id: str) -> None:
    env = gym.make(env_id)
    rollout(env, 10)
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(10):
        action = np.array([0.1])
        obs, reward, *_ = env.step(action)
        obs_2, reward_2, *_ = copy.step(action)
        np.testing.assert_array_equal(obs_2, obs)
        assert reward_2 == reward
    np.testing.assert_array_equal(copy.reset()[0], env.reset()[0])  # the random stream, too


def test_an_assigned_generator_draws_the_next_episode() -> None:
    """After a seeded one, as the generator of `reset(seed=...)` does."""
    env, seeded = (gym.make("FlexArm/OneLink-Reach-v0") for _ in range(2))
    env.reset(seed=0)
    env.np_random = np.random.default_rng(1)
    assert env.np_random_seed == -1
    expected, _ = seeded.reset(seed=1)
    np.testing.assert_array_equal(env.reset()[0], expected)
    assert not np.array_equal(env.reset()[0], expected)
    env.np_random = np.random.default_rng(1)
    np.testing.assert_array_equal(env.reset()[0], expected)
    with pytest.raises(ValueError, match="np_random must be a Generator, got 3"):
        env.np_random = 3  # type: ignore[assignment]


def test_an_assigned_generator_draws_the_next_episodes_of_a_batch() -> None:
    """At a reset and where they begin by themselves; each environment has its own."""
    made = [gym.make_vec("FlexArm/OneLink-Reach-v0", 3, max_episode_steps=2) for _ in range(3)]
    starts: list[Any] = []
    for envs, seed in zip(made, (1, 1, 2), strict=True):
        envs.reset(seed=0)
        envs.np_random = np.random.default_rng(seed)
        rest = np.zeros(envs.action_space.shape)
        restarted = [envs.step(rest)[0].copy() for _ in range(3)][-1]
        starts.append((restarted, envs.reset()[0].copy()))
    for same, other in zip(starts[0], starts[1], strict=True):
        np.testing.assert_array_equal(same, other)
        assert len(np.unique(same, axis=0)) == 3
    for one, other in zip(starts[0], starts[2], strict=True):
        assert (one != other).any(axis=1).all()


def test_time_limit_truncates_and_nothing_else() -> None:
    env = gym.make("FlexArm/OneLink-Reach-v0", max_episode_steps=7)
    env.reset(seed=0)
    ends = [env.step(np.zeros(1))[2:4] for _ in range(7)]
    assert ends == [(False, False)] * 6 + [(False, True)]


def test_reset_options_place_the_arm_and_the_target() -> None:
    env = gym.make("FlexArm/OneLink-Reach-v0")
    state = {"q": [0.2, 0.01, 0.001], "v": [0.1, 0.0, 0.0]}
    obs, info = env.reset(seed=0, options={"state": state, "target": [0.5]})
    base: Any = env.unwrapped
    angles, rates = base.joint_state()
    assert (angles[0], rates[0], base.joint_target()[0]) == (0.2, 0.1, 0.5)
    scaled = obs[base.observation_slices["joint_error"]] * base.observation_scales["joint_error"]
    np.testing.assert_allclose(scaled, [-0.3], rtol=1e-6)  # float32
    assert info["tip_deflection"] == pytest.approx(0.011, rel=1e-3)
    reach = base.reach
    tip = base.model.tip(np.array(state["q"]))[:2]
    goal = reach * np.array([np.cos(0.5), np.sin(0.5)])
    assert info["tip_error"] == pytest.approx(np.linalg.norm(tip - goal), rel=1e-12)


def test_any_arm_can_be_given(tmp_path: Any) -> None:
    import json

    description = ARMS["slim"].to_dict()
    path = tmp_path / "arm.json"
    path.write_text(json.dumps(description))
    runs = [
        rollout(gym.make("FlexArm/OneLink-Reach-v0", arm=arm), 10)
        for arm in ("slim", ARMS["slim"], description, str(path))
    ]
    for run in runs[1:]:
        np.testing.assert_array_equal(run, runs[0])


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"obs": "pixels"}, r"obs must be one of .* got 'pixels'"),
        ({"reward": "fame"}, r"Unknown reward 'fame'\. Known: "),
        ({"reward": {"fame": 1.0}}, r"Unknown reward terms \['fame'\]\. Known: "),
        ({"reward": {"tracking": "1"}}, r"weight of 'tracking' must be a number, got the text '1'"),
        (
            {"reward": {"tracking": float("nan")}},
            r"weight of 'tracking' must be a finite number, got nan",
        ),
        ({"reward": {}}, r"At least one weight"),
        ({"control_dt": 0.0}, r"control_dt must be between 1e-06 and 10, got 0\.0"),
        ({"integrator": "leapfrog"}, r"Unknown integrator 'leapfrog'"),
        ({"substeps": 0}, r"substeps must be between 1 and 1000000, got 0"),
        ({"torque_limit": -1.0}, r"torque_limit must be positive, got -1\.0"),
        ({"torque_limit": [1.0, 2.0]}, r"torque_limit must be one number, or a list of 1"),
        ({"torque_limit": "much"}, r"torque_limit must be one number, .* got 'much'"),
        ({"threads": 2}, r"threads is for a batch; .*make_vec\(id, num_envs=N, threads=2\)"),
        ({"deflection_limit": -0.1}, r"deflection_limit must be between 1e-06 and 1, got -0\.1"),
        ({"render_mode": "ascii"}, r"render_mode must be one of"),
        ({"arm": "slimmer"}, r"Unknown arm 'slimmer'"),
        ({"arm": FLYING}, r"Base\.type must be 'fixed' or 'planar' for an environment, got 'free'"),
        ({"task": "Juggle"}, r"Unknown task 'Juggle'"),
        ({"n_env": 2}, r"n_env is for a batch"),
        ({"num_envs": 8}, r"num_envs is for a batch; .*make_vec\(id, num_envs=8\)"),
        ({"n_envs": 8}, r"n_envs is for a batch; .*make_vec\(id, num_envs=8\)"),
        ({"autoreset_mode": "Disabled"}, r"make_vec\(id, num_envs=N, autoreset_mode='Disabled'\)"),
        ({"max_episode_steps": 9}, r"use gymnasium\.make\(id, max_episode_steps=9\)"),
        ({"hardwre": "ideal"}, r"argument 'hardwre'; nearest known: 'hardware'"),
        ({"randomize": {"viscous_2": (0.0, 0.1)}}, r"viscous_2 is of no joint: this arm has 1"),
        ({"randomize": {"stiffness": (0.0, 0.0)}}, r"stiffness.* must be above 0 .* got \(0\.0, 0"),
        ({"hardware": {"stiffness": (0.0, 0.0)}}, r"stiffness.* must be above 0 .* got \(0\.0, 0"),
        ({"rendermode": "human"}, r"argument 'rendermode'; nearest known: 'render_mode'"),
    ],
)
def test_bad_keywords_get_a_sentence(keywords: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        flexarm_env.FlexArmEnv(**({"task": "Reach", "arm": "slim"} | keywords))


def test_misspelt_keywords_of_ids_are_answered_with_the_nearest() -> None:
    """For one environment, for a batch and for that of stable-baselines3."""
    one = "FlexArm/OneLink-Reach-v0"
    makers: list[Any] = [gym.make, partial(gym.make_vec, num_envs=2)]
    makers.append(partial(flexarm_env.SB3VecEnv, n_envs=2))
    for make in makers:
        with pytest.raises(ValueError, match=r"'hardwre'; nearest known: 'hardware'"):
            make(one, hardwre="laboratory")
        with pytest.raises(TypeError, match="got an unexpected keyword argument 'frameskip'"):
            make(one, frameskip=1)  # as TorchRL tries it
    for make, given, near in (
        (makers[1], "max_steps", "max_episode_steps"),
        (makers[1], "n_env", "num_envs"),
        (makers[1], "autoreset", "autoreset_mode"),
        (makers[2], "thread", "threads"),
    ):
        with pytest.raises(ValueError, match=f"'{given}'; nearest known: '{near}'"):
            make(one, **{given: 2})
    for name, value in (("autoreset_mode", "Disabled"), ("vectorization_mode", "sync")):
        with pytest.raises(ValueError, match=f"{name} of SB3VecEnv is always .*, got '{value}'"):
            makers[2](one, **{name: value})


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"start": 1}, r"Unknown reset options \['start'\]"),
        ({"state": [0.0]}, r"must be a dict of 'q' and 'v'"),
        ({"state": {"q": [0.0]}}, r"\['q'\] must have shape \(3,\), got \(1,\)"),
        ({"state": {"q": [0.0, 0.0, float("nan")]}}, r"finite numbers"),
        ({"target": "there"}, r"options\['target'\] must hold numbers, got 'there'"),
    ],
)
def test_bad_options_get_a_sentence(options: dict[str, Any], sentence: str) -> None:
    env = flexarm_env.FlexArmEnv(task="Reach", arm="slim")
    with pytest.raises(ValueError, match=sentence):
        env.reset(options=options)


@pytest.mark.parametrize(
    ("family", "action"),
    [("OneLink", bad) for bad in ([np.nan], [0.1, 0.2], "left", None)]
    + [("TwoLink", bad) for bad in (0.1, [0.1], [[0.1, 0.2]], [[0.1], [0.2]], [0.1, np.nan])],
)
def test_bad_actions_get_a_sentence_and_change_nothing(family: str, action: Any) -> None:
    env, reference = (gym.make(f"FlexArm/{family}-Reach-v0").unwrapped for _ in range(2))
    for each in (env, reference):
        each.reset(seed=0)
    with pytest.raises(ValueError, match="ction"):
        env.step(action)
    good = np.ones(env.action_space.shape)
    np.testing.assert_array_equal(env.step(good)[0], reference.step(good)[0])


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_without_numbas_compiler_an_environment_is_refused_when_it_is_made(
    make: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    with pytest.raises(ValueError, match="unset the environment variable NUMBA_DISABLE_JIT"):
        make("FlexArm/OneLink-Reach-v0")


def test_a_step_before_the_first_reset_is_refused() -> None:
    """In every form of an environment that has no episode yet; a refused reset begins none."""
    import torch

    actions = np.zeros((2, 1), np.float32)
    own = flexarm_env.FlexArmEnv(**gym.spec(ONE).kwargs)
    sb3, tensors = flexarm_env.SB3VecEnv(ONE, 2), flexarm_env.TorchVecEnv(ONE, 2)
    single, batch = gym.make(ONE), gym.make_vec(ONE, num_envs=2)
    for env, step in (
        (own, lambda: own.step(actions[0])),
        (single, lambda: single.step(actions[0])),
        (batch, lambda: batch.step(actions)),
        (sb3, lambda: sb3.step(actions)),
        (tensors, lambda: tensors.step(torch.from_numpy(actions))),
    ):
        with pytest.raises(gym.error.ResetNeeded):
            step()
        env.reset()
        step()
    unused = flexarm_env.SB3VecEnv(ONE, 2)
    unused.set_options([{}, {"state": {"q": np.full(own.core.arm.n, 9.0)}}])
    with pytest.raises(ValueError, match=r"options\['state'\]"):
        unused.reset()
    with pytest.raises(gym.error.ResetNeeded):
        unused.step(actions)
    for unused in (flexarm_env.FlexArmEnv(**gym.spec(ONE).kwargs), gym.make_vec(ONE, num_envs=2)):
        for options in ({"state": {"q": [9.0]}}, {"state": {"q": np.full(own.core.arm.n, 9.0)}}):
            with pytest.raises(ValueError, match=r"options\['state'\]"):
                unused.reset(options=options)
            with pytest.raises(gym.error.ResetNeeded):
                unused.step(actions[: unused.core.n_env])
