"""Linear model predictive control: LQR's cost under limits of torque and of bending.

Every control step solves a quadratic program over a horizon, behind which LQR's cost-to-go counts:
deviations of the torques from the reference's are held for BLOCKS of control steps, and no link may
bend beyond a share of its limit, which yields at a price where that cannot be kept (soft rows; see
Maciejowski, Predictive Control with Constraints, 2002, section 3.4). Where the target moves, what
`preview.py` knows of its path leaves each block its share of the torque. DAQP solves the program to
rounding error by an active-set method, so that no torque depends on what was solved before.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from agents.controllers.lqr import Cost, Filters, ModelBased, OutputFeedback, riccati
from agents.controllers.models.linear_model import LinearModel
from agents.controllers.models.memory import kept
from agents.controllers.observers.exact import Estimate, ExactState
from agents.controllers.observers.kalman import KalmanFilters
from dynamics.extras import missing
from dynamics.types import Array

BLOCKS = (1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 4)  # control steps that share a torque; the last repeats
PROGRAMS = 512  # kept; one of six links takes more than a megabyte
PRICE = 1e7  # of bending beyond the share, over that of a tip error as wide as the settled band
CAUTION = 4.0  # surprise by which a heavier plant may exceed the likeliest: seven times less likely
ABSURD = 1e12  # modal coordinates and rates; far larger ones the solver refuses without a word


@dataclass
class _Program:
    """Program of one plant at one posture; the unknowns are V torques and a slack."""

    solver: Any
    linear: Array  # (V, 2r) linear cost per state
    bends: Array  # (b, 2r) deflections at the ends of the blocks per state, over their limit


class Predictive:
    """Law of `ModelBased`: the first torque of the best sequence."""

    def __init__(self, env: Any, cost: Cost, *, horizon: float, margin: float) -> None:
        core = env.unwrapped.core
        self.cost, self.margin = cost, margin
        self.deflection_limit = core.arguments["deflection_limit"]
        self.blocks = blocks_of(steps_of(core, horizon))
        self._program = kept(self._made, PROGRAMS)

    def __call__(self, estimates: list[Estimate]) -> Array:
        """(N, m) [N m] torques."""
        return np.array([self._torque(estimate) for estimate in estimates])

    def _torque(self, estimate: Estimate) -> Array:
        if not np.abs(estimate.x).max() < ABSURD:
            raise FloatingPointError(
                f"Predictive control got a state of {np.abs(estimate.x).max():.3g} in modal "
                "coordinates from its observer, which has diverged; use finite observations."
            )
        program, limit = self._program(estimate.model), self.cost.limit
        bent = program.bends @ estimate.x
        free = np.full(bent.size, np.inf)
        torques = np.vstack([estimate.forward, estimate.ahead]) / limit
        least, most = ((x - torques).ravel() for x in (-1.0, 1.0))
        program.solver.update(
            f=np.append(program.linear @ estimate.x, 0.0),
            blower=np.concatenate([least, [0.0], -free, -self.margin - bent]),
            bupper=np.concatenate([most, [np.inf], self.margin - bent, free]),
        )
        found, _, flag, _ = program.solver.solve()
        if flag <= 0:
            raise FloatingPointError(
                f"Predictive control got exit flag {flag} of DAQP for a state of at most "
                f"{np.abs(estimate.x).max():.3g} in modal coordinates; take a shorter horizon or "
                "a larger effort, which condition its program better."
            )
        return estimate.forward + limit * found[: limit.size]

    def _made(self, model: LinearModel) -> _Program:
        m, limit = self.cost.limit.size, self.cost.limit
        (Q, R), B = self.cost.of(model), model.B * limit
        P = riccati(model.A, model.B, Q, R)
        D = model.bend[np.any(model.bend, axis=1)] / self.deflection_limit
        blocks = self.blocks
        size, states = m * (blocks[-1] + 1), len(model.A)
        by_torque, by_state = np.zeros((states, size)), np.eye(states)
        H, F, rows, bends = np.zeros((size, size)), np.zeros((size, states)), [], []
        for k, block in enumerate(blocks):
            at = slice(m * block, m * (block + 1))
            H[at, at] += R * np.outer(limit, limit)
            by_torque, by_state = model.A @ by_torque, model.A @ by_state
            by_torque[:, at] += B
            weight = P if k == len(blocks) - 1 else Q
            H += by_torque.T @ weight @ by_torque
            F += by_torque.T @ weight @ by_state
            if block not in blocks[k + 1 :]:
                rows.append(D @ by_torque[: D.shape[1]])
                bends.append(D @ by_state[: D.shape[1]])
        scale = 1.0 / np.abs(np.diag(H)).max()
        solver = _solver(scale * H, np.vstack(rows), np.sqrt(PRICE * scale))
        return _Program(solver, scale * F, np.vstack(bends))


def _solver(H: Array, rows: Array, price: float) -> Any:
    """Solver of torques within [-1, 1], and a slack in units of which bending costs `price`."""
    size, count = len(H), len(rows)
    slack, free = np.full((count, 1), 1.0 / price), np.full(count, np.inf)
    solver = quadratic_programs().Model()
    solver.setup(
        block_diag(H, 1.0), np.zeros(size + 1), np.block([[rows, -slack], [rows, slack]]),
        np.concatenate([np.full(size, 1.0), [np.inf], np.full(count, 1.0), free]),
        np.concatenate([np.full(size, -1.0), [0.0], -free, np.full(count, -1.0)]),
    )  # fmt: skip
    return solver


def quadratic_programs() -> Any:
    """The package that solves quadratic programs."""
    try:
        import daqp
    except ModuleNotFoundError as error:
        raise missing(error, "predictive control", "train") from None
    return daqp


def steps_of(core: Any, horizon: float) -> int:
    """Control steps of a horizon over the move time."""
    return max(2, round(horizon * core.move_time / core.control_dt))


def blocks_of(steps: int) -> list[int]:
    """Index of the block of every control step of the horizon."""
    found: list[int] = []
    for k, length in enumerate((*BLOCKS, *[BLOCKS[-1]] * steps)):
        found += [k] * length
    return found[:steps]


def _times(env: Any, horizon: float) -> Array:
    """(K,) [s] middles of the blocks after the first, from now."""
    core = env.unwrapped.core
    blocks = np.array(blocks_of(steps_of(core, horizon)))
    middles = [np.flatnonzero(blocks == k).mean() + 0.5 for k in range(1, blocks[-1] + 1)]
    return core.control_dt * np.array(middles)


class MPC(ModelBased):
    """Predictive control on exact states; needs obs="state"."""

    def __init__(
        self, env: Any, *, effort: float, lead: float, horizon: float, margin: float
    ) -> None:
        observer = ExactState(env, "mpc", times=_times(env, horizon))
        cost = Cost(env, observer.models, effort=effort, lead=lead)
        super().__init__(env, observer, Predictive(env, cost, horizon=horizon, margin=margin))


class KalmanMPC(OutputFeedback):
    """Predictive control on the Kalman filters of LQG; needs obs="sensors".

    It believes in the heaviest plant that its readings allow, so that the links of none of them
    bend too far; on a path, whose torques are the plant's own, in the likeliest.
    """

    def __init__(
        self, env: Any, *, effort: float, lead: float, horizon: float, margin: float,
        disturbance: float, filters: Filters = KalmanFilters, name: str = "mpc-kalman",
    ) -> None:  # fmt: skip
        caution = 0.0 if env.unwrapped.core.task.moving else CAUTION
        times = _times(env, horizon)
        observer = filters(env, name, disturbance, times=times, caution=caution)
        cost = Cost(env, observer.models, effort=effort, lead=lead)
        super().__init__(env, observer, Predictive(env, cost, horizon=horizon, margin=margin))
