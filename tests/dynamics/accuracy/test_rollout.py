"""Tip motions with converged integration, and the motions that are refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ARMS, Arm, Base, Joint, Link, Stepper, simulate
from dynamics.accuracy.fidelity import Fidelity
from dynamics.accuracy.rollout import SAMPLES, NotConverged, Rollout
from dynamics.accuracy.scene import JointMotion, bang_bang, release
from dynamics.integrators.table import INTEGRATORS
from dynamics.model import Model
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from tests.dynamics.random_arms import compiled, two_link_spatial

ARM, MOTION = ARMS["slim"], bang_bang((0.5,), pulse=0.25, t_end=1.0)
GROWTH = 40.0  # [1/s]


def path(exit_time: float) -> np.ndarray:
    """(N, 3) [m] tip that grows exponentially, to twice the reach at `exit_time` [s]."""
    t = np.linspace(0.0, MOTION.t_end, SAMPLES + 1)
    x = np.exp(np.minimum(GROWTH * (t - exit_time), 800.0)) * 2.0 * ARM.reach
    return np.stack([x, 0.0 * t, 0.0 * t], axis=1)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("first", [0.005, 0.4])
def test_steps_that_diverge_are_refined(monkeypatch: pytest.MonkeyPatch, first: float) -> None:
    """Halved steps diverge at twice the time, and finally not at all: the motion is bounded."""
    steps: list[float] = []

    def tips(self: Rollout, motion: Any, method: str, dt: float) -> np.ndarray:
        steps.append(dt)
        return path(min(first * steps[0] / dt, 3.0 * MOTION.t_end))

    monkeypatch.setattr(Rollout, "tips", tips)
    converged = Rollout(ARM).converged(MOTION, 1e-6)
    np.testing.assert_allclose(converged, path(3.0 * MOTION.t_end), atol=1e-6)


def test_a_motion_that_diverges_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nearly the same exit time with two steps is enough."""
    steps: list[float] = []

    def tips(self: Rollout, motion: Any, method: str, dt: float) -> np.ndarray:
        steps.append(dt)
        return path(0.5 + dt)

    monkeypatch.setattr(Rollout, "tips", tips)
    with pytest.raises(NotConverged, match=r"leaves the reach \(1\.\d+ m\)"):
        Rollout(ARM).converged(MOTION, 1e-6)
    assert len(steps) == 2


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_motion_that_overflows_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The finer steps may overflow before the coarser ones leave the reach."""
    motion, fixed = replace(MOTION, torque=lambda t: (1e9,)), Rollout._states

    def states(self: Rollout, *given: Any) -> Any:
        rows = fixed(self, motion, "rk4", 1e-3, 1, False)
        assert not np.isfinite(rows[-1]).all()
        return [rows[0]] * (SAMPLES // 2 - 1) + rows

    monkeypatch.setattr(Rollout, "_states", states)
    monkeypatch.setattr(Rollout, "tips", lambda *given: path(0.5 * MOTION.t_end))
    with pytest.raises(NotConverged, match="leaves the reach"):
        Rollout(ARM).converged(MOTION, 1e-6)


def test_an_arm_without_inertia_is_not_blamed_on_the_motion() -> None:
    """The twist of link 2 turns almost nothing where the links beyond are in line."""
    post = Link(length=0.25, rho_A=1.2, joint=Joint(rotor_inertia=0.05))
    level = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    upper = Link(length=0.6, rho_A=0.35, EIz=18.0, EIy=25.0, GJ=9.0, rho_Ip=1e-6, modes=(),
                 joint=Joint(rotation=level, rotor_inertia=0.03))  # fmt: skip
    fore = Link(length=0.5, rho_A=0.2, EIz=6.0, EIy=8.0, tip_mass=0.3, modes=(),
                joint=Joint(rotor_inertia=0.02))  # fmt: skip
    arm = Arm(links=(post, upper, fore), gravity=(0.0, 0.0, -9.81))
    counts = ((0, 0, 0), (1, 1, 1), (4, 4, 0))
    model = Fidelity(counts=counts, segments=(1, 1, 1), foreshortening=True, polynomial=True)
    motion = JointMotion(joint_angles=(0.0, 0.6, 0.6), joint_rates=(0.0, 0.0, 0.0), t_end=0.2,
                         torque=lambda t: (2.0, 8.0, 3.0))  # fmt: skip
    with pytest.raises(NotConverged, match=r"mass matrix .* no longer positive: .* Give rho_Ip"):
        Rollout(model.arm(arm)).converged(motion, 1e-4)


@pytest.mark.parametrize("beta", [0.0, 0.1])
def test_the_bound_on_eigenvalues_includes_damping(beta: float) -> None:
    """Under strong damping a decay rate exceeds every frequency and limits explicit steps."""
    arm = two_link_spatial(gravity=(0.0, 0.0, 0.0))
    arm = replace(arm, links=tuple(replace(link, damping_beta=beta) for link in arm.links))
    model = compiled(arm)
    A, _ = model.linearize(np.zeros(model.n), np.zeros(model.n), np.zeros(2))
    largest = np.abs(np.linalg.eigvals(A)).max()
    motion = release((0.0, 0.0), t_end=1.0)
    assert largest <= Rollout(arm).fastest(motion) * (1.0 + 1e-9) < 1.2 * largest


def swinging(t: float) -> np.ndarray:
    return np.array([np.cos(50.0 * t), -0.5])


SLOW_TO_COMPILE = {"rosenbrock": pytest.mark.slow}


ALL = [pytest.param(name, marks=SLOW_TO_COMPILE.get(name, ())) for name in INTEGRATORS]
START = {"joint_angles": (0.3, 0.5), "joint_rates": (1.0, -1.0)}


def compiled_start(model: Model) -> tuple[np.ndarray, np.ndarray]:
    q, v = np.zeros(model.n), np.zeros(model.n)
    q[list(model.arm.joint_index)], v[list(model.arm.joint_index)] = START.values()
    return q, v


@pytest.mark.parametrize("integrator", ALL)
def test_traced_steps_are_the_compiled_steps(integrator: str) -> None:
    """As used: `simulate` restarts a method at each step of a torque that is a function."""
    model = compiled(replace(two_link_spatial(), foreshortening=True))
    motion = JointMotion(**START, t_end=0.1, torque=swinging)
    end = simulate(
        model, *compiled_start(model), swinging, [0.0, 0.1], integrator=integrator, dt=0.1 / 256
    ).tip[-1]
    tips = Rollout(model.arm).tips(motion, integrator, 0.1 / 256, used=True)
    assert_allclose(tips[-1], end, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("integrator", ALL)
def test_steps_under_a_held_torque_are_those_of_a_stepper(integrator: str) -> None:
    """A stepper starts a method anew at each call, as an environment does at each control step."""
    model, substeps, calls = compiled(replace(two_link_spatial(), foreshortening=True)), 3, 32
    hold = 0.1 / calls
    held = PiecewiseConstant(
        times=tuple(hold * k for k in range(calls)), values=tuple(np.cos(range(calls)).tolist())
    )
    torque = Torque(signals=(held, None))
    stepper = Stepper(model, 1, dt=hold / substeps, substeps=substeps, integrator=integrator)
    stepper.q[0], stepper.v[0] = compiled_start(model)
    for k in range(calls):
        stepper.torque[0] = held.values[k], 0.0
        stepper.advance()
    motion = JointMotion(**START, t_end=calls * hold, torque=torque, hold=hold)
    run = Rollout(model.arm).run(motion, integrator, hold / substeps)
    assert run.dt == pytest.approx(hold / substeps)
    assert_allclose(run.tips[-1], model.tip(stepper.q[0]), rtol=0.0, atol=1e-11)


def test_restarts_are_part_of_the_error_and_of_the_cost() -> None:
    """Between restarts Numerov's method is of order four; its start is worth two evaluations."""
    arm = two_link_spatial()
    rollout, dt = Rollout(arm), 0.4 / 256
    free, held = (
        JointMotion(joint_angles=(0.3, 0.5), joint_rates=(1.0, -1.0), t_end=0.4, hold=hold)
        for hold in (None, 0.2)
    )
    truth = rollout.converged(held, 1e-10)
    anew, smooth = (rollout.run(x, "numerov", dt) for x in (free, held))
    errors = [np.abs(x.tips - truth[:: x.stride]).max() for x in (anew, smooth)]
    assert errors[0] > 3.0 * errors[1]
    costs = [rollout.cost(x, "numerov", dt) for x in (free, held)]
    assert 2.5 < costs[0] / costs[1] < 3.1


