"""Laws against independent computations, on masses on springs: nothing is compiled."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag, solve_discrete_are
from scipy.optimize import LinearConstraint, minimize

from agents.controllers import nmpc
from agents.controllers.inverse import InverseDynamics
from agents.controllers.lqr import Cost, Gain, regulator, riccati
from agents.controllers.models import linear_model
from agents.controllers.models.linear_model import LinearModels
from agents.controllers.models.plan import Planner
from agents.controllers.models.preview import Preview
from agents.controllers.models.reference import Course, Reference
from agents.controllers.mpc import BLOCKS, PRICE, Predictive, blocks_of
from agents.controllers.observers.exact import Estimate, ExactState
from dynamics import Arm, Link, Mode
from dynamics.types import Array
from tests.agents.controllers.springs import (
    BENDS,
    DEFLECTION,
    DT,
    JOINTS,
    LIMIT,
    MODAL,
    MOVE_TIME,
    READINGS,
    TIP,
    Environment,
    K,
    M,
    N,
    step_of,
)

pytestmark = pytest.mark.usefixtures("springs_alone")
STILL = np.zeros(2)


def test_a_linear_model_steps_as_the_equations_of_motion() -> None:
    """In coordinates; what torques bend of the modes that are left out is at rest at once."""
    rng = np.random.default_rng(0)
    env = Environment(payloads=(0.0, 0.2), factors=(0.9, 1.1))
    for p, plant in enumerate(env.models.plants):
        model, (A, B) = env.models.at(STILL, p), step_of(plant)
        shapes = block_diag(model.shapes, model.shapes)
        np.testing.assert_allclose(shapes @ model.A, A @ shapes, atol=1e-12)
        np.testing.assert_allclose(shapes @ model.B, B, atol=1e-12)
        x = rng.normal(size=2 * N)
        np.testing.assert_allclose(model.C @ x, READINGS @ (shapes @ x)[:N])
        np.testing.assert_allclose(model.tip @ x[:N], TIP @ (shapes @ x)[:N])
        np.testing.assert_allclose(model.bend @ x[:N], BENDS @ (shapes @ x)[:N])
        assert not model.D.any()
        fewer = Environment(payloads=(0.0, 0.2), factors=(0.9, 1.1), modes=3).models.at(STILL, p)
        slow = fewer.shapes.T @ plant.model.mass_matrix(STILL)
        forces = np.eye(N)[:, JOINTS] - slow.T @ fewer.shapes[JOINTS].T
        bent = np.linalg.lstsq(
            np.vstack([plant.K, slow]), np.vstack([forces, np.zeros((3, 2))]), rcond=None
        )[0]
        np.testing.assert_allclose(fewer.D, READINGS @ bent, atol=1e-12)


def test_links_bend_as_the_arm_does() -> None:
    """A link of two pieces, by the tip of the arm itself."""
    section = {"rho_A": 0.3, "EIz": 4.0, "EIy": 7.0}
    modes = tuple(Mode(kind="clamped-free", index=1, direction=x) for x in "yz")
    arm = Arm(links=(Link(length=0.8, segments=2, modes=modes, **section),))
    models, small = LinearModels(arm, DT, ()), 1e-6
    assert models.joints == [0]
    tips = [models.model.tip(small * x)[1:] / small / 0.8 for x in np.eye(arm.n)]
    bent = np.array(tips)[models.modal].T
    np.testing.assert_allclose(models.bends[:, models.modal], bent, atol=1e-6)
    assert not models.bends[:, models.joints].any()


def test_plants_reach_beyond_what_is_drawn() -> None:
    """By half of it on both sides, but no payload is negative; no mode is taken for a slower."""
    masses, factors = linear_model._levels((0.0, 0.6), 7), linear_model._levels((0.9, 1.1), 3)
    assert masses == pytest.approx(np.linspace(0.0, 0.9, 10))
    assert factors == pytest.approx(np.linspace(0.8, 1.2, 5))
    assert linear_model._levels((0.2, 0.2), 7) == [0.2]
    assert linear_model._middle(masses, (0.0, 0.6)) == 3
    assert np.pi > linear_model.FASTEST


def cost_of(env: Environment, model: Any) -> tuple[Cost, Array, Array]:
    cost = Cost(env, env.models, effort=0.3, lead=0.2)
    return cost, *cost.of(model)


def test_lqr_is_the_solution_of_the_riccati_equation_with_clipped_joints() -> None:
    """In coordinates, by SciPy."""
    env, clip = Environment(), 0.03
    model, (A, B) = env.models.at(STILL), step_of(env.models.plants[0])
    _, Q, R = cost_of(env, model)
    modes = block_diag(model.modes, model.modes)
    P = solve_discrete_are(A, B, modes.T @ Q @ modes, R)
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    places = np.array([[0.05, 0.002, 0.01, -0.001], [-0.01, 0.001, -0.3, 0.002]])
    rates = 0.01 * np.random.default_rng(0).normal(size=(2, N))
    seen = env.observed(
        joint_error=places[:, JOINTS], modal_amplitude=places[:, MODAL],
        joint_rate=rates[:, JOINTS], modal_rate=rates[:, MODAL],
    )  # fmt: skip
    found, _ = regulator(env, "lqr", effort=0.3, lead=0.2, clip=clip).predict(seen)
    places[:, JOINTS] = np.clip(places[:, JOINTS], -clip, clip)
    wanted = -np.hstack([places, rates]) @ gain.T / LIMIT
    assert np.any(np.abs(wanted) < 1.0)
    assert np.any(np.abs(wanted) > 1.0)
    np.testing.assert_allclose(found, np.clip(wanted, -1.0, 1.0), rtol=1e-9)


def bent_by(acceleration: Array) -> Array:
    """(N,) offset from straight links that a steady acceleration of the joints bends."""
    offset = np.zeros(N)
    offset[MODAL] = -np.linalg.solve(
        K[np.ix_(MODAL, MODAL)], M[np.ix_(MODAL, JOINTS)] @ acceleration
    )
    offset[JOINTS] = -np.linalg.solve(TIP[:2, JOINTS], TIP[:2, MODAL] @ offset[MODAL])
    return offset


def test_an_arm_on_its_reference_is_estimated_at_rest_about_it() -> None:
    """Of a target that accelerates evenly: bent as in the end, with the torque that it needs."""
    env, acceleration = Environment(moving=True), np.array([0.8, -0.5])
    subject, memory, offset = ExactState(env, "lqr"), None, bent_by(acceleration)
    for k in range(8):
        seen = env.observed(
            joint_error=offset[None, JOINTS], modal_amplitude=offset[None, MODAL],
            joint_rate=k * DT * acceleration[None], target_rate=k * DT * acceleration[None],
        )  # fmt: skip
        (found,), memory = subject.observe(seen, memory, np.array([k == 0]))
        if k == 0:
            assert not found.forward.any()
            assert np.abs(found.x[:N]).max() > 1e-3
    np.testing.assert_allclose(found.x, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.forward, M[np.ix_(JOINTS, JOINTS)] @ acceleration, rtol=1e-9)
    np.testing.assert_allclose(
        memory.plan.target.way[0], 0.5 * (7 * DT) ** 2 * acceleration, rtol=4e-3
    )


def smooth(share: float) -> tuple[float, float]:
    """The polynomial of fifth degree from rest to rest, and its slope."""
    s = min(max(share, 0.0), 1.0)
    return 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5, 30.0 * s**2 - 60.0 * s**3 + 30.0 * s**4


@pytest.mark.parametrize("obs", ["state", "sensors"])
def test_inverse_dynamics_feeds_forward_what_a_plan_needs(obs: str) -> None:
    """Torques, bent angles and their rates by hand, beside joint PD; the move takes its share."""
    env, start, load = Environment(obs), np.array([0.1, -0.04]), 0.7
    subject = InverseDynamics(env, frequency_ratio=0.1, damping_ratio=0.4, load=load)
    rise, most = subject.planner.time(STILL, start), 0.0
    angles = np.eye(N)[JOINTS] if obs == "state" else READINGS[:2]
    inertia, bandwidth = np.diag(M)[JOINTS], 0.1 * env.core.scales.locked[0]
    stiffness, damping = inertia * bandwidth**2, 2.0 * 0.4 * inertia * bandwidth
    state, before = None, None

    def left(k: int) -> tuple[Array, Array]:
        way, slope = smooth(k * DT / rise)
        return start * (1.0 - way), -start * slope / rise

    for k in range(int(rise / DT) + 3):
        error, rate = start - 0.001 * k, np.array([0.01, -0.02])
        error += {2: 9.0, 3: -9.0}.get(k, 0.0)  # beyond the limits
        (found,), state = subject.predict(
            env.observed(joint_error=error[None], joint_rate=rate[None]), state, np.array([k == 0])
        )
        (_, last), (place, speed), (_, following) = left(k - 1), left(k), left(k + 1)
        coming, now = (following - speed) / DT, (following - last) / DT / 2.0
        offset = place + angles @ bent_by(now)
        change = (offset - (offset if before is None else before)) / DT
        before = offset
        forward = M[np.ix_(JOINTS, JOINTS)] @ coming
        torque = forward - stiffness * (error - offset) - damping * (rate - change)
        np.testing.assert_allclose(found, np.clip(torque / LIMIT, -1.0, 1.0), atol=1e-9)
        bent = np.abs(BENDS @ bent_by(now)) / DEFLECTION
        most = max(most, np.abs(forward / LIMIT).max(), bent.max())
    assert most == pytest.approx(load, rel=0.03)


def test_torques_ahead_are_those_of_the_path_that_is_seen() -> None:
    """Along sines, half a move time and one ahead; beyond it goes on evenly."""
    env, ahead = Environment(moving=True), np.array([0.3, 1.2, 2.0])
    planner, preview = Planner(env, env.models), Preview(env, env.models, ahead)

    def path(t: Any, order: int = 0) -> Array:
        w = np.array([1.0, 0.7])
        return np.array([0.3, -0.2]) * w**order * np.sin(w * t + 0.5 * np.pi * order)

    plan, seen = None, None
    for k in range(40):
        t, fresh = k * DT, np.array([k == 0])
        shown = env.observed(
            target_rate=path(t, 1)[None], target_near=(path(t + 0.5 * MOVE_TIME) - path(t))[None],
            target_far=(path(t + MOVE_TIME) - path(t))[None],
        )  # fmt: skip
        plan = planner.follow(shown, plan, fresh)
        seen = preview.see(shown, plan.target, seen, fresh)
    np.testing.assert_allclose(plan.target.way[0], path(t), atol=1e-5)
    np.testing.assert_allclose(plan.target.now[0], path(t, 2), rtol=1e-2)
    (found,) = preview.torques(plan.target, seen, np.array([0]))
    inertia = M[np.ix_(JOINTS, JOINTS)]
    for torque, later in zip(found[:2], ahead, strict=False):
        np.testing.assert_allclose(torque, inertia @ path(t + later, 2), rtol=0.02)
    np.testing.assert_allclose(found[2], 0.0, atol=1e-9)


def test_every_plant_has_its_own_reference() -> None:
    """Of payloads in between, and bent by each one's stiffness."""
    env, rng = (
        Environment(payloads=(0.0, 0.1, 0.4), factors=(0.8, 1.0, 1.2)),
        np.random.default_rng(0),
    )
    coming = rng.normal(size=(2, 2))
    course = Course(*np.zeros((3, 2, 2)), coming, coming)
    offset, forward = Reference(env.models, range(9)).along(course)
    a = np.zeros((2, N))
    a[:, JOINTS] = coming
    for p, plant in enumerate(env.models.plants):
        forces = a @ plant.model.M
        np.testing.assert_allclose(forward[:, p], forces[:, JOINTS])
        np.testing.assert_allclose((offset[:, p] @ plant.K)[:, MODAL], -forces[:, MODAL])
        np.testing.assert_allclose(offset[:, p] @ TIP.T, 0.0, atol=1e-12)


