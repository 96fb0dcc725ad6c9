"""Imperfect sensors against a second computation in NumPy, and their spread."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

import flexarm_env  # noqa: F401
from dynamics.backends.numba_llvm.noise import normal
from flexarm_env.hardware.sensors import PRESETS, Hardware, load_hardware
from flexarm_env.task.observations import curvature_columns, curvature_scale

ID = "FlexArm/TwoLink-Reach-v0"
STEPS = 12
COARSE = {"encoder_counts": 512, "gauge_noise": 0.05, "gauge_bias": 0.1, "gauge_counts": 20}


def followed(envs: Any, seed: int = 3) -> tuple[Any, Any]:
    """(T, N, size) observations and (T, N, n_joint) true joint angles under random torque."""
    rng = np.random.default_rng(0)
    observations, angles = [envs.reset(seed=seed)[0]], [envs.unwrapped.joint_state()[0]]
    for _ in range(STEPS):
        action = rng.uniform(-0.3, 0.3, envs.action_space.shape).astype(np.float32)
        observations.append(envs.step(action)[0])
        angles.append(envs.unwrapped.joint_state()[0])
    return np.array(observations), np.array(angles)


def part(envs: Any, observations: Any, name: str) -> Any:
    """One part of the observations in physical units."""
    base = envs.unwrapped
    return observations[..., base.observation_slices[name]] * base.observation_scales[name]


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_encoders_read_whole_counts_and_rates_are_their_differences(delay: int, dtype: str) -> None:
    hardware = {"encoder_counts": 512, "delay": delay}
    envs = gym.make_vec(ID, num_envs=5, hardware=hardware, dtype=dtype)
    observations, angles = followed(envs)
    step = 2.0 * math.pi / 512
    read = step * np.floor(angles.astype(float) / step + 0.5)
    read = np.concatenate([read[:1]] * (delay + 1) + [read])  # before the start nothing moved
    late = read[1 : 1 + STEPS + 1]
    rates = np.diff(read, axis=0)[: STEPS + 1] / envs.unwrapped.control_dt
    target = envs.unwrapped.joint_target()
    assert np.allclose(part(envs, observations, "joint_error") + target, late, atol=2e-6)
    assert np.allclose(part(envs, observations, "joint_rate"), rates, atol=1e-4)
    assert np.allclose(part(envs, observations, "joint_sin"), np.sin(late)[..., 1:], atol=1e-6)
    assert np.unique(np.round(rates / (step / envs.unwrapped.control_dt), 3) % 1.0).size <= 2


def test_gauges_have_noise_bias_and_counts() -> None:
    exact = gym.make_vec(ID, num_envs=400, obs="sensors")
    noisy = gym.make_vec(ID, num_envs=400, hardware=COARSE)
    true = part(exact, followed(exact)[0], "root_curvature")
    read = part(noisy, followed(noisy)[0], "root_curvature")
    arm = exact.unwrapped.arm
    scale = np.array(curvature_scale(arm, curvature_columns(arm)))
    counts = read / (scale / 20)
    assert np.allclose(counts, np.round(counts), atol=1e-4)
    error = (read - true) / scale
    bias = error.mean(axis=0)
    assert 0.08 < np.abs(bias).max() < 0.1 + 0.06
    assert stats.kstest(bias.ravel(), stats.uniform(-0.1, 0.2).cdf).pvalue > 1e-4
    spread = math.sqrt(0.05**2 + (1 / 20) ** 2 / 12)
    assert error.std(axis=0, ddof=1).mean() == pytest.approx(spread, rel=0.05)


def test_noise_is_nearly_normal_and_independent() -> None:
    key, steps = 12345.0, 2000
    x = np.array([[normal(key, float(k), j) for j in range(3)] for k in range(steps)])
    assert abs(x.mean()) < 4.0 / math.sqrt(x.size)
    assert x.std() == pytest.approx(1.0, rel=0.03)
    assert np.abs(x).max() < 2.0 * math.sqrt(3.0)
    assert stats.kurtosis(x.ravel()) == pytest.approx(-0.3, abs=0.15)  # of four uniform numbers
    lags = [np.corrcoef(x[1:, 0], x[:-1, 0])[0, 1], np.corrcoef(x[:, 0], x[:, 1])[0, 1]]
    assert np.abs(lags).max() < 4.0 / math.sqrt(steps)


def test_delays_are_drawn_per_episode() -> None:
    envs = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=300, hardware={"delay": (0, 2)})
    envs.reset(seed=0)
    first = np.zeros(300)
    for k in range(1, 6):
        observation = envs.step(np.ones((300, 1), np.float32))[0]
        moved = part(envs, observation, "joint_rate")[:, 0] != 0.0
        first = np.where((first == 0) & moved, k, first)
    values, counts = np.unique(first - 1, return_counts=True)
    assert values.tolist() == [0, 1, 2]
    assert stats.chisquare(counts).pvalue > 1e-4


def test_a_single_environment_reads_as_one_of_a_batch() -> None:
    envs = gym.make_vec(ID, num_envs=3, hardware="laboratory")
    env = gym.make(ID, hardware="laboratory")
    batch, _ = followed(envs, seed=5)
    rng = np.random.default_rng(0)
    single = [env.reset(seed=6)[0]]
    for _ in range(STEPS):
        action = rng.uniform(-0.3, 0.3, (3, 2)).astype(np.float32)
        single.append(env.step(action[1])[0])
    assert np.allclose(single, batch[:, 1], atol=1e-5)


def test_threads_and_seeds_do_not_change_the_noise() -> None:
    runs = [
        followed(gym.make_vec(ID, num_envs=64, hardware="laboratory", threads=threads))[0]
        for threads in (1, 2, 2)
    ]
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[1], runs[2])
    other = followed(gym.make_vec(ID, num_envs=64, hardware="laboratory"), seed=4)[0]
    assert not np.array_equal(runs[0], other)


def test_the_laboratory_draws_payload_and_stiffness_unless_they_are_given() -> None:
    envs = gym.make_vec(ID, num_envs=200, hardware="laboratory")
    envs.reset(seed=0)
    core = envs.unwrapped.core  # type: ignore[attr-defined]
    last = core.arm.links[-1]
    most = 0.5 * (last.rho_A * last.length + last.tip_mass)
    payload, stiffness = core.parameters.T
    assert 0.9 * most < payload.max() <= most
    assert payload.min() >= 0.0
    assert 0.9 <= stiffness.min() < 0.92
    assert 1.08 < stiffness.max() <= 1.1
    given = gym.make(ID, hardware="laboratory", randomize={"payload_mass": (0.0, 0.0)})
    assert given.unwrapped.core.randomize["payload_mass"] == (0.0, 0.0)  # type: ignore[attr-defined]
    assert given.unwrapped.core.randomize["stiffness"] == (0.9, 1.1)  # type: ignore[attr-defined]


def test_ideal_hardware_changes_nothing() -> None:
    plain = followed(gym.make_vec(ID, num_envs=4, obs="sensors"))[0]
    ideal = followed(gym.make_vec(ID, num_envs=4, obs="sensors", hardware="ideal"))[0]
    assert np.array_equal(plain, ideal)


def test_a_dict_changes_numbers_of_a_preset() -> None:
    hardware = load_hardware({"preset": "laboratory", "delay": 1})
    preset = PRESETS["laboratory"]
    assert hardware is not None
    assert preset is not None
    assert hardware.delay == (1, 1)
    assert hardware.encoder_counts == preset.encoder_counts
    assert load_hardware(Hardware()) == Hardware()


@pytest.mark.parametrize(
    ("hardware", "words"),
    [
        ("lab", "hardware"),
        (3, "dict"),
        ({"encoder": 5}, "encoder"),
        ({"encoder_counts": 0}, "hardware.encoder_counts"),
        ({"gauge_noise": -1.0}, "hardware.gauge_noise"),
        ({"gauge_bias": math.nan}, "hardware.gauge_bias"),
        ({"delay": (2, 1)}, r"hardware.delay\[1\]"),
        ({"delay": 9}, "hardware.delay"),
        ({"delay": (0, 1, 2)}, "hardware.delay"),
        ({"payload": (-1.0, 1.0)}, "hardware.payload"),
        ({"stiffness": (1.1, 0.9)}, "hardware.stiffness"),
        ({"stiffness": 3}, "hardware.stiffness"),
        ({"stiffness": (0.0, 0.0)}, "stiffness by hardware.*above 0"),
        ({"payload": (0.0, 1e9)}, "payload_mass by hardware.*1e.06"),
    ],
)
def test_bad_hardware_is_refused(hardware: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        gym.make(ID, hardware=hardware)


@pytest.mark.parametrize("obs", ["state", "goal"])
def test_an_exact_state_beside_hardware_is_refused(obs: str) -> None:
    with pytest.raises(ValueError, match="obs must be 'sensors'"):
        gym.make(ID, hardware="laboratory", obs=obs)
