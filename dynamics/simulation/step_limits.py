"""Stability limits of integration steps, from the arm linearised at rest."""

from typing import Any

import numpy as np

from dynamics.formulations.linearized import LinearArm, linear_arm
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.model import Model
from dynamics.types import Array

# growth per step that counts as unstable, above the round-off of rigid motion's double roots
GROWS = 1e-5
RESOLUTION = 1e-4  # [-] relative accuracy of `largest_step`


class _Row(np.ndarray):
    """One slot's value in many perturbed states; `x += y` makes a new array, as with numbers."""

    def _refuse(self, other: Any) -> Any:
        return NotImplemented

    __iadd__ = __isub__ = __imul__ = __itruediv__ = _refuse


def fastest(model: Model, q: Array) -> float:
    """[rad/s] bound on the eigenvalues of the arm at rest at the joint angles of q (n,).

    The larger of the highest natural frequency with free joints and the highest decay rate from
    modal damping and joint friction, Coulomb friction with its steepest slope.
    """
    omega = float(model.frequencies(q, joints="free").max(initial=0.0))
    arm = linear_arm(model.chain, model.rigid(q))
    decays = np.linalg.eigvals(np.linalg.solve(arm.M, arm.C + arm.explicit))
    return max(omega, float(decays.real.max()))


def amplification(arm: LinearArm, integrator: str, dt: float) -> float:
    """Spectral radius of one step of `dt` [s] for small motions about rest.

    The integrator's own step runs on the linear arm, once per unit perturbation of the state; the
    results are the columns of the step's matrix.
    """
    method, n = INTEGRATORS[integrator], len(arm.M)
    Q, V, A, W, GUESS, S = 0, n, 2 * n, 3 * n, 5 * n, 6 * n
    size = S + method.kept(n)  # values that outlive a step
    places = Slots(n, Q, V, A, W, S, S + method.scratch(n))
    nothing = np.zeros(size + 1).view(_Row)

    def evaluate(w: Any) -> None:
        q, v, guess = (np.stack([nothing + x for x in w[at : at + n]]) for at in (Q, V, GUESS))
        stiffness, damping = (np.diag(w[at : at + n].astype(float)) for at in (W, W + n))
        implicit = stiffness @ arm.K + damping @ arm.C
        force = implicit @ guess - arm.K @ q - (arm.C + arm.explicit) @ v
        w[A:W] = [row.view(_Row) for row in np.linalg.solve(arm.M + implicit, force)]

    def jacobian(w: Any) -> None:
        for at, matrix in ((S, arm.K), (S + n * n, arm.C + arm.explicit)):
            w[at : at + n * n] = -np.linalg.solve(arm.M, matrix).ravel()

    aid = jacobian if method.aid == "jacobian" else arm.aid(method.aid)
    w = np.zeros(S + method.scratch(n) + n, dtype=object)  # torques come last
    w[:] = [nothing] * w.size
    w[W:GUESS] = 0.0
    state = [i for i in range(size) if not W <= i < GUESS]
    with np.errstate(all="ignore"):
        method.prepare(w, dt, places, aid)
        method.start(w, dt, evaluate, places, aid)
        method.step(w, dt, evaluate, places, aid)  # a first step may differ from later ones
        for column, i in enumerate(state):
            w[i] = w[i] + nothing  # the last column stays unperturbed
            w[i][column] += 1.0
        method.step(w, dt, evaluate, places, aid)
        after = np.stack([nothing + w[i] for i in state])
        matrix = after[:, : len(state)] - after[:, -1:]
    if not np.all(np.isfinite(matrix)):
        return float("inf")
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def largest_step(model: Model, q: Array, integrator: str, within: float) -> float:
    """[s] largest stable step, at most `within`, for small motions about rest at q (n,)."""
    arm = linear_arm(model.chain, model.rigid(q))
    if amplification(arm, integrator, within) < 1.0 + GROWS:
        return within
    low, high = 0.0, within
    while high - low > RESOLUTION * high:
        middle = 0.5 * (low + high)
        if amplification(arm, integrator, middle) < 1.0 + GROWS:
            low = middle
        else:
            high = middle
    return low
