"""Rigid arms against Pinocchio.

The Pinocchio model is built from masses, positions and axes; it shares no code with `dynamics`.
"""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dynamics import ARMS, Arm, Body, Joint, Link, Model, Payload
from dynamics.formulations.newton_euler import inverse_dynamics, rigid_links
from dynamics.types import Array
from tests.dynamics.agreement import accelerations, composite
from tests.dynamics.random_arms import compiled, floats

pin = pytest.importorskip("pinocchio", reason="pin (extra `test`) has no wheel for this platform")

PRESETS = ("stanford", "puma-600")
RANDOM = tuple((seed, 1 + seed % 7) for seed in range(14))  # seed, joints


def random_rigid_arm(seed: int, n_joint: int) -> Arm:
    """Beams, bodies and both, on revolute and prismatic joints of any direction, under gravity."""
    rng = np.random.default_rng([seed, n_joint, 11])
    links = []
    for _ in range(n_joint):
        beam, body = rng.random() < 0.6, random_body(rng)
        mounting = Rotation.random(random_state=rng).as_matrix()
        joint = Joint(
            type=str(rng.choice(["revolute", "prismatic"])),
            rotation=mounting, offset=tuple(rng.normal(0.0, 0.3, 3)),
            rotor_inertia=rng.uniform(0.0, 0.3), hub_inertia=rng.uniform(0.0, 0.2),
        )  # fmt: skip
        links.append(
            Link(
                length=rng.uniform(0.2, 1.0) * (beam or rng.random() < 0.5),
                rho_A=rng.uniform(0.5, 3.0) * beam, rho_Ip=rng.uniform(0.0, 0.02) * beam,
                body=None if beam and rng.random() < 0.5 else body,
                tip_mass=rng.uniform(0.0, 1.0), tip_inertia=random_body(rng).inertia, joint=joint,
            )
        )  # fmt: skip
    carried = Payload(mass=0.7, inertia=random_body(rng).inertia) if rng.random() < 0.5 else None
    return Arm(links=tuple(links), gravity=tuple(rng.normal(0.0, 6.0, 3)), payload=carried)


def random_body(rng: np.random.Generator) -> Body:
    root = rng.normal(0.0, 0.2, (3, 3))
    return Body(
        mass=rng.uniform(0.3, 2.0), com=tuple(rng.normal(0.0, 0.2, 3)), inertia=root @ root.T
    )


def pinocchio(arm: Arm) -> Any:
    """Pinocchio model of an arm, with a frame at its tip."""
    model = pin.Model()
    model.gravity.linear = np.array(arm.gravity)
    rotors, parent, end = [], 0, np.zeros(3)
    for k, link in enumerate(arm.links):
        kind = pin.JointModelPZ() if link.joint.type == "prismatic" else pin.JointModelRZ()
        place = pin.SE3(np.array(link.joint.rotation), end + link.joint.offset)
        parent = model.addJoint(parent, kind, place, f"joint {k}")
        end = np.array([link.length, 0.0, 0.0])
        carried = arm.payload if k == len(arm.links) - 1 else None
        for mass, com, inertia in masses(link, carried):
            share = pin.Inertia(float(mass), np.array(com), np.array(inertia))
            model.appendBodyToJoint(parent, share, pin.SE3.Identity())
        rotors.append(link.joint.rotor_inertia)
    model.addFrame(pin.Frame("tip", parent, pin.SE3(np.eye(3), end), pin.FrameType.OP_FRAME))
    model.armature = np.array(rotors)
    return model


def masses(link: Link, payload: Payload | None) -> list[tuple[float, ArrayLike, ArrayLike]]:
    """Mass, centre of mass and inertia about it of each part of a link."""
    L, m, tip = link.length, link.rho_A * link.length, (link.length, 0.0, 0.0)
    beam = np.diag([link.rho_Ip * L, m * L**2 / 12.0, m * L**2 / 12.0])
    found: list[Any] = [(m, (L / 2.0, 0.0, 0.0), beam), (link.tip_mass, tip, link.tip_inertia)]
    found.append((0.0, (0.0, 0.0, 0.0), np.diag([0.0, 0.0, link.joint.hub_inertia])))
    for body, place in ((link.body, link.body and link.body.com), (payload, tip)):
        if body is not None:
            found.append((body.mass, place, body.inertia))
    return found


