"""Torque limits hold every target of the tasks against gravity."""

import warnings
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import root

import flexarm_env  # registers the ids
from agents.controllers.pd import joint_pd
from dynamics import ARMS, Arm, Joint, Link, load_arm
from dynamics.description.parameters import with_parameters
from dynamics.formulations.gibbs_appell import bias
from dynamics.model import Model
from dynamics.simulation.statics import RigidArm, held
from dynamics.tracing.equilibrium import settled as bent
from dynamics.types import Array
from flexarm_env.certify.episodes import Episodes
from flexarm_env.interfaces.vector import FlexArmVectorEnv
from flexarm_env.plant import GravityWarning
from flexarm_env.task.scales import DEFLECTION_LIMIT, EXTENT, MOVE, scales
from flexarm_env.task.tasks import TASKS

OWN: dict[str, Any] = {
    "name": "own", "gravity": [0.0, -9.81, 0.0],
    "links": [{
        "length": 0.8, "rho_A": 0.12, "EIz": 6.0, "tip_mass": 0.15, "damping_ratio": 0.01,
        "modes": [{"kind": "clamped-tip-mass", "index": k, "direction": "y"} for k in (1, 2)],
        "joint": {"rotor_inertia": 0.02, "viscous": 0.01},
    }],
}  # fmt: skip
_LINK = load_arm(OWN).links[0]
HEAVY = {
    "own": load_arm(OWN),
    "two in a vertical plane": replace(
        load_arm(OWN),
        links=(replace(_LINK, EIz=60.0, joint=Joint(rotor_inertia=0.2)), replace(_LINK, EIz=20.0)),
    ),
    **{name: ARMS[name] for name in ("korayem-two-link", "mamedov-3dof", "puma-600", "ralf-like")},
}


@pytest.fixture(params=HEAVY)
def arm(request: pytest.FixtureRequest) -> Arm:
    return HEAVY[request.param]


def equilibrium(model: Model, angles: Array) -> tuple[Array, Array]:
    """(n,) coordinates at rest with the joints held at (n_joint,) angles, and the torques."""
    joints = list(model.arm.joint_index)
    modal = np.setdiff1d(np.arange(model.n), joints)
    q = np.zeros(model.n)
    q[joints] = angles

    def forces(x: Array) -> Array:
        q[modal] = x
        return np.array(bias(model.chain, q.tolist(), model.n * [0.0]), dtype=np.float64)

    if modal.size:
        found = root(lambda x: forces(x)[modal], np.zeros(modal.size), tol=1e-12)
        assert found.success
        q[modal] = found.x
    return q, forces(q[modal])[joints]


def drawn_targets(arm: Arm, count: int) -> Array:
    """(count, n_joint) [rad] of the episodes of Reach."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GravityWarning)
        envs = FlexArmVectorEnv(count, task="Reach", arm=arm, max_episode_steps=10)
    envs.reset(seed=0)
    return envs.joint_target()


@pytest.mark.compiles
def test_every_drawn_target_can_be_held_by_the_default_torques(arm: Arm) -> None:
    """The torques of the bent arm, from the equilibrium of its own nonlinear model."""
    model, limit = Model(arm), np.array(scales(arm).torque_limit)
    for angles in drawn_targets(arm, 60):
        assert np.all(np.abs(equilibrium(model, angles)[1]) < limit)


def test_the_holding_torque_is_that_of_the_recursion_and_the_largest_of_many_postures(
    arm: Arm,
) -> None:
    rng, home = np.random.default_rng(1), np.array(scales(arm).home) - 0.4
    rigid, joints = RigidArm(arm), list(arm.joint_index)
    model = Model(arm)
    for angles in home + rng.uniform(-EXTENT, EXTENT, (5, arm.n_joint)):
        q = np.zeros(arm.n)
        q[joints] = angles
        force = np.array(bias(model.chain, q.tolist(), arm.n * [0.0]), dtype=np.float64)[joints]
        found = [rigid.torque(joint, angles[None])[0] for joint in range(arm.n_joint)]
        np.testing.assert_allclose(found, force, atol=1e-9 * (1.0 + np.abs(force).max()))
    many = home + rng.uniform(-EXTENT, EXTENT, (20_000, arm.n_joint))
    largest = [np.abs(rigid.torque(joint, many)).max() for joint in range(arm.n_joint)]
    holding = held(arm, home, EXTENT).torque
    assert np.all(holding >= np.array(largest) * (1.0 - 1e-9) - 1e-9)
    assert np.all(holding <= 1.05 * np.array(largest) + 1e-9)


def test_the_postures_contain_every_start_target_and_path_of_the_tasks() -> None:
    for task in TASKS.values():
        paths = 2.0 * MOVE if task.moving else 0.0  # two sines
        assert task.start[1] + task.moves[1] + paths <= EXTENT


def settled(arm: Arm, task: str = "Reach", **keywords: Any) -> FlexArmVectorEnv:
    """Environments after a reset; steps are given, since none is taken."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GravityWarning)
        envs = FlexArmVectorEnv(4, task=task, arm=arm, integrator="rk4", substeps=16, **keywords)
    envs.reset(seed=0)
    return envs


