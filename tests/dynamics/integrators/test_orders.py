"""Order of every method's own functions, without an arm, beside error control."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from dynamics.integrators.exponential import FrozenModes
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.types import Array

N = 3
RNG = np.random.default_rng(3)
ROOT, STIFF, LOSS = RNG.uniform(-0.4, 0.4, (3, N, N))
M = np.eye(N) + ROOT @ ROOT.T
K = np.diag([0.0, 6.0, 9.0]) + np.pad((STIFF @ STIFF.T)[1:, 1:], ((1, 0), (1, 0)))
C = np.diag([0.0, 0.5, 0.2])
B, TAU = RNG.uniform(-1.0, 1.0, (N, 2)), np.array([0.7, -0.4])
START = np.array([0.3, -0.2, 0.4, 0.5, 0.1, -0.6])
Q, V, A, IMPLICIT, GUESS, T, S = (k * N for k in (0, 1, 2, 3, 5, 6, 7))
END, COARSE = 1.0, 48  # [s], steps


def force(q: Array, v: Array) -> Array:
    """Forces but those of K and C: of a torque, and of rates and posture."""
    return B @ TAU + 0.6 * np.sin(q + np.roll(q, 1)) - 0.4 * v * np.roll(v, 1)


def slope(_: float, x: Array) -> Array:
    q, v = x[:N], x[N:]
    return np.concatenate([v, np.linalg.solve(M, force(q, v) - K @ q - C @ v)])


def evaluate(w: Array) -> None:
    """Accelerations, with shares of stiffness and damping in the mass matrix."""
    stiffness, damping = np.diag(w[IMPLICIT : IMPLICIT + N]), np.diag(w[IMPLICIT + N : GUESS])
    implicit = stiffness @ K + damping @ C
    q, v, guess = w[Q:V], w[V:A], w[GUESS:T]
    total = implicit @ guess + force(q, v) - K @ q - C @ v
    w[A:IMPLICIT] = np.linalg.solve(M + implicit, total)


def jacobian(w: Array) -> None:
    """Derivatives of the accelerations by coordinates and rates, by complex steps."""
    for k in range(2):
        for i in range(N):
            x = w[:A].astype(complex)
            x[k * N + i] += 1e-30j
            column = slope(0.0, x)[N:].imag / 1e-30
            w[S + k * N * N + i : S + (k + 1) * N * N : N] = column


def modes() -> FrozenModes:
    squares, shapes = eigh(K, M)
    decays = np.diag(shapes.T @ C @ shapes)
    elastic = squares > 1e-9
    return FrozenModes(squares * elastic, decays * elastic, shapes.T @ M, shapes, shapes.T @ B)


AIDS = {
    "none": None,
    "modes": modes(),
    "explicit steps": np.full(N, np.inf),
    "jacobian": jacobian,
}


def final(name: str, steps: int) -> Array:
    """State at the end, by so many steps."""
    method, h = INTEGRATORS[name], END / steps
    w = np.zeros(S + method.scratch(N))
    w[:A], w[T : T + 2] = START, TAU
    at = Slots(n=N, q=Q, v=V, a=A, implicit=IMPLICIT, s=S, tau=T)
    aid = AIDS[method.aid]
    method.prepare(w, h, at, aid)
    method.start(w, h, evaluate, at, aid)
    for _ in range(steps):
        method.step(w, h, evaluate, at, aid)
    return w[:A]


@pytest.mark.parametrize("name", INTEGRATORS)
def test_error_falls_at_the_order_of_the_method(name: str) -> None:
    exact = solve_ivp(slope, (0.0, END), START, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    errors = [np.abs(final(name, COARSE * k) - exact).max() for k in (1, 2)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(INTEGRATORS[name].order, abs=0.1)


def test_arms_that_share_a_workspace_are_stepped_as_each_alone() -> None:
    """By the method whose loops over lanes are its own; every other one counts coordinates."""
    method, h = INTEGRATORS["rosenbrock"], 0.1
    alone = np.zeros((2, S + method.scratch(N)))
    alone[:, :A] = START, START[::-1]
    alone[:, T : T + 2] = TAU
    shared = alone.T.copy()
    at = Slots(N, Q, V, A, IMPLICIT, S)
    for w in alone:
        method.step(w, h, evaluate, at, jacobian)

    def all_of(one: Callable[[Array], None]) -> Callable[[Array], None]:
        return lambda _: [one(w) for w in shared.T] and None

    both = Slots(*(2 * slot for slot in at[:6]), lanes=2)
    method.step(shared.reshape(-1), h, all_of(evaluate), both, all_of(jacobian))
    np.testing.assert_allclose(shared[:A].T, alone[:, :A], rtol=1e-12)
