"""Denavit-Hartenberg tables, Newton-Euler inverse dynamics, and round trips of planned motions."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ARMS, Arm, Base, Body, Joint, Link, Model, load_arm, simulate
from dynamics.description.denavit_hartenberg import Row, arm, links
from dynamics.formulations.newton_euler import inverse_dynamics, rigid_links
from dynamics.simulation.nominal_motion import Cycloidal, NominalTorque, stiffened
from dynamics.types import Array
from tests.dynamics.random_arms import compiled, floats, random_arm, random_state

TABLE = (
    Row(a=0.3, d=0.2, alpha=0.7, theta=-0.4, mass=1.0, com=(0.1, 0.0, 0.05)),
    Row(a=-0.2, d=-0.3, alpha=-1.9, theta=0.9, type="prismatic", mass=2.0),
    Row(a=0.25, d=0.1, alpha=np.pi / 2, mass=0.5, inertia=np.diag([0.1, 0.2, 0.25])),
)


def screw(axis: int, angle: float, shift: float) -> Array:
    """(4, 4) rotation about and translation along x (0) or z (2)."""
    c, s = np.cos(angle), np.sin(angle)
    T = np.eye(4)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    T[j, j], T[j, k], T[k, j], T[k, k] = c, -s, s, c
    T[axis, 3] = shift
    return T


def test_a_table_is_a_product_of_screws() -> None:
    """Rot_x(alpha) Trans_x(a) Rot_z(theta) Trans_z(d), row by row; the last a leads to the tip."""
    described = arm(TABLE)
    q = np.array([0.8, 0.35, -1.2])
    T, alpha, a = np.eye(4), 0.0, 0.0
    for row, x in zip(TABLE, q, strict=True):
        turn, slide = (x, 0.0) if row.type == "revolute" else (0.0, x)
        T = T @ screw(0, alpha, a) @ screw(2, row.theta + turn, row.d + slide)
        alpha, a = row.alpha, row.a

    assert_allclose(Model(described).tip(q), (T @ (a, 0.0, 0.0, 1.0))[:3], atol=1e-14)


def test_right_angles_leave_exact_zeros() -> None:
    for name in ("stanford", "puma-600"):
        entries = [x for k in ARMS[name].links for row in k.joint.rotation for x in row]
        places = [x for k in ARMS[name].links for x in k.joint.offset]
        assert set(entries) <= {-1.0, 0.0, 1.0}
        assert min(abs(x) for x in places if x) > 1e-3


def test_an_arm_file_may_hold_a_table() -> None:
    rows = [
        {"a": 0.3, "alpha": 0.7, "mass": 1.0, "com": [0.1, 0, 0]},
        {"type": "prismatic", "mass": 2},
    ]
    data: dict[str, Any] = {"name": "tabulated", "denavit_hartenberg": rows}

    found = load_arm(data)

    expected = (
        Row(a=0.3, alpha=0.7, mass=1.0, com=(0.1, 0.0, 0.0)),
        Row(type="prismatic", mass=2.0),
    )
    assert found == arm(expected, name="tabulated")
    assert load_arm(json.loads(json.dumps(found.to_dict()))) == found


REFUSED: dict[str, Any] = {
    r"denavit_hartenberg\[0\].mass is missing": [{"a": 1.0}],
    r"Unknown key 'beta' in denavit_hartenberg\[1\]": [{"mass": 1.0}, {"beta": 2.0, "mass": 1.0}],
    r"Row.alpha .rad. must be a number, got the text '90'": [{"alpha": "90", "mass": 1.0}],
    r"Row.alpha must be in radians, .*, got 90; .* are 1.5708": [{"alpha": 90.0, "mass": 1.0}],
    r"Row.theta must be in radians, .*, got -45; .* are -0.7853": [{"theta": -45.0, "mass": 1.0}],
    r"Joint.type must be one of .* got 'screw'": [{"type": "screw", "mass": 1.0, "a": 1.0}],
    r"last row's a must not be negative, got -1.0": [{"a": -1.0, "mass": 1.0}],
    r"Body.mass must not be negative, got -1.0": [{"mass": -1.0}],
    r"The last link has no inertia .* Body\(mass=1.0": [{"mass": 1.0}],
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_a_wrong_table_is_refused_with_a_sentence(sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        load_arm({"denavit_hartenberg": REFUSED[sentence]})


def test_links_and_a_table_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="exclude each other"):
        load_arm({"links": [], "denavit_hartenberg": []})


# ---- Newton-Euler --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_newton_and_euler_agree_with_the_mass_matrix(seed: int) -> None:
    """Rigid arms of beams with friction, rotors, hubs and payloads."""
    described = stiffened(random_arm(seed, 1 + seed, 2))
    (q, v), a = random_state(described), np.random.default_rng(seed).normal(0.0, 9.0, described.n)

    found = inverse_dynamics(
        rigid_links(described), floats(q), floats(v), floats(a), gravity=described.gravity
    )

    expected = Model(described).inverse_dynamics(q, v, a)
    assert_allclose(found, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


def test_a_wrench_at_a_flexible_tip_does_the_tips_work() -> None:
    """Generalized forces are the power of the tip wrench per coordinate rate."""
    described = replace(random_arm(3, 3, 2), foreshortening=False)
    model = Model(described)
    q, v = random_state(described)
    force = np.array([2.0, -3.0, 1.0])
    units = np.eye(described.n)
    R = _orientation(model, q)

    loaded = model.inverse_dynamics(q, v, 0.0 * v, np.array([*force, 0.0, 0.0, 0.0]))

    power = [model.tip_velocity(q, e) @ R @ force for e in units]
    assert_allclose(loaded - model.inverse_dynamics(q, v, 0.0 * v), power, rtol=0.0, atol=1e-11)


def _orientation(model: Model, q: Array) -> Array:
    """(3, 3) orientation of the last link's frame in the world."""
    from dynamics.formulations.kinematics import outward, poses

    return np.array(poses(outward(model.chain, floats(q), [0.0] * model.n))[-1].R)


