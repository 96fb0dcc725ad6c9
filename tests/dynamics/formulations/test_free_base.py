"""Free base against brute force, conservation laws and rigid bodies with known motions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from dynamics import ARMS, Arm
from dynamics.description.rotations import from_rotation_vector
from dynamics.formulations import articulated_body, free_base, gibbs_appell
from dynamics.formulations.kinematics import energies
from dynamics.types import Array
from tests.dynamics import brute_force
from tests.dynamics.random_arms import (
    compiled,
    floats,
    flying,
    random_arm,
    random_state,
    random_torque,
    torque_matrix,
)

FEW = [(0, 1, 1), (1, 1, 3), (2, 2, 2), (3, 2, 3), (4, 3, 3), (7, 3, 0), (15, 4, 3), (18, 1, 2)]
some_arm = pytest.mark.parametrize("case", FEW, ids=str)


def flyer(seed: int, n_link: int, n_mode: int) -> Arm:
    return flying(random_arm(seed, n_link, n_mode), seed)


class Plain:
    """The recursion with floats, in the public coordinates and rates."""

    def __init__(self, arm: Arm, q: Array, v: Array) -> None:
        self.turn = from_rotation_vector(q[3:6].tolist())
        self.chain = free_base.turned(compiled(arm).chain, self.turn)
        self.q = free_base.unturned(free_base.local(q.tolist(), self.turn), self.turn)
        self.v = free_base.local(v.tolist(), self.turn)

    def composite(self) -> tuple[Array, Array]:
        M = free_base.matrix_in_world(gibbs_appell.mass_matrix(self.chain, self.q), self.turn)
        h = free_base.world(gibbs_appell.bias(self.chain, self.q, self.v), self.turn)
        return np.array(M), np.array(h)

    def accelerations(self, tau: Array) -> Array:
        a = articulated_body.accelerations(self.chain, self.q, self.v, tau.tolist())
        return np.array(free_base.world(a, self.turn))

    def momentum(self) -> Array:
        p = free_base.momentum(self.chain, self.q, self.v)
        return np.array([free_base.world(x, self.turn) for x in p])


@some_arm
def test_mass_matrix_is_the_metric_of_kinetic_energy(case: tuple[int, int, int]) -> None:
    arm = flyer(*case)
    q, v = random_state(arm)
    plain = Plain(arm, q, v)

    M, _ = plain.composite()

    assert np.array_equal(M, M.T)
    size = np.sqrt(np.diag(M))
    assert np.abs((M - brute_force.mass_matrix(arm, q)) / np.outer(size, size)).max() < 1e-10
    assert np.linalg.eigvalsh(M / np.outer(size, size))[0] > 0.0
    kinetic, _, gravity = energies(plain.chain, plain.q, plain.v)
    assert kinetic == pytest.approx(brute_force.kinetic_energy(arm, q, v), rel=1e-12)
    assert gravity == pytest.approx(brute_force.gravity_energy(arm, q), rel=1e-12)


@some_arm
def test_equations_are_the_gradient_of_the_energy_of_acceleration(
    case: tuple[int, int, int],
) -> None:
    """M a + h = dS/da + resisting forces, with the angular velocity in the base's own frame."""
    arm = flyer(*case)
    (q, v), tau = random_state(arm), random_torque(arm)
    plain = Plain(arm, q, v)

    a = plain.accelerations(tau)

    M, h = plain.composite()
    expected = brute_force.inertial_forces(arm, q, v, a) + brute_force.resisting_forces(arm, q, v)
    size = np.sqrt(np.diag(M) * 2.0 * brute_force.acceleration_energy(arm, q, v, a))
    assert np.abs((M @ a + h - expected) / size).max() < 1e-10
    assert brute_force.imbalance(M, a, torque_matrix(arm) @ tau - h) < 1e-13


@some_arm
def test_momentum_is_that_of_all_bodies(case: tuple[int, int, int]) -> None:
    """It also equals the base's rows of M times v."""
    arm = flyer(*case)
    q, v = random_state(arm)
    plain = Plain(arm, q, v)

    linear, angular = plain.momentum()

    expected = brute_force.momentum(arm, q, v)
    assert_allclose(linear, expected[0], rtol=0.0, atol=1e-12 * np.abs(expected[0]).max())
    assert_allclose(angular, expected[1], rtol=0.0, atol=1e-12 * np.abs(expected[1]).max())
    force, moment = np.split((plain.composite()[0] @ v)[:6], 2)
    assert_allclose(linear, force, rtol=0.0, atol=1e-12 * np.abs(linear).max())
    about_base = angular - np.cross(q[:3], linear)
    own = free_base.local(about_base.tolist(), plain.turn)
    assert_allclose(own, moment, rtol=0.0, atol=1e-11 * np.abs(angular).max())


