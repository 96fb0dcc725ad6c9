"""Linear model predictive control: LQR's cost under limits of torque and of bending.

Every control step solves a quadratic program over a horizon, behind which LQR's cost-to-go counts:
deviations of the torques from the reference's are held for BLOCKS of control steps, and no link may
bend beyond a share of its limit along y or along z, which yields at a price where that cannot be
kept (soft rows; see Maciejowski, Predictive Control with Constraints, 2002, section 3.4). A link
that bends in both planes at once may bend by up to 1.41 times the share. Where the target moves,
what `preview.py` knows of its path leaves each block its share of the torque. DAQP solves the
program to rounding error by an active-set method, so that no torque depends on what was solved
before.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from agents.controllers.lqr import Cost, ModelBased, model_based, riccati
from agents.controllers.models.linear_model import LinearModel
from agents.controllers.models.memory import kept
from agents.controllers.observers.exact import Estimate
from dynamics.extras import missing
from dynamics.types import Array

BLOCKS = (1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 4)  # control steps that share a torque; the last repeats
PROGRAMS = 512  # kept; one of six links takes more than a megabyte
PRICE = 1e7  # of bending beyond the share, over that of a tip error as wide as the settled band
CAUTION = 4.0  # surprise by which a heavier plant may exceed the likeliest: seven times less likely
MOST_STEPS = 10_000  # of a horizon
ABSURD = 1e12  # modal coordinates and rates; far larger ones the solver refuses without a word


@dataclass
class _Program:
    """Program of one plant at one posture; the unknowns are V torques and a slack.

    Its rows are the unknowns, then the b deflections at the ends of the blocks, over their limit:
    once less the slack, with upper bounds, and once plus the slack, with lower ones.
    """

    solver: Any
    by_state: Array  # (V + 1 + b, 2r) linear cost of the unknowns, then the deflections, per state
    lower: Array  # (V + 1 + 2b,) bounds of the last state
    upper: Array


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
        forward, limit = np.array([estimate.forward for estimate in estimates]), self.cost.limit
        ahead = np.array([estimate.ahead for estimate in estimates])
        shares = np.concatenate([forward[:, None], ahead], axis=1) / limit
        rows = zip(estimates, shares.reshape(len(estimates), -1), strict=True)
        return forward + limit * np.array([self._share(*row) for row in rows])

    def _share(self, estimate: Estimate, shares: Array) -> Array:
        """(m,) first torques over the limits, less the reference's; its own are (V,) `shares`."""
        largest = np.abs(estimate.x).max()
        if not largest < ABSURD:
            raise FloatingPointError(
                f"Predictive control got a state of {largest:.3g} in modal coordinates from its "
                "observer, which has diverged; use finite observations."
            )
        program, size = self._program(estimate.model), shares.size
        products, lower, upper = program.by_state @ estimate.x, program.lower, program.upper
        bent, high = products[size + 1 :], len(products)
        lower[:size], upper[:size] = -1.0 - shares, 1.0 - shares
        upper[size + 1 : high], lower[high:] = self.margin - bent, -self.margin - bent
        program.solver.update(f=products[: size + 1], blower=lower, bupper=upper)
        found, _, flag, _ = program.solver.solve()
        if flag <= 0:
            raise FloatingPointError(
                f"Predictive control got exit flag {flag} of DAQP for a state of at most "
                f"{largest:.3g} in modal coordinates; take a shorter horizon or a larger effort, "
                "which condition its program better."
            )
        return np.array(found[: self.cost.limit.size])

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
        products = np.vstack([scale * F, np.zeros(states), *bends])
        return _program(scale * H, np.vstack(rows), np.sqrt(PRICE * scale), products)


def _program(H: Array, rows: Array, price: float, by_state: Array) -> _Program:
    """Program of torques within [-1, 1], and a slack in units of which bending costs `price`."""
    size, count = len(H), len(rows)
    slack, free = np.full((count, 1), 1.0 / price), np.full(count, np.inf)
    lower = np.concatenate([np.full(size, -1.0), [0.0], -free, np.full(count, -1.0)])
    upper = np.concatenate([np.full(size, 1.0), [np.inf], np.full(count, 1.0), free])
    solver = quadratic_programs().Model()
    solver.setup(
        block_diag(H, 1.0), np.zeros(size + 1), np.block([[rows, -slack], [rows, slack]]),
        upper, lower,
    )  # fmt: skip
    return _Program(solver, by_state, lower, upper)


def quadratic_programs() -> Any:
    """The package that solves quadratic programs."""
    try:
        import daqp
    except ModuleNotFoundError as error:
        raise missing(error, "predictive control", "train") from None
    return daqp


def steps_of(core: Any, horizon: float) -> int:
    """Control steps of a horizon over the move time; a longer one than MOST_STEPS is refused."""
    steps = max(2, round(horizon * core.move_time / core.control_dt))
    if steps > MOST_STEPS:
        raise ValueError(
            f"horizon must be at most {MOST_STEPS * core.control_dt / core.move_time:.4g} here, "
            f"which is {MOST_STEPS:_} control steps, got {horizon:g}. Unit: [-], of the move time."
        )
    return steps


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


def predictive(
    env: Any, name: str, *, horizon: float, margin: float, **parameters: Any
) -> ModelBased:
    """Predictive control; the parameters are those of `model_based`.

    On filters it assumes the heaviest payload consistent with the readings, so that no plant among
    them bends too far; on a path, whose torques are the plant's own, it assumes the likeliest.
    """
    if "disturbance" in parameters and not env.unwrapped.core.task.moving:
        parameters["caution"] = CAUTION
    law = partial(Predictive, env, horizon=horizon, margin=margin)
    return model_based(env, name, law, times=_times(env, horizon), **parameters)