def test_newton_and_euler_refuse_what_bends_or_flies() -> None:
    with pytest.raises(ValueError, match=r"link 1 has 2 modes; use Model\.inverse"):
        rigid_links(ARMS["slim"])
    with pytest.raises(ValueError, match=r"is for a fixed base, got Base.type 'free'"):
        rigid_links(replace(ARMS["puma-600"], base=Base(type="free", mass=3.0, inertia=np.eye(3))))


# ---- round trips ---------------------------------------------------------------------------------


def test_a_cycloidal_motion_is_the_integral_of_its_rates() -> None:
    motion = Cycloidal(start=(0.0, 1.0), goal=(2.0, -1.0), duration=4.0)
    for t in (0.3, 1.7, 3.9):
        step = 1e-5
        (before, slow, _), (after, fast, _) = motion(t - step), motion(t + step)
        _, v, a = motion(t)
        assert_allclose((after - before) / (2.0 * step), v, rtol=1e-8)
        assert_allclose((fast - slow) / (2.0 * step), a, rtol=1e-8)
    assert_allclose([motion(-1.0)[0], motion(9.0)[0]], [motion.start, motion.goal], atol=1e-15)


def test_puma_returns_from_its_own_torques() -> None:
    """Newton-Euler torques over 10 s, fed to the forward dynamics: error below 1e-9 rad."""
    motion = Cycloidal(start=(0.0,) * 6, goal=(np.pi / 3,) * 6, duration=10.0)
    times, torque = np.linspace(0.0, 10.0, 41), NominalTorque(ARMS["puma-600"], motion)
    planned = np.array([motion(t)[0] for t in times])

    path = simulate(
        compiled(ARMS["puma-600"]), planned[0], np.zeros(6), torque, times, integrator="dop853",
        rtol=1e-11,
    )  # fmt: skip

    assert np.abs(path.q - planned).max() < 1e-9
    assert_allclose(path.q[-1], np.pi / 3, rtol=0.0, atol=1e-9)


def test_a_motion_of_another_arm_is_refused() -> None:
    with pytest.raises(ValueError, match="start must have 6 numbers"):
        NominalTorque(ARMS["stanford"], Cycloidal(start=(0.0,), goal=(1.0,), duration=1.0))


def test_a_motion_has_one_number_per_joint_that_moves() -> None:
    """A welded link has none; the arm of two links swings under the torque of its one joint."""
    tool = Link(length=0.5, rho_A=1.0, joint=Joint(type="fixed"))
    arm = Arm(links=(Link(length=1.0, rho_A=1.0, joint=Joint(hub_inertia=0.1)), tool))

    torque = NominalTorque(arm, Cycloidal(start=(0.0,), goal=(1.0,), duration=2.0))

    inertia = 0.1 + 1.5**3 / 3.0
    assert_allclose(torque(0.5), inertia * torque.motion(0.5)[2], rtol=1e-12)
    with pytest.raises(ValueError, match="must have 1 numbers, one per joint of the arm that mov"):
        NominalTorque(arm, Cycloidal(start=(0.0, 0.0), goal=(1.0, 1.0), duration=2.0))


# ---- bodies --------------------------------------------------------------------------------------


def test_a_beam_and_the_same_body_are_one_arm() -> None:
    """A rigid beam is described by mass per length, or by mass, centre of mass and inertia."""
    m, L = 1.5, 0.8
    inertia = np.diag([0.0, m * L**2 / 12.0, m * L**2 / 12.0])
    body = Body(mass=m, com=(L / 2.0, 0.0, 0.0), inertia=inertia)
    beam, form = (
        Arm(links=(link, link), gravity=(0.0, -9.81, 0.0))
        for link in (Link(length=L, rho_A=m / L), Link(length=L, body=body))
    )
    (q, v), a = random_state(beam), np.array([1.0, -2.0])

    expected = Model(beam).inverse_dynamics(q, v, a)

    assert_allclose(Model(form).inverse_dynamics(q, v, a), expected, rtol=1e-13)


def test_links_of_a_table_are_bodies() -> None:
    first, second, _ = links(TABLE)
    assert first.length == 0.3
    assert second.length == 0.0
    assert second.joint.type == "prismatic"
    assert first.body == Body(mass=1.0, com=(0.1, 0.0, 0.05))
