"""The free flyer: momentum, a target that rests in the world, and torque on the base."""

import warnings
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gym_check_env
from numpy.testing import assert_allclose

import flexarm_env
from dynamics import ARMS, Payload, compile_arm
from dynamics.formulations.free_base import carried
from dynamics.load import load_arm
from dynamics.types import Array
from flexarm_env.certify.momentum import momentum_error
from flexarm_env.certify.search import MOMENTUM_ERROR
from flexarm_env.rendering import SOLID, Renderer
from flexarm_env.task.tasks import SETTLED_BAND

ENV_ID = "FlexArm/FreeFlyer-Reach-v0"
FLYER = ARMS["free-flyer"]
PLAIN: dict[str, Any] = {"task": "Reach", "arm": FLYER, "control_dt": 0.05}
BASE = FLYER.base


def momentum_of(info: dict[str, Any]) -> list[float]:
    """Linear momentum along x and y [N s], angular momentum [N m s]."""
    return [*info["linear_momentum"], info["angular_momentum"]]


def info_of(infos: dict[str, Any], row: int) -> dict[str, Any]:
    """Entries on the momentum of one environment of a batch."""
    return {name: infos[name][row] for name in ("linear_momentum", "angular_momentum")}


def random_episode(steps: int = 240, **keywords: Any) -> tuple[Array, Array, Array]:
    """Momenta (steps, 3), torques (steps, n_torque), size of the base's own momenta (3,)."""
    env = gym.make(ENV_ID, **keywords)
    base: Any = env.unwrapped
    rng, momenta, torques, own = np.random.default_rng(1), [], [], np.zeros(3)
    env.reset(seed=1)
    for _ in range(steps):
        info = env.step(rng.uniform(-0.4, 0.4, env.action_space.shape))[-1]
        assert not info["invalid"]
        momenta.append(momentum_of(info))
        torques.append(info["torque"])
        vx, vy, rate = base.core.v[0, :3]
        linear, angular = BASE.mass * np.hypot(vx, vy), BASE.inertia[2][2] * abs(rate)
        own = np.maximum(own, (linear, linear, angular))
    return np.array(momenta), np.array(torques), own


def test_momentum_is_conserved_to_the_order_of_the_step() -> None:
    """An episode of random torques; four times the steps have less than 4^-4 of the drift."""
    coarse, _, own = random_episode(integrator="rk4", substeps=4)
    fine, _, _ = random_episode(integrator="rk4", substeps=16)
    assert (own > 0.1).all(), "the base moves"
    drift, less = (np.abs(x).max(axis=0) for x in (coarse, fine))
    assert (drift < MOMENTUM_ERROR * own).all()
    assert (less < 4.0**-4 * drift).all()


def test_angular_momentum_is_the_integral_of_the_torque_on_the_base() -> None:
    momenta, torques, own = random_episode(base_torque=0.5)
    turned = 0.05 * np.cumsum(torques[:, -1])
    assert np.abs(turned).max() > 0.05
    assert_allclose(momenta[:, 2], turned, rtol=0.0, atol=MOMENTUM_ERROR * own[2])
    assert (np.abs(momenta[:, :2]) < MOMENTUM_ERROR * own[:2]).all()


def test_a_torque_on_the_base_stands_beside_actuators() -> None:
    momenta, torques, own = random_episode(60, base_torque=0.5, actuator={"type": "limited"})
    turned = 0.05 * np.cumsum(torques[:, -1])
    assert_allclose(momenta[:, 2], turned, rtol=0.0, atol=10.0 * MOMENTUM_ERROR * own[2])


def test_a_method_that_loses_momentum_is_told() -> None:
    """Frozen modes are those of the arm at rest, not of one that has turned."""
    step: dict[str, Any] = {"control_dt": 0.05}
    assert momentum_error(FLYER, step, "exponential", 1) > MOMENTUM_ERROR
    assert momentum_error(FLYER, step, "rk4", 6) < 0.1 * MOMENTUM_ERROR
    assert momentum_error(load_arm("two-link"), step, "exponential", 1) == 0.0


def test_the_arm_reaches_the_target_and_the_target_rests() -> None:
    """Slow joint control follows the straight path of the joints on which the target is defined."""
    envs: Any = gym.make_vec(ENV_ID, num_envs=32).unwrapped
    envs.reset(seed=0)
    core, inertia = envs.core, np.array(envs.core.scales.inertia)
    goals, start = np.array([core.goal(row) for row in range(32)]), core.q[:, 2].copy()
    for _ in range(239):
        (q, v), target = envs.joint_state(), envs.joint_target()
        torque = inertia * (4.0 * (target - q) - 4.0 * v)
        *_, info = envs.step((torque / envs.torque_limit).astype(np.float32))
    assert_allclose([core.goal(row) for row in range(32)], goals, rtol=0.0, atol=0.0)
    assert np.abs(target - q).max() < 1e-3
    assert (info["tip_error"] < 0.5 * SETTLED_BAND * FLYER.reach).all()
    assert info["settled"].all()
    tips = np.array([core.model.tip(core.q[row]) for row in range(32)])
    distance = np.linalg.norm(goals - tips, axis=1)
    assert_allclose(info["tip_error"], distance, rtol=1e-9, atol=1e-12)
    assert np.abs(core.q[:, 2] - start).max() > 0.2, "the base turned"