@pytest.mark.compiles
@pytest.mark.parametrize("name", ["own", "two in a vertical plane", "mamedov-3dof"])
def test_episodes_start_at_the_equilibrium_under_gravity(name: str) -> None:
    arm = HEAVY[name]
    model, envs = Model(arm), settled(arm)
    core, modal = envs.core, np.setdiff1d(np.arange(arm.n), arm.joint_index)
    observation, _ = envs.reset(seed=0)
    seen = observation[:, core.layout.slices["modal_amplitude"]]
    for row, q in enumerate(core.q):
        expected = equilibrium(model, q[list(arm.joint_index)])[0]
        np.testing.assert_allclose(q, expected, atol=1e-9, rtol=1e-9)
        amplitudes = seen[row] * core.layout.scales["modal_amplitude"]
        np.testing.assert_allclose(amplitudes, expected[modal], atol=1e-6)
    assert not core.v.any()
    assert [core.elapsed(row) for row in range(4)] == [0, 0, 0, 0]


@pytest.mark.compiles
def test_links_too_soft_for_an_equilibrium_start_straight() -> None:
    (link,) = load_arm(OWN).links
    soft = replace(load_arm(OWN), links=(replace(link, EIz=0.1), replace(link, EIz=0.1)))
    core = settled(soft, torque_limit=[20.0, 20.0]).core
    assert not core.q[:, np.setdiff1d(np.arange(soft.n), soft.joint_index)].any()
    assert np.isfinite(core.q).all()


@pytest.mark.compiles
def test_drawn_parameters_bend_the_arm_at_the_start() -> None:
    arm = HEAVY["two in a vertical plane"]
    ranges = {"stiffness": (0.5, 2.0), "payload_mass": (0.0, 0.1)}
    envs = settled(arm, randomize=ranges)
    for q, (stiffness, payload) in zip(envs.core.q, envs.core.parameters, strict=True):
        links = tuple(replace(x, EIz=stiffness * x.EIz) for x in arm.links)
        drawn = Model(with_parameters(replace(arm, links=links), {"payload_mass": payload}))
        angles = q[list(arm.joint_index)]
        tip = drawn.tip(equilibrium(drawn, angles)[0])
        assert np.linalg.norm(tip - envs.core.model.tip(q)) < 1e-5 * arm.reach


@pytest.mark.compiles
@pytest.mark.parametrize("stiffness", [6.0, 0.1])  # of links that settle, and too soft ones
def test_episodes_of_a_certificate_start_as_those_of_the_environment(stiffness: float) -> None:
    (link,) = load_arm(OWN).links
    arm = replace(load_arm(OWN), links=2 * (replace(link, EIz=stiffness),))
    core, joints = settled(arm, torque_limit=[20.0, 20.0]).core, list(arm.joint_index)
    for q in (core.q, Episodes.drawn(core, ["white"], 4, 2).q):
        straight = np.zeros_like(q)
        straight[:, joints] = q[:, joints]
        np.testing.assert_allclose(bent(core.model.traced, straight), q, atol=1e-12)
        assert np.array_equal(straight, q) == (stiffness < 1.0)


@pytest.mark.compiles
def test_torques_that_hold_the_start_keep_it_there() -> None:
    arm = HEAVY["own"]
    envs, model = settled(arm), Model(arm)
    start = envs.core.q.copy()
    torque = np.array([equilibrium(model, q[list(arm.joint_index)])[1] for q in start])
    for _ in range(20):
        envs.step((torque / envs.torque_limit).astype(np.float32))
    assert np.abs(envs.core.q - start).max() < 1e-5  # torques are rounded to single precision


@pytest.mark.compiles
def test_links_vibrate_about_the_equilibrium() -> None:
    arm = HEAVY["own"]
    model, shapes = Model(arm), np.array(scales(arm).vibration)
    for q in settled(arm, "Damp").core.q:
        vibration = (q - equilibrium(model, q[:1])[0])[1:]
        share, left = np.linalg.lstsq(shapes.T, vibration, rcond=None)[:2]
        assert 0.0 < np.abs(share).max() <= 0.6
        assert left.max(initial=0.0) < 1e-18


@pytest.mark.compiles
def test_a_given_state_stays_as_it_is() -> None:
    envs = settled(HEAVY["own"])
    given = np.tile((0.1, 0.002, -0.001), (4, 1))
    envs.reset(options={"state": {"q": given}})
    np.testing.assert_array_equal(envs.core.q, given)


@pytest.mark.compiles
def test_an_episode_that_follows_another_starts_at_the_equilibrium() -> None:
    arm = HEAVY["own"]
    envs = settled(arm, max_episode_steps=2)
    for _ in range(3):  # the third step starts the next episode
        envs.step(np.zeros((4, 1), np.float32))
    model = Model(arm)
    for q in envs.core.q:
        np.testing.assert_allclose(q, equilibrium(model, q[:1])[0], atol=1e-9)


