"""Free-base motions: exact solutions, conserved quantities, steps, batches, linearisation."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import DOP853

from dynamics import (
    Arm,
    Base,
    Link,
    Mode,
    Model,
    Stepper,
    Trajectory,
    compile_arm,
    load_arm,
    simulate,
)
from dynamics.description.rotations import from_rotation_vector, product, to_rotation_vector
from dynamics.formulations.articulated_body import accelerations
from dynamics.simulation.validity import limits
from dynamics.types import Array
from tests.dynamics.random_arms import (
    compiled,
    floats,
    flying,
    random_arm,
    random_state,
    random_torque,
)
from tests.paths import REFERENCE

COAST = load_arm(REFERENCE / "free_flying_coast.json")
BENT = np.array([0.5, 0.03, -0.02, -0.8, 0.02, 0.03])  # initial coordinates of that case
SPINNING = replace(
    COAST,
    links=COAST.links[:1],
    gravity=(0.0, -3.0, -9.0),
    base=replace(
        COAST.base, angular_velocity_body=(1.0, -2.0, 4.0), quaternion=(0.6, 0.8, 0.0, 0.0)
    ),
)
ROUND = ((2.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0))  # [kg m^2] a symmetric top
SMALL = ((1e-9, 0.0, 0.0), (0.0, 1e-9, 0.0), (0.0, 0.0, 1e-9))


def rigid(**changes: object) -> Arm:
    """A free rigid body without an arm."""
    return Arm(links=(), base=Base(type="free", mass=5.0, inertia=ROUND, **changes))


def follow(integrator: str, **options: float) -> Trajectory:
    """Motion of the spinning arm under a constant torque."""
    t = np.linspace(0.0, 0.4, 5)
    return simulate(
        compiled(SPINNING), BENT[:3], np.zeros(3), [0.3], t, integrator=integrator, **options
    )


@cache
def reference() -> Trajectory:
    return follow("dop853", rtol=1e-12)


def test_a_symmetric_top_follows_eulers_solution() -> None:
    """R(t) = exp(L t / J1) exp(e3 (1 - J3 / J1) w3 t), from R(0) = 1."""
    w = np.array([1.0, 0.5, 6.0])
    momentum = np.array([2.0, 2.0, 3.0]) * w
    arm = rigid(angular_velocity_body=tuple(w), velocity=(0.3, 0.0, -0.1))
    t = np.linspace(0.0, 10.0, 201)

    path = simulate(compiled(arm), [], [], None, t, rtol=1e-12)

    for k, now in enumerate(t):
        nutation = from_rotation_vector(momentum / 2.0 * now)
        spin = from_rotation_vector((0.0, 0.0, (1.0 - 3.0 / 2.0) * w[2] * now))
        expected = np.array(product(nutation, spin))
        expected *= np.sign(expected @ path.base_quaternion[k])
        assert_allclose(path.base_quaternion[k], expected, rtol=0.0, atol=1e-11)
    assert_allclose(path.base_position, np.outer(t, arm.base.velocity), rtol=0.0, atol=1e-12)
    backwards = replace(arm, base=replace(arm.base, quaternion=(-1.0, 0.0, 0.0, 0.0)))
    again = simulate(compiled(backwards), [], [], None, t, rtol=1e-12)
    assert_allclose(again.base_quaternion, -path.base_quaternion, rtol=0.0, atol=1e-11)
    assert np.all(np.sum(path.base_quaternion[1:] * path.base_quaternion[:-1], axis=1) > 0.0)


def test_the_centre_of_mass_of_a_thrown_body_follows_a_parabola() -> None:
    """At any spin; its path is taken from the gravity energy."""
    com = np.array([0.2, -0.1, 0.3])
    arm = rigid(com=tuple(com), angular_velocity_body=(2.0, -3.0, 5.0), velocity=(1.0, 2.0, 3.0))
    arm = replace(arm, gravity=(0.5, 0.0, -9.81))
    t = np.linspace(0.0, 2.0, 11)

    path = simulate(compiled(arm), [], [], None, t)

    energies = [compiled(arm).energy(q, v)[2] for q, v in zip(path.q, path.v, strict=True)]
    w = np.array(arm.base.angular_velocity_body)
    velocity = np.array(arm.base.velocity) + np.cross(w, com)
    fallen = com + np.outer(t, velocity) + 0.5 * np.outer(t**2, arm.gravity)
    assert_allclose(energies, -5.0 * fallen @ arm.gravity, rtol=0.0, atol=1e-7)


def test_momentum_and_energy_of_a_free_arm_are_conserved_over_10_000_steps_of_dop853(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, steps = compiled(COAST), []
    own_step = DOP853.step
    monkeypatch.setattr(DOP853, "step", lambda self: (steps.append(1), own_step(self)))
    t = np.linspace(0.0, 20.0, 201)

    path = simulate(model, BENT, np.zeros(6), None, t, integrator="dop853", rtol=1e-12)

    assert len(steps) > 10_000
    assert limits(model, path) == ()
    states = list(zip(path.q, path.v, strict=True))
    for momenta in zip(*(model.momentum(q, v) for q, v in states), strict=True):
        drift = np.abs(np.array(momenta) - momenta[0]).max()
        assert drift < 1e-10 * np.linalg.norm(momenta[0])
    total = np.array([sum(model.energy(q, v)) for q, v in states])
    assert np.abs(total - total[0]).max() < 1e-9 * total[0]


def test_linear_momentum_grows_with_the_weight() -> None:
    path, model = reference(), compiled(SPINNING)

    linear = [model.momentum(q, v)[0] for q, v in zip(path.q, path.v, strict=True)]

    weight = np.array(SPINNING.gravity) * model.mass_matrix(path.q[0])[0, 0]
    assert_allclose(linear - linear[0], np.outer(path.t, weight), rtol=0.0, atol=1e-10)


def distances(path: Trajectory) -> tuple[float, float]:
    """Largest errors of the tip [m] and of the base's quaternion [-] against the reference."""
    true = reference()
    attitude = np.abs(path.base_quaternion - true.base_quaternion).max()
    return float(np.abs(path.tip - true.tip).max()), float(attitude)


