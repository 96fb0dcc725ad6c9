"""Every formulation on one arm, so that a minute tells; on others in test_formulations.py."""

import numpy as np
import pytest

from dynamics.formulations.articulated_body import Implicit
from dynamics.formulations.linearized import damping, stiffness
from dynamics.formulations.table import FORMULATIONS
from dynamics.types import Array
from tests.dynamics.random_arms import (
    compiled,
    floats,
    random_arm,
    random_state,
    random_torque,
    torque_matrix,
)

ARM = random_arm(4, 3, 3)
CHAIN = compiled(ARM).chain
every = pytest.mark.parametrize("name", FORMULATIONS)


@every
def test_accelerations_solve_the_equations_also_with_implicit_forces(name: str) -> None:
    (q, v), tau = map(floats, random_state(ARM)), random_torque(ARM)
    equations, solve = FORMULATIONS[name].equations, FORMULATIONS[name].accelerations
    M = np.array(equations.mass_matrix(CHAIN, q))
    drive = torque_matrix(ARM) @ tau - equations.bias(CHAIN, q, v)
    np.testing.assert_allclose(M @ solve(CHAIN, q, v, floats(tau)), drive, **close(drive))
    guess, W = np.linspace(-1.0, 2.0, ARM.n), 1e-5 * stiffness(CHAIN) + 1e-3 * damping(CHAIN)
    implicit = Implicit([1e-5] * ARM.n, [1e-3] * ARM.n, floats(guess))
    a = solve(CHAIN, q, v, floats(tau), implicit)
    np.testing.assert_allclose((M + W) @ a, drive + W @ guess, **close(drive))


@every
def test_every_formulation_has_the_mass_matrix_and_forces_of_the_recursion(name: str) -> None:
    q, v = map(floats, random_state(ARM))
    own, known = FORMULATIONS[name].equations, FORMULATIONS["gibbs_appell"].equations
    M, other = (np.array(x.mass_matrix(CHAIN, q)) for x in (own, known))
    np.testing.assert_allclose(M, other, **close(other))
    h, other = (np.array(x.bias(CHAIN, q, v)) for x in (own, known))
    np.testing.assert_allclose(h, other, **close(other))


def close(x: Array) -> dict[str, float]:
    return {"rtol": 0.0, "atol": 1e-11 * float(np.abs(x).max())}
