"""Tip motions with converged integration, and the motions that are refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ARMS, simulate
from dynamics.accuracy.rollout import SAMPLES, NotConverged, Rollout
from dynamics.accuracy.scene import JointMotion, bang_bang, release
from dynamics.integrators.table import INTEGRATORS
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


def steady(t: float) -> np.ndarray:
    return np.array([1.0, -0.5])


SLOW_TO_COMPILE = {"rosenbrock": pytest.mark.slow}


@pytest.mark.parametrize(
    "integrator",
    [pytest.param(name, marks=SLOW_TO_COMPILE.get(name, ())) for name in INTEGRATORS],
)
def test_traced_steps_are_the_compiled_steps(integrator: str) -> None:
    """`simulate` restarts a method at each step of a varying torque: some get a steady one."""
    method = INTEGRATORS[integrator]
    signal = steady if method.implicit or method.kept(1) else swinging
    arm = replace(two_link_spatial(), foreshortening=True)
    start = {"joint_angles": (0.3, 0.5), "joint_rates": (1.0, -1.0)}
    motion = JointMotion(**start, t_end=0.1, torque=signal)
    model = compiled(arm)
    q, v = np.zeros(model.n), np.zeros(model.n)
    q[list(arm.joint_index)], v[list(arm.joint_index)] = start.values()
    torque = steady(0.0) if signal is steady else signal
    dt = 0.1 / 256
    end = simulate(model, q, v, torque, [0.0, 0.1], integrator=integrator, dt=dt).tip[-1]
    assert_allclose(Rollout(arm).tips(motion, integrator, dt)[-1], end, rtol=0.0, atol=1e-11)