@pytest.mark.parametrize(
    ("integrator", "dt", "order"),
    [("rk4", 0.0025, 4), ("midpoint", 0.0005, 2), ("rosenbrock", 0.0025, 4), ("euler", 0.0005, 1)],
)
def test_steps_converge_with_their_order(integrator: str, dt: float, order: int) -> None:
    """Also in the attitude of the base, under gravity and at a fast spin."""
    errors = [distances(follow(integrator, dt=step)) for step in (dt, dt / 2.0)]

    for coarse, fine in zip(*errors, strict=True):
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("integrator", ["radau", "bdf"])
def test_implicit_methods_with_error_control_agree(integrator: str) -> None:
    assert max(distances(follow(integrator, rtol=1e-8))) < 1e-6


@pytest.mark.parametrize("integrator", ["numerov", "generalized-alpha", "exponential"])
def test_multistep_methods_are_refused_with_a_sentence(integrator: str) -> None:
    with pytest.raises(ValueError, match=f"{integrator}.* remembers .*take one of .'rk4'"):
        Stepper(compiled(COAST), 1, dt=1e-3, substeps=1, integrator=integrator)


@pytest.mark.parametrize("integrator", ["rk4", "midpoint"])
def test_a_batch_steps_every_environment_as_if_alone(integrator: str) -> None:
    """In every lane, also of a block that is not full, with any state of the base."""
    model, count = compiled(SPINNING), 19
    batch = Stepper(model, count, dt=1e-3, substeps=50, integrator=integrator)
    alone = Stepper(model, 1, dt=1e-3, substeps=50, integrator=integrator)
    for k in range(count):
        batch.q[k], batch.v[k] = random_state(SPINNING, k)
        batch.torque[k] = random_torque(SPINNING, k)
    q, v = batch.q.copy(), batch.v.copy()

    batch.advance()

    assert not batch.status.any()
    for k in range(count):
        alone.q[0], alone.v[0], alone.torque[0] = q[k], v[k], batch.torque[k]
        alone.advance()
        assert_allclose(batch.v[k], alone.v[0], rtol=0.0, atol=1e-10 * np.abs(alone.v).max())
        assert_allclose(batch.q[k], alone.q[0], rtol=0.0, atol=1e-10)
        assert_allclose(batch.measured[k], alone.measured[0], rtol=0.0, atol=1e-9)
        tip = model.measurements["tip"]
        assert_allclose(batch.measured[k, tip], model.tip(batch.q[k]), rtol=0.0, atol=1e-12)


