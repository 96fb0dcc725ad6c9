"""An accelerometer at the tip against second differences of a finely simulated motion."""

import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats
from scipy.integrate import simpson
from scipy.spatial.transform import Rotation

import flexarm_env  # noqa: F401
from dynamics.formulations.link_constants import chain_constants
from dynamics.load import load_arm
from dynamics.types import AnyArray, Array
from flexarm_env.core import Core
from flexarm_env.hardware.sensors import load_hardware

ID = "FlexArm/TwoLink-Reach-v0"
PART = "tip_acceleration"
STEPS, FINE = 6, 20
STILL = (0.0, 0.0, 0.0)
GRAVITY = (3.0, -9.0, 2.0)  # [m/s^2]
EXACT = {"accelerometer_noise": 0.0}
NOISY = {"preset": "laboratory", "accelerometer_noise": 0.05}


def read(envs: Any, observation: AnyArray) -> Array:
    """Readings of the accelerometer [m/s^2]."""
    core = envs if isinstance(envs, Core) else envs.unwrapped.core
    return np.asarray(
        observation[..., core.layout.slices[PART]] * core.layout.scales[PART], np.float64
    )


def followed(envs: Any, steps: int = 10, seed: int = 3) -> AnyArray:
    """(T + 1, N, size) observations under random torque, from a reset."""
    rng = np.random.default_rng(0)
    observations = [envs.reset(seed=seed)[0]]
    for _ in range(steps):
        action = rng.uniform(-0.3, 0.3, envs.action_space.shape).astype(np.float32)
        observations.append(envs.step(action)[0])
    return np.array(observations)


def tip_axes(arm: Any, q: Array) -> Array:
    """(3, 3) axes of the bent tip as columns: rotations of joints and bends, one after another."""
    turn, at = Rotation.identity(), arm.base.n
    if at:
        turn = Rotation.from_euler("z", q[2])
    for link, bodies in zip(arm.links, chain_constants(arm), strict=True):
        mounting = Rotation.from_matrix(np.array(link.joint.rotation))
        turn = turn * mounting * Rotation.from_euler("z", q[at])
        at += 1
        for body in bodies:
            bend = np.array(body.tip_theta).reshape(-1, 3)
            turn = turn * Rotation.from_rotvec(q[at : at + len(bend)] @ bend)
            at += len(bend)
    return np.asarray(turn.as_matrix())


def tip_acceleration(model: Any, q: Array, v: Array, tau: Array) -> Array:
    """Acceleration of the tip in the world [m/s^2]: the second difference of its path."""
    h = 1e-4
    a = model.accelerations(q, v, tau)
    ahead, behind = (model.tip(q + s * h * v + 0.5 * h * h * a) for s in (1.0, -1.0))
    return np.asarray((ahead - 2.0 * model.tip(q) + behind) / (h * h))


def prepared(name: str, gravity: tuple[float, float, float]) -> tuple[Core, Core, AnyArray]:
    """A core with an accelerometer, one of a finer control step, and actions between -1 and 1."""
    arm = replace(load_arm(name), gravity=gravity)
    common: dict[str, Any] = {"task": "Reach", "arm": arm, "integrator": "rk4"}
    coarse = Core(**common, hardware=EXACT, control_dt=0.02, substeps=2 * FINE)
    fine = Core(
        **common, control_dt=0.02 / FINE, substeps=2, torque_limit=coarse.torque_limit.tolist()
    )
    assert fine.arm == coarse.arm
    actions = np.random.default_rng(1).uniform(-0.5, 0.5, (STEPS, 1, arm.n_torque))
    return coarse, fine, actions.astype(np.float32)