@pytest.mark.compiles
@pytest.mark.parametrize("name", ["own", "two in a vertical plane"])
def test_targets_are_held_in_motion_against_a_push(name: str) -> None:
    """Joint PD and the static torque bring the arm back to rest from 0.03 rad beside the target."""
    arm, count = HEAVY[name], 8
    model, targets = Model(arm), drawn_targets(arm, 8)
    rest = [equilibrium(model, angles) for angles in targets]
    first = 2.0 * np.pi / scales(arm).locked[0]
    envs = FlexArmVectorEnv(
        count, task="Reach", arm=arm, control_dt=first / 50.0, deflection_limit=1.0
    )
    start = np.array([q for q, _ in rest])
    start[:, list(arm.joint_index)] += 0.03
    observation, _ = envs.reset(options={"state": {"q": start}, "target": targets})
    pd = joint_pd(envs, 0.4, 0.7)
    static = np.array([torque for _, torque in rest]) / envs.torque_limit
    for _ in range(1_000):
        action = pd.predict(observation)[0] + static
        observation, _, terminated, _, _ = envs.step(action)
        assert not terminated.any()
    held_tips = np.array([model.tip(q) for q, _ in rest])
    now = np.array([model.tip(q) for q in envs.core.q])
    assert np.linalg.norm(now - held_tips, axis=1).max() < 1e-3 * arm.reach


def test_arms_without_gravity_keep_their_limits_and_motion_has_all_of_them() -> None:
    for name in ("slim", "two-link", "six-link", "free-flyer"):
        found = scales(ARMS[name])
        assert not any(found.holding)
        assert found.sag == 0.0
        np.testing.assert_array_equal(found.motion_torque, found.torque_limit)


def test_sag_and_motion_at_full_torque_stay_valid_together() -> None:
    arm = HEAVY["own"]
    weightless = replace(arm, gravity=(0.0, 0.0, 0.0))
    share = scales(arm).motion_torque[0] / scales(weightless).motion_torque[0]
    tip = equilibrium(Model(arm), np.zeros(1))[0]  # level: the largest sag
    bent = abs(Model(arm).tip(tip)[1]) / 0.8 / DEFLECTION_LIMIT
    assert bent == pytest.approx(0.63, abs=0.03)  # with l^3 / 3 EI: (0.15 + 3/8 0.096) g 0.0284
    assert share + bent <= 1.0


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"torque_limit": 1.5}, r"torque_limit of joint 1 must exceed the 1\.55 N m .* got 1\.5"),
        ({"actuator": {"type": "limited", "torque_limit": 1.0}},
         r"actuator of joint 1 must exceed the 1\.55 N m"),
    ],
)  # fmt: skip
def test_torques_that_hold_no_level_target_are_refused(
    keywords: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        gym.make("FlexArm/OneLink-Reach-v0", arm=OWN, **keywords)


@pytest.mark.compiles
def test_drawn_payloads_that_are_too_heavy_to_hold_warn() -> None:
    heavy = {"randomize": {"payload_mass": (0.0, 1.0)}}
    with pytest.warns(GravityWarning, match=r"A payload_mass of 1 kg, .* joint 1 .* torque_limit"):
        gym.make("FlexArm/OneLink-Reach-v0", arm=OWN, **heavy)
    with warnings.catch_warnings():
        warnings.simplefilter("error", GravityWarning)
        light = gym.make(
            "FlexArm/OneLink-Reach-v0", arm=OWN, randomize={"payload_mass": (0.0, 0.02)}
        )
    with pytest.warns(GravityWarning, match=r"A payload_mass of 1 kg"):
        light.unwrapped.randomize = heavy["randomize"]  # type: ignore[attr-defined]


@pytest.mark.compiles
def test_a_link_that_gravity_bends_beyond_its_limit_warns() -> None:
    with pytest.warns(
        GravityWarning, match=r"Gravity alone bends a link by 0\.11 .* is 0\.1\. Give"
    ):
        gym.make("FlexArm/OneLink-Reach-v0", arm="mamedov-3dof")
    with warnings.catch_warnings():
        warnings.simplefilter("error", GravityWarning)
        gym.make("FlexArm/OneLink-Reach-v0", arm="mamedov-3dof", deflection_limit=0.2)


def test_a_joint_about_the_vertical_needs_no_holding_torque() -> None:
    link = Link(length=1.0, rho_A=0.5, EIz=20.0, modes="auto", joint=Joint(rotor_inertia=0.1))  # type: ignore[arg-type]
    level = Arm(links=(link,), gravity=(0.0, 0.0, -9.81))
    assert scales(level).holding == (0.0,)
    assert (
        scales(level).torque_limit == scales(replace(level, gravity=(0.0, 0.0, 0.0))).torque_limit
    )
    assert flexarm_env.IDS  # the ids are registered