def test_torques_are_held_for_whole_blocks() -> None:
    assert blocks_of(9) == [0, 1, 2, 3, 4, 5, 6, 6, 7]
    assert np.bincount(blocks_of(34)).tolist() == [*BLOCKS, *[BLOCKS[-1]] * 4]


def far(env: Environment, size: float, ahead: Array) -> Estimate:
    """Estimate whose joints are off, and links bent."""
    model = env.models.at(STILL)
    x = np.concatenate([model.modes @ (size * np.array([1.0, 0.08, -0.7, 0.05])), np.zeros(N)])
    return Estimate(model, x, ahead[0], ahead[1:])


@pytest.mark.parametrize(("size", "margin"), [(0.02, 1e3), (0.2, 1e3), (0.6, 0.7)])
def test_predictive_control_is_the_cheapest_motion_within_its_limits(
    size: float, margin: float
) -> None:
    """Of simulated motions, by SciPy: torques within their limits, and bending at its price."""
    env = Environment()
    model = env.models.at(STILL)
    cost, Q, R = cost_of(env, model)
    P = riccati(model.A, model.B, Q, R)
    law = Predictive(env, cost, horizon=0.12, margin=margin)  # 9 steps in 8 blocks
    count = law.blocks[-1] + 1
    ahead = 0.2 * LIMIT * np.random.default_rng(0).uniform(-1.0, 1.0, (count, 2))
    estimate = far(env, size, ahead)
    x, rows = [estimate.x], [np.zeros((2 * N, 2 * count))]
    for block in law.blocks:
        push = np.zeros((2 * N, 2 * count))
        push[:, 2 * block : 2 * block + 2] = model.B * LIMIT
        x.append(model.A @ x[-1])
        rows.append(model.A @ rows[-1] + push)
    ends = [k + 1 for k, b in enumerate(law.blocks) if b not in law.blocks[k + 1 :]]
    bends = np.array([[1, 0, 0, 0], [0, 0, 1, 0]]) @ model.bend / DEFLECTION
    bent = np.concatenate([bends @ x[k][:N] for k in ends])
    bending = np.vstack([bends @ rows[k][:N] for k in ends])
    weights = [*[Q] * (len(law.blocks) - 1), P]
    H = sum(row.T @ W @ row for row, W in zip(rows[1:], weights, strict=True))
    H += np.diag(np.repeat(np.bincount(law.blocks), 2) * np.tile(np.diag(R) * LIMIT**2, count))
    f = sum(row.T @ W @ y for row, W, y in zip(rows[1:], weights, x[1:], strict=True))
    H, f = block_diag(H, PRICE) / np.diag(H).max(), np.append(f, 0.0) / np.diag(H).max()
    scale = np.append(np.ones(2 * count), 1.0 / np.sqrt(H[-1, -1]))
    H, f = H * np.outer(scale, scale), f * scale
    slack = np.full((len(bent), 1), scale[-1])
    shares = (ahead / LIMIT).ravel()
    unit = np.eye(2 * count + 1)[:-1]
    limits = [
        LinearConstraint(unit, -1.0 - shares, 1.0 - shares),
        LinearConstraint(np.hstack([bending, -slack]), -np.inf, margin - bent),
        LinearConstraint(np.hstack([bending, slack]), -margin - bent, np.inf),
    ]
    best = minimize(
        lambda u: (u @ (f + 0.5 * H @ u), f + H @ u), 0.0 * f, jac=True, method="SLSQP",
        constraints=limits, options={"ftol": 1e-14, "maxiter": 300},
    ).x  # fmt: skip
    (found,) = law([estimate])
    np.testing.assert_allclose(found, ahead[0] + LIMIT * best[:2], atol=2e-4 * LIMIT.max())
    assert (margin < 1.0) == (best[-1] * scale[-1] > 1e-3)


