"""A planar base against a free one that keeps to its plane, and against zero momentum."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Arm, Base, Joint, Link, Stepper, compile_arm, simulate
from dynamics.arms import ARMS
from dynamics.description.rotations import from_rotation_vector, to_rotation_vector
from dynamics.types import Array
from tests.dynamics.random_arms import (
    compiled,
    random_arm,
    random_state,
    random_torque,
    torque_matrix,
    undamped,
)

SEEDS = (0, 1, 2, 3)
FLYER = ARMS["free-flyer"]
some_seed = pytest.mark.parametrize("seed", SEEDS)


def floating(seed: int, **changes: object) -> Arm:
    """A random planar arm with gravity in its plane, on a base with its mass off the origin."""
    base = Base(
        type="planar", mass=3.0, com=(0.1, -0.2, 0.0), inertia=np.diag((0.4, 0.5, 0.6)), **changes
    )
    return replace(random_arm(seed, 3, 2, spatial=False), base=base)


def in_space(arm: Arm, x: Array) -> Array:
    """Coordinates or rates with all six of a free base."""
    return np.concatenate([x[:2], np.zeros(3), x[2:]])


def kept(arm: Arm) -> list[int]:
    """Indices, among the coordinates on a free base, of those on a planar one."""
    return [0, 1, *range(5, arm.n + 3)]


@some_seed
def test_a_planar_base_is_a_free_one_that_keeps_to_its_plane(seed: int) -> None:
    arm = floating(seed)
    planar, free = compiled(arm), compiled(replace(arm, base=replace(arm.base, type="free")))
    (q, v), tau, keep = random_state(arm, seed), random_torque(arm), kept(arm)
    q6, v6 = in_space(arm, q), in_space(arm, v)

    size = np.abs(planar.mass_matrix(q)).max()
    M = free.mass_matrix(q6)[np.ix_(keep, keep)]
    assert_allclose(planar.mass_matrix(q), M, rtol=0.0, atol=1e-12 * size)
    h = free.bias(q6, v6)[keep]
    assert_allclose(planar.bias(q, v), h, rtol=0.0, atol=1e-11 * np.abs(h).max())
    a = free.accelerations(q6, v6, tau)[keep]
    assert_allclose(planar.accelerations(q, v, tau), a, rtol=0.0, atol=1e-9 * np.abs(a).max())
    for ours, theirs in zip(planar.momentum(q, v), free.momentum(q6, v6), strict=True):
        assert_allclose(ours, theirs, rtol=0.0, atol=1e-11 * np.abs(theirs).max())
    assert_allclose(planar.tip(q), free.tip(q6), rtol=0.0, atol=1e-13)
    for joints in ("locked", "free"):
        assert_allclose(
            planar.frequencies(q, joints=joints), free.frequencies(q6, joints=joints), rtol=1e-6
        )


@some_seed
def test_the_last_torque_turns_a_driven_base(seed: int) -> None:
    """M a + h = B tau, with the torque on the base beside those of the joints."""
    arm = floating(seed, driven=True)
    model = compiled(arm)
    (q, v), joints = random_state(arm, seed), random_torque(arm)

    a = model.accelerations(q, v, np.append(joints, 0.7))

    forces = torque_matrix(arm) @ joints + 0.7 * (np.arange(arm.n) == 2)
    M = model.mass_matrix(q)
    size = np.abs(M @ a).max() + np.abs(forces).max()
    assert_allclose(M @ a + model.bias(q, v), forces, rtol=0.0, atol=1e-10 * size)
    assert compiled(replace(arm, base=replace(arm.base, driven=False))).n_torque == arm.n_joint


@some_seed
def test_the_linearization_is_the_slope_of_the_accelerations(seed: int) -> None:
    arm = floating(seed, driven=True)
    model = compiled(arm)
    (q, v), tau = random_state(arm, seed), np.append(random_torque(arm), 0.3)
    A, B = model.linearize(q, v, tau)
    step = 1e-6
    for k in (1, 2, 3):  # along y, the angle of the base, the first joint
        e = step * (np.arange(arm.n) == k)
        slope = model.accelerations(q + e, v, tau) - model.accelerations(q - e, v, tau)
        size = np.abs(A[arm.n :]).max()
        assert_allclose(A[arm.n :, k], slope / (2.0 * step), rtol=0.0, atol=1e-6 * size)
    unit = np.append(np.zeros(arm.n_joint), 1.0)
    change = model.accelerations(q, v, tau + unit) - model.accelerations(q, v, tau)
    assert_allclose(B[arm.n :, -1], change, rtol=0.0, atol=1e-9 * np.abs(change).max())


def test_a_motion_keeps_momentum_and_tells_the_pose() -> None:
    """Base at an angle with a velocity, a joint torque, no damping needed for momentum."""
    turned = from_rotation_vector([0.0, 0.0, 2.5])
    base = replace(
        FLYER.base, position=(1.0, 2.0, 0.0), quaternion=turned, velocity=(0.1, -0.2, 0.0),
        angular_velocity_body=(0.0, 0.0, 0.4),
    )  # fmt: skip
    model = compiled(replace(FLYER, base=base))
    q, v = np.zeros((2, FLYER.n - 3))

    path = simulate(
        model, q, v, np.array([0.5, -0.2]), np.linspace(0.0, 4.0, 21),
        integrator="dop853", rtol=1e-11,
    )  # fmt: skip

    assert_allclose(path.q[0, :3], (1.0, 2.0, 2.5), rtol=1e-12)
    states = zip(path.q, path.v, strict=True)
    momenta = np.array([np.concatenate(model.momentum(*x)) for x in states])
    size = np.abs(momenta[0]).max()
    assert_allclose(momenta, np.tile(momenta[0], (21, 1)), rtol=0.0, atol=1e-8 * size)
    assert path.base_position is not None
    assert path.base_quaternion is not None
    assert_allclose(path.base_position[:, :2], path.q[:, :2], rtol=0.0, atol=0.0)
    angles = [to_rotation_vector(x.tolist())[2] for x in path.base_quaternion]
    assert_allclose(np.unwrap(angles), path.q[:, 2], rtol=0.0, atol=1e-12)
    assert path.q[-1, 2] > np.pi, "an angle beyond half a turn"


def test_energy_is_kept_without_damping() -> None:
    model = compiled(undamped(FLYER))
    q, v = np.zeros((2, FLYER.n))
    v[list(FLYER.joint_index)] = 0.8, -0.5
    path = simulate(model, q, v, None, np.linspace(0.0, 3.0, 7), integrator="dop853", rtol=1e-11)
    energies = [sum(model.energy(*x)) for x in zip(path.q, path.v, strict=True)]
    assert_allclose(energies, energies[0], rtol=1e-8)


@pytest.mark.parametrize("name", ["viscous", "coulomb"])
@pytest.mark.parametrize("driven", [False, True])
def test_free_friction_acts_on_its_joint_also_where_the_base_is_driven(
    name: str, driven: bool
) -> None:
    base = Base(type="planar", mass=4.0, inertia=np.diag([1.0, 1.0, 0.5]), driven=driven)

    def arm(**friction: float) -> Arm:
        joints = (Joint(rotor_inertia=0.1, **friction), Joint(rotor_inertia=0.1))
        return Arm(links=tuple(Link(length=0.5, rho_A=1.0, joint=x) for x in joints), base=base)

    described, free = arm(**{name: 0.7}), compile_arm(arm(), free_parameters=[f"{name}_1"])
    ends = []
    for model in (compile_arm(described), free):
        stepper = Stepper(model, 1, dt=1e-3, substeps=1)
        stepper.parameters[:] = 0.7
        stepper.v[:] = [0.0, 0.0, 1.0, 1.0, 0.0]
        stepper.advance()
        ends.append(stepper.v[0].copy())
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-12)
    with pytest.raises(ValueError, match=f"{name}_3 is of no joint: this arm has 2 joints"):
        Stepper(compile_arm(arm(), free_parameters=[f"{name}_3"]), 1, dt=1e-3, substeps=1)


def test_a_free_payload_without_a_link_is_refused() -> None:
    """It was added to the base."""
    base = Base(type="planar", mass=1.0, inertia=((0, 0, 0), (0, 0, 0), (0, 0, 0.1)))
    with pytest.raises(ValueError, match="payload_mass needs a link"):
        compile_arm(Arm(links=(), base=base), free_parameters=("stiffness", "payload_mass"))
