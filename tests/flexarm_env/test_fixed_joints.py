"""An environment of an arm with a fixed joint, a root beside its joint and a payload beyond."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from dynamics import ARMS, Arm, Body, Joint, Link, load_arm
from flexarm_env import TASKS
from flexarm_env.hardware.sensors import load_hardware
from flexarm_env.rendering import Renderer
from flexarm_env.task.observations import observation_layout
from flexarm_env.task.scales import scales

BEND = {"kind": "clamped-tip-mass", "index": 1, "direction": "y"}
LINK = {"length": 0.4, "rho_A": 0.12, "EIz": 6.0, "modes": [BEND]}
BENT = [[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]
ARM = {
    "links": [
        {**LINK, "joint": {"rotor_inertia": 0.02, "root": [0.05, 0.02, 0.0]}},
        {**LINK, "joint": {"type": "fixed", "rotation": BENT, "offset": [0.03, 0.0, 0.0]}},
        {**LINK, "joint": {"rotor_inertia": 0.01}},
    ],
    "payload": {"mass": 0.1, "com": [0.05, 0.0, 0.0]},
}


def test_an_environment_moves_and_draws_links_on_a_fixed_joint() -> None:
    env = gym.make("FlexArm/TwoLink-Reach-v0", arm=ARM, control_dt=0.02).unwrapped
    core = env.core
    observation, _ = env.reset(seed=0)
    assert env.action_space.shape == env.torque_limit.shape == (2,)
    assert {part.name: len(part.entries) for part in core.layout.parts}["modal_amplitude"] == 3

    for _ in range(20):
        observation, _, terminated, _, info = env.step(np.array([0.3, -0.2], dtype=np.float32))

    assert np.isfinite(observation).all()
    assert not terminated
    q = core.q[0]
    assert np.all(np.abs(q) > 1e-6)
    lines = Renderer(core).shapes(core, q, 1.0)
    assert lines[-1][-1] == pytest.approx(core.model.tip(q), abs=1e-12)
    assert info["root_curvature"].shape == (3,)


@pytest.mark.parametrize("stiffness", [None, 40.0], ids=["welded", "a clamp that gives"])
@pytest.mark.parametrize("modes", [[], [BEND]], ids=["rigid", "bends"])
def test_the_first_angle_is_observed_where_what_carries_the_joint_moves(
    modes: list[dict[str, object]], stiffness: float | None
) -> None:
    """Otherwise an arm without gravity moves alike at every angle of its first joint."""
    ground = {**LINK, "modes": modes, "joint": {"type": "fixed", "stiffness": stiffness}}
    arm = load_arm({"links": [ground, {**LINK, "joint": {"rotor_inertia": 0.02}}]})
    for obs in ("state", "sensors"):
        slices = observation_layout(arm, TASKS["Reach"], obs, scales(arm), 1.0).slices
        assert ("joint_sin" in slices) == bool(modes or stiffness)


def test_an_arm_without_a_moving_joint_is_refused() -> None:
    still = {"links": [{**LINK, "joint": {"type": "fixed"}}]}
    with pytest.raises(ValueError, match="with a joint that turns, got only fixed joints"):
        gym.make("FlexArm/OneLink-Reach-v0", arm=still, control_dt=0.02)


@pytest.mark.parametrize("height", [0.0, 0.3])
def test_an_arm_whose_tip_no_joint_moves_is_refused(height: float) -> None:
    """Its tip is on the axes of all joints: of a wheel, of an arm that ends at its wrist."""
    wheel = {"length": 0.0, "body": {"mass": 1.0, "com": [0.1, 0.0, 0.0]}}
    turned = {"rpy": [0.5, 0.3, 0.0]}
    first = {**wheel, "joint": {"offset": [0.0, 0.0, height]}}
    arm = {"links": [first, {**wheel, "joint": {"rotation": turned}}]}
    with pytest.raises(
        ValueError, match=r"one on the axes of all joints; .* \(Link.length is 0.0\)"
    ):
        gym.make("FlexArm/TwoLink-Reach-v0", arm=arm, control_dt=0.02)


def test_a_payload_is_a_share_of_the_body_that_a_last_link_carries() -> None:
    """Laboratories draw it, and it drops in mid-episode."""
    carried = Link(length=0.0, body=Body(mass=0.5, com=(0.03, 0.0, 0.0)), joint=Joint(type="fixed"))
    arm = Arm(links=(*ARMS["slim"].links, carried))
    drop = gym.make("FlexArm/OneLink-Track-v0", arm=arm, control_dt=0.02, event="drop")
    assert drop.unwrapped.randomize["payload_mass"] == (0.125, 0.25)  # type: ignore[attr-defined]
    laboratory = load_hardware("laboratory")
    assert laboratory is not None
    assert laboratory.spread(arm)["payload_mass"] == (0.0, 0.25)
    nothing = replace(carried, body=Body(mass=0.0, inertia=np.eye(3)))
    with pytest.raises(ValueError, match="event 'drop' needs a last link with a mass"):
        gym.make("FlexArm/OneLink-Track-v0", arm=replace(arm, links=(arm.links[0], nothing)),
                 control_dt=0.02, event="drop")  # fmt: skip
