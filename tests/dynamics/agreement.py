"""Comparisons that tests of several kinds of arm share."""

from collections.abc import Callable

import numpy as np
from numpy.testing import assert_allclose

from dynamics import Arm, Model
from dynamics.formulations import articulated_body
from dynamics.types import Array
from tests.dynamics import brute_force
from tests.dynamics.random_arms import floats, random_state, random_torque, torque_matrix


def recursion(model: Model) -> Callable[[Array, Array, Array], Array]:
    """Accelerations by the recursion on floats."""
    return lambda q, v, tau: np.array(
        articulated_body.accelerations(model.chain, floats(q), floats(v), floats(tau))
    )


def assert_compiled(
    model: Model, lanes: int, expected: Callable[[Array, Array, Array], Array], within: float
) -> None:
    """Compare compiled accelerations in every lane, including a partly filled block.

    `within` is the largest error over the largest acceleration of a state.
    """
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
