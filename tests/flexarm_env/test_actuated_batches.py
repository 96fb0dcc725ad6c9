"""Batches with actuators give the results of single environments."""

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from dynamics.runtime import thread_pool

ENV = "FlexArm/OneLink-Reach-v0"
FLEXIBLE: dict[str, Any] = {
    "actuator": {  # four states
        "type": "hydraulic", "natural_frequency": 60.0, "damping": 0.7, "velocity_gain": 0.02,
        "voltage_limit": 10.0, "stiffness": 1000.0, "lever_arm": 0.1, "rate_limit": 20.0,
    }
}  # fmt: skip


def run(envs: Any, actions: np.ndarray) -> list[tuple[Any, ...]]:
    observation, info = envs.reset(seed=0)
    return [(observation, info), *(envs.step(action[: envs.num_envs]) for action in actions)]


def random_actions(steps: int, n_env: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.5, 0.5, (steps, n_env, 1)).astype(np.float32)


def test_a_batch_with_actuators_equals_single_environments() -> None:
    """Over restarts of some environments; actuator states restart with them."""
    batch = gym.make_vec(ENV, num_envs=3, max_episode_steps=9, **FLEXIBLE)
    singles = gym.make_vec(
        ENV, num_envs=3, vectorization_mode="sync", max_episode_steps=9, **FLEXIBLE
    )
    actions = random_actions(30, 3)
    for ours, theirs in zip(run(batch, actions), run(singles, actions), strict=True):
        np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-6, atol=1e-6)
        for name in ("torque", "command", "tip_error"):
            np.testing.assert_allclose(ours[-1][name], theirs[-1][name], rtol=1e-8, atol=1e-9)


def test_with_actuators_neither_batch_size_nor_threads_nor_pickling_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bit for bit, over restarts."""
    monkeypatch.setattr(thread_pool, "LEAST_WORK", 1e-9)
    actions = random_actions(40, 40)
    envs = [
        gym.make_vec(ENV, num_envs=n, threads=threads, max_episode_steps=11, **FLEXIBLE)
        for n, threads in ((5, 1), (40, 1), (40, 2))
    ]
    runs = [run(batch, actions) for batch in envs]
    for steps in zip(*runs, strict=True):
        for other in steps[1:]:
            np.testing.assert_array_equal(steps[0][0], other[0][:5])
            np.testing.assert_array_equal(steps[0][-1]["torque"], other[-1]["torque"][:5])
    copy = pickle.loads(pickle.dumps(envs[1]))
    for action in actions:
        np.testing.assert_array_equal(copy.step(action)[0], envs[1].step(action)[0])


def test_actuators_work_in_single_precision_and_sb3() -> None:
    double = gym.make_vec(ENV, num_envs=40, **FLEXIBLE)
    single = gym.make_vec(ENV, num_envs=40, dtype="float32", **FLEXIBLE)
    actions = random_actions(30, 40)
    for a, b in zip(run(double, actions), run(single, actions), strict=True):
        np.testing.assert_allclose(a[0], b[0], atol=5e-4)
    sb3 = flexarm_env.SB3VecEnv(ENV, 40, **FLEXIBLE)
    sb3.seed(0)
    np.testing.assert_array_equal(sb3.reset(), run(double, actions[:0])[0][0])


def test_a_diverged_arm_keeps_finite_actuator_states() -> None:
    """An episode that ends as diverged restores the actuators' states, too."""
    env = gym.make(ENV, **FLEXIBLE).unwrapped
    env.reset(seed=0)
    env.core.v[0, 1] = 1e9
    before = env.core.q.copy()
    obs, _, terminated, _, info = env.step(np.zeros(1))
    assert terminated
    assert info["diverged"]
    assert np.isfinite(obs).all()
    assert np.isfinite(info["torque"]).all()
    np.testing.assert_array_equal(env.core.q, before)