def test_a_settled_start_rests_under_the_torques_that_hold_it() -> None:
    """Statics beside dynamics: the tip stays, where straight links fall into a swing."""
    arm = replace(two_link_spatial(), gravity=(0.0, 3.0, -9.81))
    angles = START["joint_angles"]
    held = Model(arm).equilibrium(np.array(angles)).torque
    still = JointMotion(joint_angles=angles, joint_rates=(0.0,) * len(angles), t_end=0.1,
                        torque=lambda t: held, settled=True)  # fmt: skip
    moved = [
        np.ptp(Rollout(arm).tips(motion, "rk4", 0.1 / 256), axis=0).max()
        for motion in (still, replace(still, settled=False))
    ]
    assert moved[0] < 1e-9
    assert moved[1] > 1e-3


def test_a_free_base_moves_as_in_simulate() -> None:
    """The tip in the world: the frame of a free base follows it from step to step."""
    base = Base(
        type="free", mass=3.0, inertia=((0.2, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.4)),
        position=(0.3, -0.2, 0.1), quaternion=(0.8, 0.0, 0.6, 0.0), velocity=(0.1, 0.2, -0.1),
        angular_velocity_body=(0.2, -0.3, 0.4),
    )  # fmt: skip
    arm = replace(two_link_spatial(), base=base)
    motion = JointMotion(**START, t_end=0.1, torque=swinging)
    model = compiled(arm)
    q, v = (x[base.n :] for x in compiled_start(model))
    times = np.linspace(0.0, 0.1, 257)
    tips = simulate(model, q, v, swinging, times, integrator="rk4", dt=0.1 / 256).tip
    assert_allclose(Rollout(arm).tips(motion, "rk4", 0.1 / 256), tips, rtol=0.0, atol=1e-11)
    assert np.linalg.norm(tips[-1] - tips[0]) > 1e-3