@pytest.mark.parametrize(
    ("name", "gravity"),
    [("slim", STILL), ("two-link", GRAVITY), ("free-flyer", STILL), ("six-link", GRAVITY)],
)
def test_the_reading_is_the_mean_specific_force_along_the_tips_axes(
    name: str, gravity: tuple[float, float, float]
) -> None:
    """Simpson's rule over exact accelerations; the tolerance is that of float32 and of the rule."""
    coarse, fine, actions = prepared(name, gravity)
    arm, model, scale = coarse.arm, coarse.model, coarse.layout.scales[PART][0]
    coarse.seed(0, np.random.default_rng(0))
    v = np.zeros(arm.n)
    v[list(arm.joint_index)] = 0.2 * coarse.rate_scale
    q = 0.1 * np.arange(arm.n) * np.isin(np.arange(arm.n), arm.joint_index)
    q[: arm.base.n] = [0.1, -0.2, 0.7][: arm.base.n]
    for core in (coarse, fine):
        core.reset(np.array([0]), {"state": {"q": q, "v": v}})
    axes = list(next(part.entries for part in coarse.layout.parts if part.name == PART))
    largest = 0.0
    for action in actions:
        tau = action[0] * coarse.torque_limit
        passed = [tip_acceleration(model, fine.q[0], fine.v[0], tau)]
        for _ in range(FINE):
            fine.step(action)
            passed.append(tip_acceleration(model, fine.q[0], fine.v[0], tau))
        out, _ = coarse.step(action)
        np.testing.assert_allclose(coarse.q, fine.q, rtol=1e-9, atol=1e-12)
        force = simpson(passed, axis=0, dx=1.0 / FINE) - np.array(gravity)
        expected = (tip_axes(arm, coarse.q[0]).T @ force)[axes] / scale
        np.testing.assert_allclose(
            out.obs[0, coarse.layout.slices[PART]], expected, rtol=0.0, atol=1e-5
        )
        largest = max(largest, float(np.abs(expected).max()))
    assert largest > 0.02


def test_an_arm_that_hangs_at_rest_reads_gravity_upwards() -> None:
    """A straight link that hangs along -y: upwards is against the tip's x."""
    arm = replace(load_arm("slim"), gravity=(0.0, -9.81, 0.0))
    envs = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=2, arm=arm, hardware=EXACT)
    q = np.zeros(arm.n)
    q[0] = -0.5 * math.pi
    first, _ = envs.reset(seed=0, options={"state": {"q": q, "v": 0.0 * q}})
    for observation in (first, envs.step(np.zeros((2, 1), np.float32))[0]):
        np.testing.assert_allclose(read(envs, observation), [[-9.81, 0.0]] * 2, atol=1e-4)


def test_noise_has_its_standard_deviation_and_is_independent() -> None:
    exact = gym.make_vec(ID, num_envs=300, hardware=EXACT)
    noisy = gym.make_vec(ID, num_envs=300, hardware={"accelerometer_noise": 0.05})
    scale = noisy.unwrapped.core.layout.scales[PART]  # type: ignore[attr-defined]
    error = (read(noisy, followed(noisy)) - read(exact, followed(exact))) / scale
    n = error.size
    assert abs(error.mean()) < 4.0 * 0.05 / math.sqrt(n)
    assert error.std() == pytest.approx(0.05, rel=4.0 / math.sqrt(2.0 * n))
    assert stats.kurtosis(error.ravel()) == pytest.approx(-0.3, abs=0.15)  # of four uniform numbers
    pairs = [
        (error[1:], error[:-1]),
        (error[..., 0], error[..., 1]),
        (error[:, 1:], error[:, :-1]),
    ]
    for one, other in pairs:
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4.0 / math.sqrt(one.size)


def test_noise_differs_from_that_of_the_gauges() -> None:
    hardware = {"accelerometer_noise": 0.05, "gauge_noise": 0.05}
    exact = gym.make_vec(ID, num_envs=300, hardware=EXACT)
    noisy = gym.make_vec(ID, num_envs=300, hardware=hardware)
    errors = followed(noisy, 5) - followed(exact, 5)
    slices = noisy.unwrapped.core.layout.slices  # type: ignore[attr-defined]
    felt, bent = (errors[..., slices[name]] for name in (PART, "root_curvature"))
    for j in range(felt.shape[-1]):
        for k in range(bent.shape[-1]):
            both = np.corrcoef(felt[..., j].ravel(), bent[..., k].ravel())[0, 1]
            assert abs(both) < 4.0 / math.sqrt(felt[..., j].size)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("delay", [1, 3])