@pytest.mark.parametrize("size", [1e-3, 0.02, 0.1])
def test_nonlinear_predictive_control_of_a_linear_arm_is_linear(size: float) -> None:
    """Near the target that of LQR; the motion is linearized as the model has it."""
    env = Environment(payloads=(0.0, 0.3))
    model = env.models.at(STILL)
    cost, _, _ = cost_of(env, model)
    law = nmpc.Nonlinear(env, cost, horizon=0.08, margin=1e3)
    estimate = far(env, size, np.zeros((len(set(law.blocks)), 2)))
    scene = law._scene([estimate])
    A, B = law._linearized(scene, law._closed_loop(scene), 0)
    np.testing.assert_allclose(A[3].T, model.A, atol=1e-8)
    np.testing.assert_allclose(B[5].T, model.B * LIMIT, atol=1e-8)
    (found,) = law([estimate])
    linear = Predictive(env, cost, horizon=0.08, margin=1e3)([estimate])[0]
    np.testing.assert_allclose(found, linear, atol=1e-5)
    near = np.abs(Gain(cost)([estimate])[0] / LIMIT).max() < 0.5
    assert near == (size < 0.01)
    if near:
        np.testing.assert_allclose(found, Gain(cost)([estimate])[0], rtol=0.05, atol=1e-3)


def test_costs_of_motions_are_added_up_to_the_cost_to_go() -> None:
    """Of torques, states and bending beyond the margin."""
    env = Environment()
    model = env.models.at(STILL)
    cost, Q, R = cost_of(env, model)
    law = nmpc.Nonlinear(env, cost, horizon=0.12, margin=0.7)
    scene = law._scene([far(env, 0.6, np.zeros((1, 2)))])
    moved = law._closed_loop(scene)
    x, P = moved.x[1:, 0, 0], riccati(model.A, model.B, Q, R)
    torques = LIMIT * moved.action[:, 0, 0]
    bent = np.abs(x[:, :N] @ model.bend.T) / DEFLECTION
    expected = sum(u @ R @ u for u in torques) + sum(y @ Q @ y for y in x[:-1]) + x[-1] @ P @ x[-1]
    expected += PRICE * np.sum(np.maximum(bent - 0.7, 0.0) ** 2)
    assert bent.max() > 0.7
    assert law._costs(scene, moved).item() == pytest.approx(expected)