@pytest.mark.parametrize("obs", ["state", "sensors"])
def test_turning_and_shifting_the_start_changes_only_the_base_in_the_observation(obs: str) -> None:
    """Physics and target are those of an arm at another place of the same empty world."""
    angle, shift = 2.0, np.array([0.7, -0.4])
    c, s = np.cos(angle), np.sin(angle)
    q, v = np.zeros((2, FLYER.n))
    q[[3, 6]], v[3:] = (0.3, 0.8), (0.2, 0.01, 0.02, -0.3, 0.03, 0.0)
    moved = q.copy()
    moved[:2], moved[2] = shift, angle
    runs = []
    for start in (q, moved):
        env = gym.make(ENV_ID, obs=obs)
        base: Any = env.unwrapped
        rng = np.random.default_rng(0)
        options = {"state": {"q": start, "v": v}, "target": [0.9, 0.2]}
        rows = [env.reset(options=options)]
        rows += [env.step(rng.uniform(-0.3, 0.3, 2))[::4] for _ in range(30)]
        runs.append((rows, base.observation_slices, base.core.q[0].copy()))
    (here, parts, end), (there, _, moved_end) = runs
    world = [name for name in parts if name.startswith("base_") and name != "base_rate"]
    own = np.setdiff1d(np.arange(env.observation_space.shape[0]), np.r_[*(parts[x] for x in world)])
    for (obs_here, info_here), (obs_there, info_there) in zip(here, there, strict=True):
        assert_allclose(obs_there[own], obs_here[own], rtol=0.0, atol=2e-6)
        assert info_there["tip_error"] == pytest.approx(info_here["tip_error"], rel=1e-7)
        turned = np.array([[c, -s], [s, c]]) @ info_here["linear_momentum"]
        assert_allclose(info_there["linear_momentum"], turned, rtol=0.0, atol=1e-7)
    assert_allclose(moved_end[:2], shift + np.array([[c, -s], [s, c]]) @ end[:2], atol=1e-9)
    assert moved_end[2] == pytest.approx(end[2] + angle, rel=1e-9)
    scale = base.observation_scales["base_position"]
    assert_allclose(obs_there[parts["base_position"]] * scale, moved_end[:2], atol=1e-6)
    assert obs_there[parts["base_sin"]] == pytest.approx(np.sin(moved_end[2]), abs=1e-6)
    assert obs_there[parts["base_cos"]] == pytest.approx(np.cos(moved_end[2]), abs=1e-6)


def test_the_target_is_seen_from_the_base() -> None:
    env = gym.make(ENV_ID, obs="sensors")
    base: Any = env.unwrapped
    env.reset(seed=4)
    for _ in range(40):
        obs = env.step(np.array([1.0, -1.0]))[0]
    x, y, angle = base.core.q[0, :3]
    assert abs(np.sin(angle)) > 0.02
    seen = base.core.goal(0)[:2] - (x, y)
    turned = [
        np.cos(angle) * seen[0] + np.sin(angle) * seen[1],
        np.cos(angle) * seen[1] - np.sin(angle) * seen[0],
    ]
    found = obs[base.observation_slices["target_position"]] * FLYER.reach
    assert_allclose(found, turned, rtol=0.0, atol=1e-6)


def test_a_drawn_payload_moves_the_target_as_it_moves_the_base() -> None:
    env = gym.make(ENV_ID, randomize={"payload_mass": (0.0, 3.0)})
    base: Any = env.unwrapped
    shifts = []
    for seed in range(5):
        env.reset(seed=seed)
        payload = Payload(mass=float(base.core.parameters[0, 0]))
        loaded = compile_arm(replace(base.arm, payload=payload))
        q = np.zeros(FLYER.n)
        q[[3, 6]] = base.joint_target()
        pose = [
            carried(model.chain, FLYER.joint_index, base.core.q[0].tolist(), q[[3, 6]].tolist())
            for model in (loaded, compile_arm(FLYER))
        ]
        q[:3] = pose[0]
        assert_allclose(base.core.goal(0), loaded.tip(q), rtol=0.0, atol=1e-9)
        shifts.append(abs(pose[0][2] - pose[1][2]))
    assert max(shifts) > 0.01