def test_readings_are_late_by_the_delay(delay: int, dtype: str) -> None:
    """Noise included: a late reading is an earlier one, not a new one."""
    now, late = (
        gym.make_vec(
            ID, num_envs=5, hardware={"accelerometer_noise": 0.05, "delay": steps}, dtype=dtype
        )
        for steps in (0, delay)
    )
    present, kept = read(now, followed(now)), read(late, followed(late))
    assert np.allclose(kept[delay:], present[:-delay], atol=1e-6)
    assert np.allclose(kept[:delay], present[0], atol=1e-6)  # before the start nothing changed


def test_a_start_has_no_acceleration_from_before() -> None:
    """The links vibrate at the start of Damp, and other episodes came before."""
    envs = gym.make_vec(
        "FlexArm/TwoLink-Damp-v0", num_envs=4, hardware=EXACT | {"delay": 2}, max_episode_steps=3
    )
    observations = followed(envs, 8)
    felt = np.abs(read(envs, observations)).max(axis=(1, 2))
    starts = [0, 1, 2, 4, 5, 6, 8]  # two late readings after each; an episode is reset in a step
    assert (felt[starts] < 1e-6).all()
    assert felt[3] > 0.01
    assert felt[7] > 0.01


def test_a_single_environment_reads_as_one_of_a_batch() -> None:
    batch = followed(gym.make_vec(ID, num_envs=3, hardware=NOISY), seed=5)
    env = gym.make(ID, hardware=NOISY)
    rng = np.random.default_rng(0)
    single = [env.reset(seed=6)[0]]
    for _ in range(10):
        action = rng.uniform(-0.3, 0.3, (3, 2)).astype(np.float32)
        single.append(env.step(action[1])[0])
    assert np.allclose(single, batch[:, 1], atol=1e-5)


def test_threads_do_not_change_the_reading() -> None:
    one, two = (
        gym.make_vec(ID, num_envs=4000, hardware=NOISY, threads=threads) for threads in (1, 2)
    )
    assert len(two.unwrapped.core.workspaces) == 2  # type: ignore[attr-defined]
    assert np.array_equal(followed(one), followed(two))


def test_no_other_reading_changes_with_the_accelerometer() -> None:
    without = gym.make_vec(ID, num_envs=20, hardware="laboratory")
    with_one = gym.make_vec(ID, num_envs=20, hardware=NOISY)
    rows = with_one.unwrapped.core.layout.slices[PART]  # type: ignore[attr-defined]
    rest = np.delete(followed(with_one), np.r_[rows], axis=-1)
    assert np.allclose(rest, followed(without), atol=1e-5)


def test_hardware_has_no_accelerometer_unless_it_is_asked_for() -> None:
    for hardware in ("laboratory", {"delay": 1}, {"preset": "laboratory"}):
        assert PART not in gym.make(ID, hardware=hardware).unwrapped.observation_slices  # type: ignore[attr-defined]
    assert PART not in gym.make(ID, obs="sensors").unwrapped.observation_slices  # type: ignore[attr-defined]
    taken_off = load_hardware({"preset": "laboratory", "accelerometer_noise": None})
    assert taken_off == load_hardware("laboratory")


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (-1.0, r"must not be negative, got -1\.0"),
        (math.nan, "must be a finite number, got nan"),
        (math.inf, "must be a finite number, got inf"),
        ("0.01", "must be a number, got the text '0.01'"),
        (True, "must be a number, got True"),
        ((0.0, 0.1), r"must be a number, got \(0\.0, 0\.1\)"),
        (1e31, "must be at most 1e.30 in size, got 1e.31"),
    ],
)
def test_bad_noise_is_refused(value: Any, words: str) -> None:
    with pytest.raises(ValueError, match=r"hardware\.accelerometer_noise.*" + words) as refusal:
        gym.make(ID, hardware={"accelerometer_noise": value})
    assert "leave it out for no accelerometer" in str(refusal.value)