def test_a_renewed_attitude_is_turned_by_the_rotation_vector() -> None:
    """And near zero rotation the rates of the vector are those of a body that turns as it does."""
    rng = np.random.default_rng(0)
    attitude = from_rotation_vector(rng.normal(0.0, 1.0, 3).tolist())
    six, rates = rng.normal(0.0, 1.0, (2, 6)).tolist()
    at = Rotation.from_quat(np.roll(attitude, -1)) * Rotation.from_rotvec(six[3:])
    fresh = free_base.renewed(six, rates, attitude)[2]
    assert_allclose(Rotation.from_quat(np.roll(fresh, -1)).as_matrix(), at.as_matrix(), atol=1e-12)
    step, turn, omega = 1e-4, Rotation.from_rotvec(1e-4 * np.array(six[3:])), np.array(rates[3:])
    ends = [(turn * Rotation.from_rotvec(x * step * omega)).as_rotvec() for x in (-1.0, 1.0)]
    small = [*six[:3], *turn.as_rotvec()]
    assert_allclose(free_base.own_rates(small, rates)[:3], rates[:3], rtol=0.0, atol=0.0)
    found = free_base.own_rates(small, rates)[3:]
    assert_allclose(found, (ends[1] - ends[0]) / (2.0 * step), rtol=0.0, atol=1e-7)


def test_a_renewed_reference_frame_leaves_the_motion_of_the_base() -> None:
    """Position and velocity in the world; angular velocity by central differences."""
    rng = np.random.default_rng(1)
    attitude = from_rotation_vector(rng.normal(0.0, 1.0, 3).tolist())
    six, rates = rng.normal(0.0, 1.0, (2, 6))
    place, fresh_rates, fresh = free_base.renewed(six.tolist(), rates.tolist(), attitude)
    for before, after in ((six, place), (rates, fresh_rates)):
        world = free_base.local(free_base.world(before.tolist(), attitude), fresh)
        assert_allclose(after[:3], world[:3], atol=1e-12)
    assert place[3:] == [0.0, 0.0, 0.0]
    step = 1e-4
    back, ahead = (Rotation.from_rotvec(six[3:] + t * rates[3:]) for t in (-step, step))
    omega = (back.inv() * ahead).as_rotvec() / (2.0 * step)
    assert_allclose(fresh_rates[3:], omega, rtol=0.0, atol=1e-7)


def test_a_small_rotation_is_turned_back_in_the_frame_of_a_turning_base() -> None:
    """`Model.linearize` beside two bodies that turn alike from attitudes a small angle apart."""
    arm = flyer(0, 1, 1)
    q, v = random_state(arm)
    A, _ = compiled(arm).linearize(q, v, random_torque(arm))
    small, step = 1e-6, 1e-4
    for k, axis in enumerate(np.eye(3)):
        apart = []
        for t in (-step, step):
            turn = Rotation.from_rotvec(t * v[3:6])
            apart.append((turn.inv() * Rotation.from_rotvec(small * axis) * turn).as_rotvec())
        slope = (apart[1] - apart[0]) / (2.0 * step * small)
        assert_allclose(A[3:6, 3 + k], slope, rtol=0.0, atol=1e-6)


def test_a_planar_base_is_carried_along_at_zero_momentum() -> None:
    """Against an integration of the rates for which the momentum is zero, over 1.3 rad."""
    arm = ARMS["free-flyer"]
    chain, joints = compiled(arm).chain, list(arm.joint_index)
    q = np.zeros(arm.n)
    q[:3], q[joints] = (0.3, -0.2, 0.7), (0.4, 0.9)
    target = np.array([-0.6, 2.2])
    move = target - q[joints]

    def rates(share: float, base: Array) -> Array:
        x = q.copy()
        x[:3], x[joints] = base, q[joints] + share * move
        columns = []
        for v in (*np.eye(arm.n)[:3], np.eye(arm.n)[joints].T @ move):
            linear, angular = free_base.momentum(chain, floats(x), floats(v))
            columns.append([*linear[:2], angular[2]])
        *base_moves, joints_move = np.array(columns)
        return np.linalg.solve(np.transpose(base_moves), -joints_move)

    expected = solve_ivp(rates, (0.0, 1.0), q[:3], "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]

    found = free_base.carried(chain, joints, floats(q), floats(target))

    assert abs(expected[2] - q[2]) > 0.1
    assert_allclose(found, expected, rtol=0.0, atol=1e-8)
