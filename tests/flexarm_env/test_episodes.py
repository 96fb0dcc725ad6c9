"""Episodes: random starts, observations, ends."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

import flexarm_env
from dynamics import ARMS
from flexarm_env import registration
from flexarm_env.core import Core
from flexarm_env.task.scales import DEFLECTION_LIMIT, scales

ALL_IDS = [i for i in flexarm_env.IDS if "Goal" not in i]  # test_goals.py has the others
SCENES = ("OneLink", "TwoLink", "SixLink")


def same_step(env_id: str, n_env: int, **keywords: Any) -> Any:
    return gym.make_vec(env_id, num_envs=n_env, autoreset_mode="SameStep", **keywords)


@pytest.mark.parametrize("obs", ["state", "sensors"])
@pytest.mark.parametrize("env_id", ALL_IDS)
def test_no_observation_element_is_constant_or_duplicated(env_id: str, obs: str) -> None:
    envs = same_step(env_id, 32, obs=obs)
    rng = np.random.default_rng(0)
    seen = [envs.reset(seed=0)[0]]
    for _ in range(40):
        actions = rng.uniform(-0.5, 0.5, envs.action_space.shape).astype(np.float32)
        seen.append(envs.step(actions)[0])
    samples = np.concatenate(seen)
    slices = envs.unwrapped.observation_slices
    assert [s.stop for s in slices.values()][-1] == samples.shape[1]
    assert (samples.std(axis=0) > 1e-3).all(), slices
    correlation = np.corrcoef(samples.T) - np.eye(samples.shape[1])
    assert (np.abs(correlation) < 1.0 - 1e-9).all(), slices


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_observations_are_of_order_one(env_id: str) -> None:
    envs = same_step(env_id, 64)
    rng = np.random.default_rng(0)
    seen = [envs.reset(seed=0)[0]]
    for _ in range(60):
        actions = rng.uniform(-0.7, 0.7, envs.action_space.shape).astype(np.float32)
        seen.append(envs.step(actions)[0])
    size = np.sqrt(np.mean(np.concatenate(seen) ** 2, axis=0))
    assert (size > 0.005).all()
    assert (size < 4.0).all()


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_random_episodes_stay_finite(env_id: str) -> None:
    assert_finite(env_id, n_env=64, steps=100)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ALL_IDS)
def test_a_million_random_steps_stay_finite(env_id: str) -> None:
    assert_finite(env_id, n_env=1024, steps=977)


def assert_finite(env_id: str, n_env: int, steps: int) -> None:
    envs = same_step(env_id, n_env)
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    low, high = envs.observation_space.low, envs.observation_space.high
    for _ in range(steps):
        actions = rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32)
        observation, reward, _, _, info = envs.step(actions)
        assert (low <= observation).all()
        assert (observation <= high).all()  # false for a NaN, too
        assert np.isfinite(reward).all()
        for name in ("tip_error", "tip_speed", "deflection", "root_curvature"):
            assert np.isfinite(info[name]).all(), name


@pytest.mark.parametrize("scene", SCENES)
def test_an_arm_without_torque_reaches_the_end_of_its_episode(scene: str) -> None:
    for task in flexarm_env.TASKS:
        envs = same_step(f"FlexArm/{scene}-{task}-v0", 64)
        envs.reset(seed=0)
        terminated = np.zeros(64, bool)
        for _ in range(flexarm_env.IDS[f"FlexArm/{scene}-{task}-v0"]["max_episode_steps"]):
            terminated |= envs.step(np.zeros(envs.action_space.shape))[2]
        assert not terminated.any()


@pytest.mark.parametrize("scene", SCENES)
def test_bang_bang_bends_hard_but_stays_valid(scene: str) -> None:
    """One period at the first joint-free frequency, every pattern of signs: 5 to 10 %."""
    arm = registration.SCENES[scene][0]
    half = np.pi / scales(ARMS[arm]).free[0]
    core = Core(task="Reach", arm=arm, n_env=64, control_dt=half / 8)
    core.reset(np.arange(64))
    n_joint = core.arm.n_joint
    core.q[:, list(core.arm.joint_index)] = core.scales.home
    signs = np.array([[1.0 - 2.0 * (i >> j & 1) for j in range(n_joint)] for i in range(64)])
    peak = 0.0
    for step in range(24):
        direction = 1.0 if step < 8 else -1.0 if step < 16 else 0.0
        described = core.step((direction * signs).astype(np.float32))[0].described()
        assert not described["invalid"].any()
        peak = max(peak, described["deflection"].max())
    assert 0.5 * DEFLECTION_LIMIT < peak < DEFLECTION_LIMIT


@pytest.mark.parametrize("scene", SCENES)
def test_a_forced_divergence_ends_the_episode(scene: str) -> None:
    """A very soft arm under a huge torque: terminated, diverged, and a finite observation."""
    arm = ARMS[registration.SCENES[scene][0]]
    names = ("EIz", "EIy")
    soft = [
        replace(link, **{k: 1e-6 * getattr(link, k) for k in names if getattr(link, k)})
        for link in arm.links
    ]
    soft_arm = replace(arm, links=tuple(soft))
    env = gym.make(f"FlexArm/{scene}-Reach-v0", arm=soft_arm, torque_limit=1e9)
    env.reset(seed=0)
    for _ in range(10):
        observation, reward, terminated, truncated, info = env.step(env.action_space.high)
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["diverged"] is True
    assert observation in env.observation_space
    assert np.isfinite(reward)
    env.reset()
    assert env.step(0.0 * env.action_space.high)[2] is False


def test_bending_beyond_the_limit_is_invalid_but_not_diverged() -> None:
    short: dict[str, Any] = {"control_dt": 0.002, "integrator": "exponential-3"}  # that of the id
    env = gym.make("FlexArm/OneLink-Reach-v0", **short)
    env.reset(seed=0, options={"state": {"q": [0.0, 0.13, 0.0]}})
    *_, terminated, _, info = env.step(np.zeros(1))
    assert (terminated, info["invalid"], info["diverged"]) == (True, True, False)
    lenient = gym.make("FlexArm/OneLink-Reach-v0", **short, deflection_limit=0.2)
    lenient.reset(seed=0, options={"state": {"q": [0.0, 0.13, 0.0]}})
    assert lenient.step(np.zeros(1))[2] is False


@pytest.mark.parametrize("shortened", [False, True])
def test_overspeed_is_set_beyond_half_the_first_locked_frequency(shortened: bool) -> None:
    """Only without foreshortening: a foreshortened link stiffens as it turns."""
    arm = replace(ARMS["slim"], foreshortening=shortened)
    env: Any = gym.make("FlexArm/OneLink-Reach-v0", arm=arm).unwrapped
    limit = 0.5 * env.core.model.frequencies()[0]
    for share in (0.9, 1.1):
        env.reset(seed=0, options={"state": {"q": [0.0] * 3, "v": [-share * limit, 0.0, 0.0]}})
        _, _, terminated, _, info = env.step(np.zeros(1, np.float32))
        assert (terminated, info["overspeed"]) == (False, share > 1.0 and not shortened)


@pytest.mark.parametrize("scene", SCENES)
def test_default_integration_keeps_the_tip_within_a_thousandth_of_the_reach(scene: str) -> None:
    """Against four times as many Runge-Kutta steps."""
    arm, control_dt, _ = registration.SCENES[scene]
    common: dict[str, Any] = {"task": "Reach", "arm": arm, "n_env": 4, "control_dt": control_dt}
    default = Core(**common)
    fine = Core(**common, integrator="rk4", substeps=4 * Core(**common, integrator="rk4").substeps)
    for core in (default, fine):
        for row in range(4):
            core.seed(row, np.random.default_rng(row))
        core.reset(np.arange(4))
    rng = np.random.default_rng(0)
    worst = 0.0
    tip = default.model.tip
    for _ in range(40):
        action = rng.uniform(-0.4, 0.4, (4, default.arm.n_joint)).astype(np.float32)
        default.step(action)
        fine.step(action)
        gaps = [tip(a) - tip(b) for a, b in zip(default.q, fine.q, strict=True)]
        worst = max(worst, float(np.linalg.norm(gaps, axis=1).max()))
    assert worst < 1e-3 * default.arm.reach


def test_track_targets_move_smoothly_from_rest() -> None:
    """The joint target's rate is the derivative of the target, and starts at zero."""
    envs = gym.make_vec(
        "FlexArm/TwoLink-Track-v0", num_envs=16, control_dt=0.001, max_episode_steps=2000
    )
    base = envs.unwrapped
    observation, info = envs.reset(seed=0)
    rate = base.observation_slices["target_rate"]
    scale = base.observation_scales["target_rate"]
    assert np.abs(observation[:, rate]).max() == 0.0
    assert info["tip_error"].max() < 1e-15  # round-off of two routes to one point
    targets, rates = [base.joint_target()], [observation[:, rate] * scale]
    for _ in range(1000):
        observation = envs.step(np.zeros((16, 2)))[0]
        targets.append(base.joint_target())
        rates.append(observation[:, rate] * scale)
    middle = (np.array(targets)[2:] - np.array(targets)[:-2]) / 0.002
    np.testing.assert_allclose(middle, np.array(rates)[1:-1], atol=1e-6)  # 2nd order in 1 ms
    assert np.abs(np.array(rates)).max() > 0.1


