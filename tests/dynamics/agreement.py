"""Comparisons that tests of several kinds of arm share."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from dynamics import Arm, Model
from dynamics.formulations import articulated_body, gibbs_appell
from dynamics.types import Array
from tests.dynamics import brute_force
from tests.dynamics.random_arms import (
    compiled,
    floats,
    random_state,
    random_torque,
    torque_matrix,
)


def composite(arm: Arm, q: Array, v: Array, equations: Any = gibbs_appell) -> tuple[Array, Array]:
    """M and h of the recursion on floats."""
    chain = compiled(arm).chain
    M = equations.mass_matrix(chain, floats(q))
    return np.array(M), np.array(equations.bias(chain, floats(q), floats(v)))


def accelerations(arm: Arm, q: Array, v: Array, tau: Array) -> Array:
    """Accelerations by the O(n) recursion on floats."""
    chain = compiled(arm).chain
    return np.array(articulated_body.accelerations(chain, floats(q), floats(v), floats(tau)))


def central(f: Callable[[float], Any], step: float = 1e-5) -> Any:
    """Derivative at zero by central differences of order four."""
    return (8.0 * (f(step) - f(-step)) - (f(2 * step) - f(-2 * step))) / (12.0 * step)


def assert_slopes(model: Model, A: Array, q: Array, v: Array, tau: Array) -> None:
    """Compare the lower rows of A (2n, 2n) with differences of the accelerations."""
    n, size = model.n, np.abs(A[model.n :]).max()
    for k, e in enumerate(np.eye(n)):
        by_q = central(lambda x, e=e: model.accelerations(q + x * e, v, tau))
        by_v = central(lambda x, e=e: model.accelerations(q, v + x * e, tau))
        assert_allclose(A[n:, k], by_q, rtol=0.0, atol=1e-6 * size)
        assert_allclose(A[n:, n + k], by_v, rtol=0.0, atol=1e-6 * size)


def assert_equations(arm: Arm, q: Array, v: Array) -> None:
    """Compare M and h of the recursion with energies of all bodies and forces by definition."""
    M, h = composite(arm, q, v)
    expected = brute_force.mass_matrix(arm, q)
    forces = brute_force.inertial_forces(arm, q, v, 0.0 * v)
    forces += brute_force.resisting_forces(arm, q, v)
    assert_allclose(M, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())
    assert_allclose(h, forces, rtol=0.0, atol=1e-11 * np.abs(forces).max())
    assert np.array_equal(M, M.T)


def assert_eliminated(arm: Arm, q: Array, v: Array) -> None:
    """Compare O(n) accelerations with M a = B tau - h."""
    tau = random_torque(arm)
    M, h = composite(arm, q, v)
    a = accelerations(arm, q, v, tau)
    assert brute_force.imbalance(M, a, torque_matrix(arm) @ tau - h) < 1e-13


def gibbs_residual(arm: Arm, M: Array, h: Array, a: Array) -> float:
    """Largest error of M a + h against the gradient of the energy of acceleration [-].

    M and h belong to `random_state(arm)`. Relative to the largest possible force on a coordinate,
    sqrt(M_kk 2 S).
    """
    q, v = random_state(arm)
    expected = brute_force.inertial_forces(arm, q, v, a) + brute_force.resisting_forces(arm, q, v)
    size = np.diag(composite(arm, q, v)[0]) * 2.0 * brute_force.acceleration_energy(arm, q, v, a)
    return float(np.abs((M @ a + h - expected) / np.sqrt(size)).max())


def assert_compiled(
    model: Model,
    lanes: int,
    within: float,
    expected: Callable[[Array, Array, Array], Array] | None = None,
) -> None:
    """Compare compiled accelerations in every lane, including a partly filled block.

    `within` is the largest error over the largest acceleration of a state; `expected` are those
    of the recursion on floats, unless they are given.
    """
    expected = expected or partial(accelerations, model.arm)
    count = lanes + 3
    q, v = np.stack([random_state(model.arm, seed) for seed in range(count)], axis=1)
    tau = np.stack([random_torque(model.arm, seed) for seed in range(count)])
    program, out = model.program(lanes, "rk4"), np.empty((count, model.n))

    program.evaluate_states(q, v, tau, np.empty((count, 0)), model.workspace(program), out)

    for k in range(count):
        a = expected(q[k], v[k], tau[k])
        assert_allclose(out[k], a, rtol=0.0, atol=within * np.abs(a).max())
    assert_allclose(model.accelerations(q[0], v[0], tau[0]), out[0], rtol=1e-12)


def assert_implicit(arm: Arm, M: Array, h: Array, guess: Array, s: float, d: float) -> None:
    """Compare implicit elimination with (M + W) a = B tau - h + W guess, W = s K + d C.

    M and h belong to `random_state(arm)`.
    """
    (q, v), tau = random_state(arm), random_torque(arm)
    implicit = articulated_body.Implicit([s] * arm.n, [d] * arm.n, floats(guess))
    a = articulated_body.accelerations(
        Model(arm).chain, floats(q), floats(v), floats(tau), implicit
    )
    augmented, load = brute_force.augmented(arm, M, torque_matrix(arm) @ tau - h, guess, s, d)
    assert brute_force.imbalance(augmented, a, load) < 1e-13
