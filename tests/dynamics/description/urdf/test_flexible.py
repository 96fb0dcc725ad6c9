"""Links that bend: the beams of a converted robot."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Model, load_arm
from dynamics.formulations.gibbs_appell import mass_matrix
from tests.dynamics.description.urdf.robots import (
    PUBLIC,
    ROD,
    assert_close,
    joint,
    link,
    loaded,
    one_rod,
    public,
    robot,
)

STIFF = {"EIz": 3.0e3, "EIy": 2.0e3, "GJ": 1.0e3}
BENT = [  # a link across its joint's axis, tilted against it and along it; links in front of a hand
    ("ur5", ["forearm_link"]),
    ("ur5", ["upper_arm_link"]),
    ("gen3", ["Shoulder_Link", "HalfArm2_Link"]),
    ("gen3", ["Bracelet_Link", "ForeArm_Link"]),
    ("panda", ["panda_link4", "panda_link3"]),
    ("panda", ["panda_link7"]),
    ("panda", ["panda_hand"]),
]


def as_rods(text: str, ends: dict[str, np.ndarray]) -> str:
    """The file, with uniform rods in place of the inertias of links that end at `ends` [m]."""
    top = ElementTree.fromstring(text)
    for element in top.findall("link"):
        name = element.get("name")
        if name not in ends or element.find("inertial") is None:
            continue
        inertial = element.find("inertial")
        mass, old = float(inertial.find("mass").get("value")), inertial.find("inertia")
        keys = ("xx", "xy", "xz", "yy", "yz", "zz")
        xx, xy, xz, yy, yz, zz = (float(old.get(f"i{key}")) for key in keys)
        length = float(np.linalg.norm(ends[name]))
        x = ends[name] / length
        polar = x @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ x
        tensor = polar * np.outer(x, x) + mass * length**2 / 12.0 * (np.eye(3) - np.outer(x, x))
        inertial.find("origin").set("xyz", " ".join(map(repr, (0.5 * ends[name]).tolist())))
        for key in keys:
            row, column = ("xyz".index(axis) for axis in key)
            old.set(f"i{key}", repr(float(tensor[row, column])))
    return ElementTree.tostring(top, encoding="unicode")


def ends_of(text: str, tip: str, names: list[str]) -> dict[str, np.ndarray]:
    """(3,) [m] place of the next joint of the chain to a tip, in the frame of each link."""
    joints = {j.find("child").get("link"): j for j in ElementTree.fromstring(text).findall("joint")}
    found = {}
    while tip in joints:
        parent = joints[tip].find("parent").get("link")
        if parent in names:
            found[parent] = np.array(
                [float(x) for x in joints[tip].find("origin").get("xyz").split()]
            )
        tip = parent
    return found


@pytest.mark.compiles
@pytest.mark.parametrize(("name", "names"), BENT)
def test_straight_beams_are_the_robot_with_rods_for_links(
    name: str, names: list[str], tmp_path: Path
) -> None:
    """Joints' mass matrix, weight and tip of the arm whose beams are straight.

    Without the beams, it is Pinocchio's (test_against_pinocchio.py).
    """
    text, tip = public(name).read_text(encoding="utf-8"), PUBLIC[name]
    rods = Model(loaded(tmp_path, as_rods(text, ends_of(text, tip, names)), tip=tip))

    arm = loaded(tmp_path, text, tip=tip, flexible=dict.fromkeys(names, STIFF))

    bent, at = Model(arm), list(arm.joint_index)
    angles = np.random.default_rng(5).uniform(-2.0, 2.0, rods.n)
    q = np.zeros(arm.n)
    q[at] = angles
    assert arm.n > rods.n
    M, expected = mass_matrix(bent.chain, q.tolist()), mass_matrix(rods.chain, angles.tolist())
    assert_close(np.array(M)[np.ix_(at, at)], expected)
    weight = bent.inverse_dynamics(q, 0.0 * q, 0.0 * q)[at]
    assert_close(weight, rods.inverse_dynamics(angles, 0.0 * angles, 0.0 * angles))
    assert_close(bent.tip(q), rods.tip(angles))


@pytest.mark.parametrize(
    ("axis", "joints", "root"), [("0 0 1", "free", 3.9266), ("1 0 1", "locked", 1.8751)]
)
def test_a_rod_has_the_frequencies_of_books(
    axis: str, joints: str, root: float, tmp_path: Path
) -> None:
    """Pinned at a joint across it, and clamped to the hub of a joint that is not."""
    text = one_rod(content=f'<axis xyz="{axis}"/>')
    model = Model(loaded(tmp_path, text, flexible={"rod": {"EIz": 6.0}}))
    speeds = model.frequencies(np.zeros(model.n), joints=joints)
    assert speeds[speeds > 1e-3][0] == pytest.approx(
        root**2 * math.sqrt(6.0 / (2.5 * 0.8**4)), rel=1e-4
    )


@pytest.mark.parametrize(
    ("axis", "next_axis", "along_y"),
    [
        ("0 0 1", "0 0 1", (0, 1, 0)),  # in the plane in which the joint turns
        ("0 1 0", "0 0 1", (0, 0, -1)),
        ("1 0 0", "0 0 1", (0, 1, 0)),  # along its axis: in the plane of the next joint
        ("1 0 0", "1 0 0", (1, 0, 0)),  # beside both: any
    ],
)
def test_EIz_bends_in_the_plane_of_the_joint(
    axis: str, next_axis: str, along_y: tuple[int, ...], tmp_path: Path
) -> None:
    text = robot(
        *map(link, ("base", "rod", "next")),
        joint("base", "rod", f'<axis xyz="{axis}"/>'),
        joint("rod", "next", f'<axis xyz="{next_axis}"/>', xyz="0.8 0 0"),
    )
    arm = loaded(tmp_path, text, flexible={"rod": {"EIz": 6.0, "modes": [
        {"kind": "clamped-free", "index": 1, "direction": "y"}]}})  # fmt: skip
    q = np.zeros(arm.n)
    q[[name.startswith("d") for name in arm.names].index(True)] = 1e-6
    moved = (Model(arm).tip(q) - Model(arm).tip(0.0 * q)) / 1e-6
    if along_y == (1, 0, 0):
        assert abs(moved[0]) < 1e-5
        assert np.linalg.norm(moved) == pytest.approx(1.0, rel=1e-5)
    else:
        assert_allclose(moved, along_y, atol=1e-5)


def test_a_last_link_ends_at_a_frame_or_where_the_user_says(tmp_path: Path) -> None:
    bare = robot(link("base", ""), link("rod"), joint("base", "rod"))
    said = loaded(tmp_path, bare, flexible={"rod": {"EIz": 6.0, "tip": [0.8, 0, 0]}})
    assert said == loaded(tmp_path, one_rod(), flexible={"rod": {"EIz": 6.0}})
    assert said.links[0].rho_A == pytest.approx(2.5)
    assert said.links[0].rho_Ip == pytest.approx(0.001 / 0.8)


def test_fields_of_a_link_replace_those_of_the_file(tmp_path: Path) -> None:
    stated = {"EIz": 6.0, "rho_A": 0.5, "rho_Ip": 0.0, "tip_mass": 0.2, "damping_ratio": 0.01}
    (beam,) = loaded(tmp_path, one_rod(), flexible={"rod": {**stated, "modes": []}}).links
    assert {key: getattr(beam, key) for key in stated} == stated
    assert beam.modes == ()


@pytest.mark.parametrize("own", [ROD, ""])
def test_sections_replace_the_mass_of_the_file(own: str, tmp_path: Path) -> None:
    sections = [
        {"length": 0.5, "rho_A": 1.0, "EIz": 6.0},
        {"length": 0.3, "rho_A": [0.8, 0.4], "EIz": [4.0, 1.0]},
    ]
    text = one_rod().replace(ROD, own)
    arm = loaded(tmp_path, text, flexible={"rod": {"sections": sections}})
    assert arm == load_arm({**arm.to_dict(), "links": [{"modes": "auto", "sections": sections}]})


@pytest.mark.parametrize(("place", "links"), [("0.1 0.05 0", 1), ("0.7 0.05 0", 2)])
def test_a_body_beside_the_chain_is_fixed_to_the_nearer_end(
    place: str, links: int, tmp_path: Path
) -> None:
    """Of its centre of mass: a motor to the root, a gripper to the tip, which it bends with."""
    ball = '<inertial><mass value="0.3"/></inertial>'
    text = one_rod().replace(
        "</robot>", link("ball", ball) + joint("rod", "ball", type="fixed", xyz=place) + "</robot>"
    )
    arm = loaded(tmp_path, text, tip="end", flexible={"rod": {"EIz": 6.0}})
    assert len(arm.links) == links
    (body,) = (x.body for x in arm.links if x.body)
    assert (body, body.mass) == (arm.links[-1].body, 0.3)
    expected = np.array([float(x) for x in place.split()]) - (0.8 * (links == 2), 0.0, 0.0)
    assert_allclose(body.com, expected, atol=1e-15)


def test_a_warning_says_what_a_beam_does_not_keep(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(one_rod().replace(ROD, ROD.replace("0.4 0 0", "0.3 0 0.1")), encoding="utf-8")
    sentence = (
        r"robot.urdf, not taken over: link 'rod' is a beam of 0.8 m: the mass of 2 kg is spread "
        r"evenly, its centre is the beam's \(it was 0.3 m along it and 0.1 m beside it\)"
    )
    with pytest.warns(UserWarning, match=sentence):
        load_arm(path, flexible={"rod": {"EIz": 6.0}})