def random_motion(n: int, seed: int) -> tuple[Array, Array, Array, Array]:
    """Coordinates, rates, accelerations and a wrench at the tip."""
    rng = np.random.default_rng([seed, n, 5])
    return *rng.normal(0.0, 1.5, (3, n)), rng.normal(0.0, 5.0, 6)


def some_arm(name: Any) -> Arm:
    return ARMS[name] if isinstance(name, str) else random_rigid_arm(*name)


@pytest.fixture(params=[*PRESETS, *RANDOM], ids=str)
def arm(request: pytest.FixtureRequest) -> Arm:
    return some_arm(request.param)


def assert_close(found: ArrayLike, expected: Array) -> None:
    assert_allclose(found, expected, rtol=0.0, atol=1e-9 * max(1.0, float(np.abs(expected).max())))


def test_random_arms_turn_and_slide_with_beams_and_bodies() -> None:
    links = [link for case in RANDOM for link in random_rigid_arm(*case).links]
    assert {(k.joint.type, k.rho_A > 0.0, k.body is None) for k in links} == {
        (kind, beam, bare)
        for kind in ("revolute", "prismatic")
        for beam, bare in ((True, True), (True, False), (False, False))
    }
    assert any(k.length == 0.0 for k in links)


def test_mass_matrix_bias_and_accelerations_are_pinocchios(arm: Arm) -> None:
    (q, v, tau, _), other = random_motion(arm.n, 0), pinocchio(arm)
    data = other.createData()

    M, h = composite(arm, q, v)
    a = accelerations(arm, q, v, tau)

    upper = np.triu(pin.crba(other, data, q))
    assert_close(M, upper + np.triu(upper, 1).T)
    assert_close(h, pin.nonLinearEffects(other, data, q, v))
    assert_close(a, pin.aba(other, data, q, v, tau))


def test_inverse_dynamics_with_a_wrench_is_pinocchios(arm: Arm) -> None:
    """Newton-Euler equations and M a + h, both with a wrench at the tip."""
    (q, v, a, wrench), other = random_motion(arm.n, 1), pinocchio(arm)
    push = pin.Force(-wrench[:3], -wrench[3:])
    at_joint = other.frames[-1].placement.act(push)
    forces = [*[pin.Force.Zero()] * arm.n, at_joint]
    expected = pin.rnea(other, other.createData(), q, v, a, forces)

    found = inverse_dynamics(
        rigid_links(arm), floats(q), floats(v), floats(a), gravity=arm.gravity,
        wrench=(floats(wrench[:3]), floats(wrench[3:])),
    )  # fmt: skip

    assert_close(found, expected)
    assert_close(Model(arm).inverse_dynamics(q, v, a, wrench), expected)
    assert np.abs(expected - Model(arm).inverse_dynamics(q, v, a)).max() > 0.1


def test_tip_and_energies_are_pinocchios(arm: Arm) -> None:
    (q, v, _, _), other, model = random_motion(arm.n, 2), pinocchio(arm), Model(arm)
    data = other.createData()
    pin.forwardKinematics(other, data, q, v)
    pin.updateFramePlacements(other, data)
    velocity = pin.getFrameVelocity(other, data, len(other.frames) - 1, pin.LOCAL_WORLD_ALIGNED)

    kinetic, elastic, gravity = model.energy(q, v)

    assert_close(model.tip(q), data.oMf[-1].translation)
    assert_close(model.tip_velocity(q, v), velocity.linear)
    assert_close([kinetic], np.array([pin.computeKineticEnergy(other, data, q, v)]))
    assert_close([gravity], np.array([pin.computePotentialEnergy(other, data, q)]))
    assert elastic == 0.0


@pytest.mark.parametrize("name", [*PRESETS, RANDOM[9]], ids=str)
def test_compiled_forward_dynamics_is_pinocchios(name: Any) -> None:
    arm = some_arm(name)
    (q, v, tau, _), other = random_motion(arm.n, 3), pinocchio(arm)

    found = compiled(arm).accelerations(q, v, tau)

    assert_close(found, pin.aba(other, other.createData(), q, v, tau))