def test_float32_steps_agree_with_float64_to_single_precision() -> None:
    ends = []
    for dtype in ("float64", "float32"):
        stepper = Stepper(compile_arm(SPINNING, dtype=dtype), 2, dt=1e-3, substeps=100)
        stepper.q[:], stepper.v[:] = random_state(SPINNING)
        stepper.advance()
        assert not stepper.status.any()
        ends.append((stepper.q.copy(), stepper.measured.copy()))

    for double, single in zip(*ends, strict=True):
        assert_allclose(single, double, rtol=0.0, atol=1e-4 * np.abs(double).max())
    assert np.abs(ends[0][0] - ends[1][0]).max() > 0.0


def test_a_long_spin_through_all_attitudes_meets_no_singularity() -> None:
    """A million steps of 0.045 rad, not about a principal axis."""
    model = compiled(rigid())
    stepper = Stepper(model, 1, dt=1e-3, substeps=100_000)
    stepper.v[0, 3:] = 3.0, 40.0, -20.0
    _, before = model.momentum(stepper.q[0], stepper.v[0])
    angles = []
    for _ in range(10):
        stepper.advance()
        assert stepper.status[0] == 0
        angles.append(np.linalg.norm(stepper.q[0, 3:]))

    _, after = model.momentum(stepper.q[0], stepper.v[0])
    assert_allclose(after, before, rtol=0.0, atol=0.01 * np.linalg.norm(before))
    assert max(angles) <= np.pi
    assert max(angles) > 2.0


def test_a_heavy_base_acts_like_a_fixed_one() -> None:
    """The difference is inversely proportional to the base's mass."""
    arm = replace(random_arm(3, 2, 3), gravity=(0.0, 0.0, 0.0))
    (q, v), tau = random_state(arm), random_torque(arm)
    expected = np.array(accelerations(compiled(arm).chain, floats(q), floats(v), floats(tau)))
    differences = []
    for mass in (1e6, 1e9):
        solid = tuple(map(tuple, mass * np.eye(3)))
        chain = compiled(replace(arm, base=Base(type="free", mass=mass, inertia=solid))).chain
        still = [0.0] * 6

        a = accelerations(chain, still + floats(q), still + floats(v), floats(tau))

        differences.append(np.abs(a[6:] - expected).max() / np.abs(expected).max())
        assert np.abs(a[:6]).max() < 1e4 / mass * np.abs(expected).max()
    assert differences[1] < 1e-6
    assert differences[1] == pytest.approx(1e-3 * differences[0], rel=0.1)


def test_accelerations_in_the_base_frame_do_not_depend_on_the_pose_of_the_base() -> None:
    """Without gravity."""
    arm = replace(flying(random_arm(2, 2, 2)), gravity=(0.0, 0.0, 0.0))
    model, (q, v), tau = compiled(arm), random_state(arm), random_torque(arm)
    turn = np.array(from_rotation_vector((0.4, -1.0, 2.0)))
    moved_q, moved_v = q.copy(), v.copy()
    moved_q[:3] += 5.0
    attitude = product(turn, from_rotation_vector(q[3:6]))
    moved_q[3:6] = to_rotation_vector(attitude)
    turned = matrix(turn)
    moved_v[:3] = turned @ v[:3]

    a, moved = model.accelerations(q, v, tau), model.accelerations(moved_q, moved_v, tau)

    assert_allclose(moved[:3], turned @ a[:3], rtol=0.0, atol=1e-11 * np.abs(a).max())
    assert_allclose(moved[3:], a[3:], rtol=0.0, atol=1e-11 * np.abs(a).max())


def matrix(quaternion: Array) -> Array:
    """Rotation matrix of a quaternion, from the rotated unit vectors."""
    conjugate = quaternion * (1.0, -1.0, -1.0, -1.0)
    columns = [
        product(product(quaternion, (0.0, *axis)), conjugate)[1:] for axis in np.eye(3).tolist()
    ]
    return np.array(columns).T


def test_inverse_dynamics_returns_the_joint_torques_and_no_force_on_the_base() -> None:
    arm = flying(random_arm(2, 2, 2))
    model, (q, v), tau = compiled(arm), random_state(arm), random_torque(arm)

    forces = model.inverse_dynamics(q, v, model.accelerations(q, v, tau))

    size = np.abs(model.bias(q, v)).max()
    assert_allclose(forces[:6], 0.0, rtol=0.0, atol=1e-10 * size)
    assert_allclose(forces[list(arm.joint_index)], tau, rtol=0.0, atol=1e-10 * size)