@pytest.mark.parametrize(
    "keywords", [{}, {"base_torque": 0.5}, {"hardware": "laboratory"}], ids=str
)
def test_batch_and_single_environments_agree(keywords: dict[str, Any]) -> None:
    batch = gym.make_vec(ENV_ID, num_envs=3, **keywords)
    stable = flexarm_env.SB3VecEnv(ENV_ID, 3, max_episode_steps=30, **keywords)
    singles = [gym.make(ENV_ID, **keywords) for _ in range(3)]
    stable.seed(0)
    given = [batch.reset(seed=0)[0], stable.reset()]
    for obs in given:
        alone = [env.reset(seed=seed)[0] for seed, env in enumerate(singles)]
        assert_allclose(obs, alone, rtol=0.0, atol=1e-6)
    rng = np.random.default_rng(0)
    for step in range(30):
        actions = rng.uniform(-0.5, 0.5, batch.action_space.shape).astype(np.float32)
        obs, reward, _, _, info = batch.step(actions)
        theirs, their_reward, _, infos = stable.step(actions)
        if step < 29:
            assert_allclose(theirs, obs, rtol=0.0, atol=0.0)
        assert_allclose(their_reward, reward, rtol=1e-6)
        for row, env in enumerate(singles):
            alone_obs, alone_reward, _, _, alone = env.step(actions[row])
            assert_allclose(obs[row], alone_obs, rtol=0.0, atol=1e-6)
            assert reward[row] == pytest.approx(alone_reward, rel=1e-7, abs=1e-9)
            whole = momentum_of(info_of(info, row))
            assert_allclose(whole, momentum_of(alone), rtol=0.0, atol=1e-9)
            assert isinstance(alone["angular_momentum"], float)
    for row in range(3):
        assert_allclose(momentum_of(infos[row]), momentum_of(info_of(info, row)), atol=1e-12)


@pytest.mark.parametrize("keywords", [{"base_torque": 1.0}, {"obs": "goal"}], ids=str)
def test_the_checker_passes_with_a_driven_base_and_with_goals(keywords: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym_check_env(gym.make(ENV_ID, **keywords).unwrapped)


def test_an_action_has_the_torque_of_the_base_last() -> None:
    env = gym.make(ENV_ID, base_torque=2.0)
    base: Any = env.unwrapped
    env.reset(seed=0)
    info = env.step(np.array([0.0, 0.0, 1.0]))[-1]
    assert_allclose(info["torque"], [0.0, 0.0, 2.0])
    assert info["angular_momentum"] == pytest.approx(2.0 * 0.05, rel=1e-3)
    assert base.torque_limit[-1] == 2.0
    assert base.certificate is None
    assert "base_torque" in base.uncertified
    assert gym.make(ENV_ID).unwrapped.certificate["error"] < 1e-3 * FLYER.reach  # type: ignore[attr-defined]


def test_the_base_starts_where_it_is_described_at_any_angle() -> None:
    half = np.pi / 8.0
    turned = (np.cos(half), 0.0, 0.0, np.sin(half))
    arm = replace(FLYER, base=replace(BASE, position=(1.0, -1.0, 0.0), quaternion=turned))
    envs: Any = gym.make_vec(ENV_ID, num_envs=200, arm=arm).unwrapped
    obs = envs.reset(seed=0)[0]
    assert_allclose(envs.core.q[:, :2], [[1.0, -1.0]] * 200, rtol=0.0, atol=0.0)
    off = envs.core.q[:, 2] - np.pi / 4.0
    assert off.min() < -0.95 * np.pi
    assert off.max() > 0.95 * np.pi
    assert np.abs(off).max() <= np.pi
    assert not obs[:, envs.observation_slices["base_position"]].any()


def test_the_base_is_drawn_where_it_is() -> None:
    env = gym.make(ENV_ID, render_mode="rgb_array")
    base: Any = env.unwrapped
    middles = []
    for x in (0.0, 0.4):
        q = np.zeros(FLYER.n)
        q[0] = x
        env.reset(seed=0, options={"state": {"q": q}, "target": [0.5, 0.5]})
        picture: Any = env.render()
        body = np.argwhere((picture == SOLID).all(axis=2))
        assert len(body) > 1000
        middles.append(0.5 * (body[:, 1].min() + body[:, 1].max()))
    assert middles[1] - middles[0] == pytest.approx(0.4 * base._renderer.scale, abs=2.0)
    q[:3] = 0.2, 0.1, 0.5
    lines = Renderer(base.core).shapes(base.core, q, 1.0)
    assert_allclose(lines[-1][-1], base.model.tip(q), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"task": "Track"}, r"Base.type must be 'fixed' where .* follow .*Take task='Reach'"),
        ({"task": "Damp"}, r"Base.type must be 'fixed' where .* damp .*Take task='Reach'"),
        ({"base_torque": -1.0}, r"base_torque must be positive, got -1\.0"),
        ({"base_torque": "much"}, r"base_torque .* must be a number, got the text 'much'"),
        ({"arm": "slim", "base_torque": 1.0}, r"base_torque \(1\.0 N m\) needs a base that turns"),
        (
            {"arm": replace(FLYER, base=replace(BASE, driven=True))},
            r"Base\.driven must be left out for an environment, got True; base_torque",
        ),
        (
            {"arm": replace(FLYER, base=replace(BASE, velocity=(0.1, 0.0, 0.0)))},
            r"must be zero for an environment, got \(0\.1, 0\.0, 0\.0\)",
        ),
        (
            {"arm": replace(FLYER, gravity=(0.0, -9.81, 0.0))},
            r"Arm\.gravity .* must be along z where a base floats",
        ),
    ],
)
def test_what_a_floating_base_cannot_have_is_refused(
    keywords: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        flexarm_env.FlexArmEnv(**(PLAIN | keywords))