def test_the_look_ahead_is_the_future_target() -> None:
    env = gym.make("FlexArm/OneLink-Track-v0", control_dt=0.01)
    base: Any = env.unwrapped
    observation, _ = env.reset(seed=0)
    ahead = base.core.move_time
    expected = {}
    for name, time in (("target_near", 0.5 * ahead), ("target_far", ahead)):
        part = observation[base.observation_slices[name]] * base.observation_scales[name]
        expected[time] = base.joint_target() + part
    times, angles = [0.0], [base.joint_target()[0]]
    for _ in range(int(ahead / 0.01) + 2):
        info = env.step(np.zeros(1))[-1]
        times.append(info["time"])
        angles.append(base.joint_target()[0])
    for time, angle in expected.items():
        assert np.interp(time, times, angles) == pytest.approx(angle[0], abs=1e-4)  # 10 ms apart


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(("task", "near"), [("Reach", 0.5), ("Track", 0.3), ("Damp", 0.5)])
def test_episodes_start_uniformly_in_the_ranges_of_their_page(
    scene: str, task: str, near: float
) -> None:
    envs: Any = gym.make_vec(f"FlexArm/{scene}-{task}-v0", num_envs=2000)
    envs.reset(seed=0)
    core = envs.unwrapped.core
    start, _ = core.joint_state()
    off = (start - core.scales.home) / near
    assert stats.kstest(off[:, 0], stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-4
    assert np.abs(off).max() <= 1.0
    move = core.joint_target() - start
    if task == "Reach":
        assert stats.kstest(np.abs(move[:, 0]), stats.uniform(0.3, 0.5).cdf).pvalue > 1e-4
        assert 0.4 < np.mean(move > 0.0) < 0.6
    else:
        assert np.abs(move).max() < 1e-12


@pytest.mark.parametrize("scene", SCENES)
def test_damp_vibrates_by_up_to_sixty_percent_of_the_bang_bang_peaks(scene: str) -> None:
    envs: Any = gym.make_vec(f"FlexArm/{scene}-Damp-v0", num_envs=2000)
    envs.reset(seed=0)
    core = envs.unwrapped.core
    modal = [i for i in range(core.arm.n) if i not in core.arm.joint_index]
    for states, shapes in ((core.q, core.scales.vibration), (core.v, core.scales.vibration_rate)):
        share = np.linalg.lstsq(np.array(shapes).T, states[:, modal].T, rcond=None)[0]
        assert np.abs(share).max() <= 0.6 + 1e-9
        assert stats.kstest(share[0], stats.uniform(-0.6, 1.2).cdf).pvalue > 1e-4
