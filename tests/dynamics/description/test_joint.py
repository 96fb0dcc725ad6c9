"""Joints of every type: what they may have, and sentences of refusals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamics import ARMS, Arm, Body, Joint, Link, Mode, Model, Payload, load_arm
from dynamics.formulations.gibbs_appell import mass_matrix

BEND = {"kind": "clamped-free", "index": 1, "direction": "y"}
PINNED = {**BEND, "kind": "pinned-free"}
LINK: dict[str, Any] = {"length": 0.5, "rho_A": 0.2, "EIz": 3.0, "modes": [BEND]}


def arm(*links: dict[str, Any], **values: Any) -> Arm:
    return load_arm({"links": [{**LINK, **link} for link in links], **values})


@pytest.mark.parametrize(
    ("links", "sentence"),
    [
        ([{"joint": {"type": "fixed", "rotor_inertia": 0.1}}], "rotor_inertia .0.1. needs a joint"),
        ([{"joint": {"type": "fixed", "viscous": 0.1}}], "viscous .0.1. needs a joint that moves"),
        ([{"joint": {"type": "fixed", "parallel": True}}], "parallel .True. needs a joint"),
        ([{"joint": {"type": "welded"}}], "Joint.type must be one of"),
        (
            [{"joint": {"rotation": [0.1, 0, 3]}}],
            r"got three numbers; write \{rpy: \[0.1, 0, 3\]\} .* or \{axis: .*, angle: a\}",
        ),
        ([{"joint": {"rotation": {"rpy": [0, 1]}}}], "rotation.rpy must have 3 numbers, got 2"),
        ([{"joint": {"rotation": {"rpy": [0, 0, 90]}}}], r"rpy must be in radians, .* are 1.5708"),
        ([{"joint": {"rotation": {"axis": [0, 0, 1], "angle": -90}}}], "angle must be in radians"),
        ([{"joint": {"rotation": {"axis": [0, 0, 1]}}}], r"rpy, or axis and angle, got \['axis'\]"),
        (
            [{"joint": {"rotation": {"axis": [0, 0, 0], "angle": 1.0}}}],
            "axis must have a direction",
        ),
        ([{"joint": {"rotation": {"euler": [0, 0, 0]}}}], "Unknown key 'euler' in Joint.rotation"),
        ([{"joint": {"root": [0.1, 0.0]}}], "Joint.root must have 3 numbers, got 2"),
        ([{"modes": [PINNED], "joint": {"root": [0.1, 0, 0]}}], "pinned-free with Joint.root"),
        ([{"modes": [PINNED], "joint": {"type": "fixed"}}], "pinned-free with a fixed joint"),
        ([{"modes": [PINNED], "body": {"mass": 1.0}}], "pinned-free beside Link.body"),
        ([{"length": 0.0, "body": {"mass": 1.0}}], "Link.length must be positive, got 0.0"),
        ([{"rho_A": 0.0, "modes": "auto", "body": {"mass": 1.0}}], "Link.rho_A must be positive"),
        ([{"modes": [], "segments": 2, "body": {"mass": 1.0}}], "Link.segments .2. must be 1"),
    ],
)
def test_refusals_name_the_field_and_the_remedy(links: list[dict[str, Any]], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        arm(*links)


@pytest.mark.parametrize("angles", [(0.3, -0.4, 0.5), (np.pi / 2, 0.0, 0.0), (0.0, 0.0, -2.0)])
def test_angles_and_axes_give_the_matrices_of_scipy(angles: tuple[float, float, float]) -> None:
    """Roll, pitch and yaw about fixed axes; the same turn about its one axis, of any length."""
    turn = Rotation.from_euler("xyz", angles)
    axis = 3.0 * turn.as_rotvec() / turn.magnitude()
    by_angles = Joint(rotation={"rpy": angles})  # type: ignore[arg-type]
    described = {"axis": axis.tolist(), "angle": turn.magnitude()}
    (by_axis,) = arm({"joint": {"rotation": described}}).links
    np.testing.assert_allclose(by_angles.rotation, turn.as_matrix(), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(by_axis.joint.rotation, turn.as_matrix(), rtol=0.0, atol=1e-15)


def test_a_turn_about_z_leaves_an_arm_planar() -> None:
    turned = arm({}, {"joint": {"rotation": {"rpy": [0.0, 0.0, 0.7]}}})
    assert turned.links[1].joint.rotation[2] == (0.0, 0.0, 1.0)


def test_a_matrix_with_round_off_is_a_turn_about_z_too() -> None:
    """A planar arm observes no height, and a parallel drive takes no other turns."""
    turn = Rotation.from_euler("z", 0.5).as_matrix()
    turn[2, 2] = 1.0 - 1e-16
    driven = arm({}, {"joint": {"rotation": turn.tolist(), "parallel": True}})
    assert driven.links[1].joint.rotation[2] == (0.0, 0.0, 1.0)


def test_a_fixed_joint_has_neither_coordinate_nor_torque() -> None:
    described = arm({}, {"joint": {"type": "fixed"}}, {})
    assert described.names == ("q1", "d1_1", "d2_1", "q3", "d3_1")
    assert (described.n_joint, described.n_torque, described.joints) == (2, 2, (0, 2))
    assert described.joint_index == (0, 3)
    assert load_arm(described.to_dict()) == described


def test_a_mass_behind_a_fixed_joint_is_inertia_enough() -> None:
    bare = {"length": 0.0, "rho_A": 0.0, "EIz": None, "modes": [], "body": {"mass": 0.0}}
    with pytest.raises(ValueError, match="no inertia about its joint axis"):
        arm({}, bare)
    assert arm({}, bare, {"joint": {"type": "fixed"}}).n_joint == 2


def test_an_arm_may_end_in_a_frame_without_mass() -> None:
    frame = {
        "length": 0.1, "rho_A": 0.0, "EIz": None, "modes": [], "body": {"mass": 0.0},
        "joint": {"type": "fixed"},
    }  # fmt: skip
    ended, longer = arm({}), arm({}, frame)
    q = np.full(ended.n, 0.1)
    M = mass_matrix(Model(longer).chain, q.tolist())
    np.testing.assert_allclose(M, mass_matrix(Model(ended).chain, q.tolist()), atol=1e-14)
    assert np.linalg.norm(Model(longer).tip(q) - Model(ended).tip(q)) == pytest.approx(0.1)


def test_an_arm_of_fixed_joints_is_a_structure_with_frequencies() -> None:
    cantilever = arm({"modes": "auto", "joint": {"type": "fixed"}})
    held = arm({"modes": "auto", "joint": {"rotor_inertia": 0.1}})
    assert cantilever.n_joint == 0
    np.testing.assert_allclose(Model(cantilever).frequencies(), Model(held).frequencies())


def test_modes_by_rule_are_clamped_beside_a_root_or_a_body() -> None:
    light: dict[str, Any] = {"modes": "auto", "joint": {}}
    assert arm(light).links[0].modes[0].kind == "unconstrained"
    for changes in (
        {"joint": {"root": [0.02, 0.0, 0.0]}},
        {"joint": {"type": "fixed"}},
        {"body": {"mass": 0.1}},
    ):
        (link,) = arm({**light, **changes}).links
        assert {mode.kind for mode in link.modes} == {"clamped-tip-mass"}


def test_unconstrained_shapes_take_the_bodys_inertia_as_the_hubs() -> None:
    modes = (Mode(kind="unconstrained", index=1, direction="y"),)
    body = Body(mass=2.0, com=(0.0, 0.1, 0.5), inertia=np.diag([9.0, 9.0, 0.03]))
    link = Link(length=0.5, rho_A=0.2, EIz=3.0, modes=modes, body=body)
    hub = replace(link, body=None, joint=Joint(hub_inertia=0.03 + 2.0 * 0.1**2))
    found, wanted = (Model(Arm(links=(x,))).frequencies(joints="free") for x in (link, hub))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_a_payload_at_the_tip_has_its_inertia_about_the_tip() -> None:
    slim = ARMS["slim"]
    about = np.diag([0.001, 0.002, 0.003])
    beyond = Payload(mass=0.3, com=(0.1, 0.0, 0.0), inertia=about)
    at_tip = replace(slim.links[0], tip_mass=slim.links[0].tip_mass + 0.3)
    q = np.zeros(slim.n)
    M = Model(replace(slim, payload=beyond)).mass_matrix(q)
    point = Model(replace(slim, links=(at_tip,))).mass_matrix(q)
    length = slim.links[0].length
    added = 0.3 * ((length + 0.1) ** 2 - length**2) + 0.003
    assert M[0, 0] - point[0, 0] == pytest.approx(added, rel=1e-10)
