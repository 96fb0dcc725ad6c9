"""Environments of arms with joint springs and parallel drives; prismatic joints are refused."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env  # noqa: F401
from dynamics import ARMS, Arm, Joint, Link, Mode, simulate
from flexarm_env.core import Core
from flexarm_env.rendering import Renderer

ID = "FlexArm/OneLink-Reach-v0"


def sprung(link: Link, stiffness: float = 50.0) -> Arm:
    joint = replace(link.joint, stiffness=stiffness, spring_damping=0.01, rotor_inertia=0.02)
    return Arm(links=(replace(link, joint=joint),))


(SLIM,) = ARMS["slim"].links
RIGID = replace(SLIM, modes=(), damping_ratio=0.0)


@pytest.mark.parametrize("link", [SLIM, RIGID], ids=["flexible link", "rigid link"])
def test_encoders_read_the_rotor_of_a_sprung_joint(link: Link) -> None:
    """The spring twists under torque; the joint state is that of the rotor alone."""
    env = gym.make(ID, arm=sprung(link), render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(10):
        env.step(env.action_space.high)
    core = env.unwrapped.core  # type: ignore[attr-defined]

    angles, rates = core.joint_state()

    assert core.model.names[:2] == ["q1", "s1"]
    assert abs(core.q[0, 1]) > 1e-4
    assert np.array_equal(angles[0], core.q[0, :1])
    assert np.array_equal(rates[0], core.v[0, :1])
    assert env.render().std() > 0.0


def test_a_link_behind_a_joint_spring_is_drawn_at_its_place() -> None:
    """The kinematics of the picture rotates the link by rotor and spring twist."""
    core = Core(task="Reach", arm=sprung(SLIM))
    q = np.array([0.7, -0.4, 0.03, 0.001])
    drawn = Renderer(core).shapes(core, q, 1.0)[-1][-1]
    np.testing.assert_allclose(drawn, core.model.tip(q), atol=1e-12)


def test_an_arm_with_a_parallel_drive_is_drawn_at_its_place() -> None:
    core = Core(task="Reach", arm="ralf-like")
    q = np.array([0.7, 0.2, -0.1, -0.4, 0.15, 0.1])
    drawn = Renderer(core).shapes(core, q, 1.0)
    np.testing.assert_allclose(drawn[-1][-1], core.model.tip(q), atol=1e-12)


def test_an_arm_with_a_parallel_drive_moves_as_its_model_does() -> None:
    """Full torque on the second motor alone, against an error-controlled simulation."""
    env = gym.make(ID, arm="ralf-like", control_dt=0.02)
    env.reset(seed=0, options={"state": {"q": [0.2, 0, 0, 0.9, 0, 0], "v": [0.0] * 6}})
    core = env.unwrapped.core  # type: ignore[attr-defined]
    q, v, torque = core.q[0].copy(), core.v[0].copy(), np.array([0.0, core.torque_limit[1]])
    for _ in range(10):
        env.step(np.array([0.0, 1.0], np.float32))

    path = simulate(core.model, q, v, lambda t: torque, np.array([0.0, 0.2]), rtol=1e-9)

    np.testing.assert_allclose(core.q[0], path.q[-1], rtol=0.0, atol=1e-3)
    assert np.abs(core.q[0] - q).min() > 1e-4


def test_torque_limits_of_a_sprung_rigid_arm_are_those_of_the_rigid_arm() -> None:
    """A spring may twist by any angle, so no deflection bounds the torque."""
    rigid = replace(RIGID, joint=replace(RIGID.joint, rotor_inertia=0.02))
    found, expected = (
        gym.make(ID, arm=arm).unwrapped.core.torque_limit  # type: ignore[attr-defined]
        for arm in (sprung(RIGID), Arm(links=(rigid,)))
    )
    assert np.array_equal(found, expected)


def test_an_arm_with_a_prismatic_joint_is_refused() -> None:
    with pytest.raises(ValueError, match="joint 3 is prismatic"):
        gym.make(ID, arm="stanford")


def loose(kind: str, segments: int = 1, count: int = 2) -> Arm:
    """A link on a rotor so light that its root turns with its bending."""
    modes = tuple(Mode(kind=kind, index=k + 1, direction="y") for k in range(count))
    link = Link(length=1.0, rho_A=0.5, EIz=20.0, damping_ratio=0.01, modes=modes,
                segments=segments, joint=Joint(rotor_inertia=5e-4))  # fmt: skip
    return Arm(links=(link,))


@pytest.mark.parametrize("obs", ["state", "sensors"])
def test_encoders_read_the_root_that_pinned_modes_turn(obs: str) -> None:
    """Beside the same link in segments, whose joint angle is that of its root."""
    angles = []
    for arm in (loose("pinned-free", count=4), loose("hierarchical", 3, 3)):
        keywords = {"arm": arm, "control_dt": 0.005, "torque_limit": 0.4, "deflection_limit": 1.0}
        env: Any = gym.make(ID, obs=obs, **keywords)
        env.reset(seed=0, options={"target": [0.0]})
        base = env.unwrapped
        for k in range(120):
            observation = env.step([np.sin(2.0 * np.pi * k * 0.005 / 0.3)])[0]
            angles.append(base.joint_state()[0].item())
            if obs == "sensors":
                read = observation[0] * base.core.layout.scales["joint_error"][0]
                assert read == pytest.approx(angles[-1], abs=1e-5)  # the target is at zero
    pinned, exact = np.reshape(angles, (2, -1))
    assert np.abs(pinned - exact).max() < 0.03 * np.ptp(exact)


def test_links_that_are_straight_at_the_root_have_no_strain_gauge() -> None:
    pinned, other = loose("pinned-free"), loose("unconstrained")

    def make(arm: Arm, **more: Any) -> Any:
        return gym.make(ID, arm=arm, control_dt=0.02, obs="sensors", **more)

    layouts = [make(arm).unwrapped.core.layout.slices for arm in (pinned, other)]
    assert ["root_curvature" in slices for slices in layouts] == [False, True]
    with pytest.raises(ValueError, match="needs a link that bends at its root"):
        make(pinned, curvature_limit=0.1)