def test_linearisation_equals_central_differences_of_the_motion() -> None:
    """By position, small rotation of the base in its own frame, arm coordinates and rates."""
    arm = flying(random_arm(2, 2, 2))
    model, (q, v), tau = compiled(arm), random_state(arm), random_torque(arm)
    n, h = arm.n, 1e-6

    def slope(k: int) -> Array:
        ends = []
        for sign in (1.0, -1.0):
            at, rates = q.copy(), v.copy()
            if k >= n:
                rates[k - n] += sign * h
            elif 3 <= k < 6:
                small = sign * h * np.eye(3)[k - 3]
                turned = product(from_rotation_vector(q[3:6]), from_rotation_vector(small))
                at[3:6] = to_rotation_vector(turned)
            else:
                at[k] += sign * h
            # the rate of a small rotation p is the change of omega minus omega x p
            kinematic = rates.copy()
            if 3 <= k < 6:
                kinematic[3:6] -= np.cross(v[3:6], sign * h * np.eye(3)[k - 3])
            ends.append(np.append(kinematic, model.accelerations(at, rates, tau)))
        return (ends[0] - ends[1]) / (2.0 * h)

    A, B = model.linearize(q, v, tau)

    expected = np.array([slope(k) for k in range(2 * n)]).T
    assert_allclose(A, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())
    # the base's rows are small against those of stiff modes, and are compared by themselves
    six = np.r_[n : n + 6]
    assert_allclose(A[six], expected[six], rtol=0.0, atol=1e-7 * np.abs(expected[six]).max())
    driven = model.accelerations(q, v, tau + 1.0) - model.accelerations(q, v, tau)
    assert_allclose(B[n:].sum(axis=1), driven, rtol=0.0, atol=1e-9 * np.abs(driven).max())


def test_the_linear_tip_rotation_does_not_change_the_base() -> None:
    """With rigid links both kinds of rotation give equal accelerations at any state of the base."""
    arm = flying(random_arm(7, 3, 0))
    (q, v), tau = random_state(arm), random_torque(arm)

    exact, linear = (
        accelerations(chain, floats(q), floats(v), floats(tau))
        for chain in (compiled(replace(arm, rotation=kind)).chain for kind in ("exp", "linear"))
    )

    assert exact == linear


BETA = np.array([4.730040744862704, 7.853204624095838])  # cosh cos = 1: a free-free beam


@pytest.mark.parametrize("direction", ["y", "z"])
def test_a_beam_on_a_massless_base_has_the_frequencies_of_a_free_free_beam(direction: str) -> None:
    """[rad/s] beta^2 sqrt(EI / rho A) / l^2."""
    modes = tuple(Mode(kind="clamped-free", index=k, direction=direction) for k in range(1, 9))
    link = Link(length=2.0, rho_A=0.5, EIz=30.0, EIy=30.0, modes=modes)
    dust = Base(type="free", mass=1e-9, inertia=SMALL)

    omega = compile_arm(Arm(links=(link,), base=dust)).frequencies(joints="locked")

    expected = (BETA / 2.0) ** 2 * np.sqrt(30.0 / 0.5)
    assert_allclose(omega[:2], expected, rtol=2e-3)


def test_a_shaft_on_a_massless_base_has_the_frequencies_of_a_free_free_shaft() -> None:
    """[rad/s] c sqrt(GJ / rho Ip), with c = k pi / l; on a fixed base c = (2 k - 1) pi / (2 l)."""
    modes = tuple(Mode(kind="torsion-poly", index=k, direction="x") for k in range(1, 8))
    link = Link(length=2.0, rho_A=0.5, GJ=7.0, rho_Ip=0.003, modes=modes)
    speed = np.sqrt(7.0 / 0.003)
    dust = Base(type="free", mass=1e-9, inertia=SMALL)

    free = compile_arm(Arm(links=(link,), base=dust)).frequencies(joints="locked")
    fixed = compile_arm(Arm(links=(link,))).frequencies(joints="locked")

    assert_allclose(free[:2], np.array([1, 2]) * np.pi / 2.0 * speed, rtol=1e-4)
    assert_allclose(fixed[:2], np.array([1, 3]) * np.pi / 4.0 * speed, rtol=1e-4)


def test_a_free_base_adds_operations_but_does_not_triple_them() -> None:
    model: Model = compiled(COAST)
    fixed = compiled(replace(COAST, base=Base())).operation_count()["accelerations"]

    count = model.operation_count()["accelerations"]

    assert fixed["multiplications"] < count["multiplications"] < 3 * fixed["multiplications"]
    assert model.graph.size1_in(0) == model.graph.size1_out(0) == 12
