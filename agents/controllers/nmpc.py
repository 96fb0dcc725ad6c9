"""Nonlinear model predictive control: LQR's cost over a horizon of the nonlinear arm's motion.

Every control step takes one step of sequential quadratic programming (real-time iteration: Diehl,
Bock and Schloeder, A real-time iteration scheme for nonlinear optimization in optimal feedback
control, SIAM J. Control and Optimization 43, 2005). It starts from the motion to which LQR leads
under the limits of torque, linearizes this motion at every control step, and finds the torques that
cost least there. Of several shares of this change the one is taken whose motion costs least on the
nonlinear arm; it may be none. So the linearization may be coarse: where the motions take many
integration steps, and the method stands any step, it takes a single one.

Behind the horizon LQR's cost-to-go counts, torques change in the blocks of linear predictive
control, and no link may bend beyond a share of its limit along y or z, which yields at a price.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from agents.controllers.lqr import Cost, ModelBased, gain, model_based, riccati
from agents.controllers.models.linear_model import LinearModel
from agents.controllers.models.memory import kept
from agents.controllers.models.nonlinear import PlantSteppers
from agents.controllers.mpc import CAUTION, PRICE, blocks_of, quadratic_programs, steps_of
from agents.controllers.observers.exact import Estimate, alike
from agents.controllers.observers.extended import ExtendedFilters
from dynamics.integrators.table import INTEGRATORS
from dynamics.runtime.jit import outermost
from dynamics.types import AnyArray, Array

SHARES = np.array([1.0, 0.7, 0.5, 0.35, 0.2, 0.1, 0.05])  # of a change, tried beside none
PLACE, RATE, ACTION = 1e-5, 1e-4, 1e-3  # differences of modal coordinates, their rates, actions
KEPT = 2048  # terms of costs
MANY = 3  # integration steps of a control step; from so many on a linearization takes one
SOFT = 8  # mark of rows that the solver may break where it must


@dataclass(frozen=True, eq=False)
class _Terms:
    """Cost of one plant at one posture; actions are torques over their limits."""

    Q: Array  # (2r, 2r)
    P: Array  # (2r, 2r) cost-to-go
    gain: Array  # (2r, m) of LQR, transposed
    bend: Array  # (r, b) deflections over their limit


@dataclass
class _Scene:
    """N estimates; a first dimension of one stands for all of them."""

    plants: AnyArray  # (N,)
    rest: Array  # (N, 1, n)
    shapes: Array  # (N, r, n)
    modes: Array  # (N, n, r)
    x: Array  # (N, 1, 2r)
    Q: Array  # (N, 2r, 2r)
    P: Array  # (N, 2r, 2r)
    gain: Array  # (N, 2r, m)
    bend: Array  # (N, r, b)

    def modal(self, q: Array, v: Array) -> Array:
        """(N, L, 2r) modal coordinates about the target, and their rates."""
        return np.concatenate([(q - self.rest) @ self.modes, v @ self.modes], axis=-1)

    def start(self) -> Array:
        """(N, 1, 2n) coordinates and rates."""
        place, rate = np.split(self.x, 2, axis=2)
        return np.concatenate([self.rest + place @ self.shapes, rate @ self.shapes], axis=2)


@dataclass
class _Motions:
    """L motions from each of N states, over T control steps."""

    q: Array  # (T, N, L, n)
    v: Array  # (T, N, L, n)
    x: Array  # (T + 1, N, L, 2r)
    action: Array  # (T, N, L, m)
    whole: AnyArray  # (N, L) none has diverged


class Nonlinear:
    """Law of `ModelBased`, for resting targets."""

    def __init__(self, env: Any, cost: Cost, *, horizon: float, margin: float) -> None:
        core = env.unwrapped.core
        self.cost, self.margin, self.limit = cost, margin, cost.limit
        self.deflection_limit = core.arguments["deflection_limit"]
        self.steps, self.steppers = steps_of(core, horizon), PlantSteppers(core, cost.models)
        stands = math.isinf(INTEGRATORS[core.integrator].limit)
        coarse = 1 if stands and core.substeps >= MANY else core.substeps
        self.coarse = PlantSteppers(core, cost.models, coarse)
        self.blocks = np.array(blocks_of(self.steps))
        self._terms = kept(self._made, KEPT)

    @np.errstate(over="ignore", invalid="ignore")  # motions that diverge cost infinitely much
    def __call__(self, estimates: list[Estimate]) -> Array:
        """(N, m) [N m] torques."""
        torques = np.empty((len(estimates), self.limit.size))
        for rows, group in alike(estimates):
            torques[rows] = self._torques(group)
        return torques

    def _torques(self, estimates: list[Estimate]) -> Array:
        scene = self._scene(estimates)
        first = self._closed_loop(scene)
        tried = self._open_loop(scene, first.action, self._changes(scene, first), SHARES)
        costs = np.hstack([self._costs(scene, motions) for motions in (first, tried)])
        actions = np.concatenate([first.action[0], tried.action[0]], axis=1)
        return self.limit * actions[np.arange(len(costs)), costs.argmin(axis=1)]

    def _scene(self, estimates: list[Estimate]) -> _Scene:
        models = [estimate.model for estimate in estimates]
        terms = [self._terms(model) for model in models]
        return _Scene(
            plants=np.array([model.plant for model in models]),
            rest=np.array([model.rest for model in models])[:, None],
            shapes=np.array([model.shapes.T for model in models]),
            modes=np.array([model.modes.T for model in models]),
            x=np.array([estimate.x for estimate in estimates])[:, None],
            **{
                name: np.array([getattr(term, name) for term in terms])
                for name in ("Q", "P", "gain", "bend")
            },
        )

    def _made(self, model: LinearModel) -> _Terms:
        Q, R = self.cost.of(model)
        P = riccati(model.A, model.B, Q, R)
        bend = model.bend[np.any(model.bend, axis=1)].T / self.deflection_limit
        return _Terms(Q, P, -(gain(model, P, R) / self.limit[:, None]).T, bend)

    def _closed_loop(self, scene: _Scene) -> _Motions:
        """Motions to which LQR leads under the limits of torque."""
        (count, _, n), r = scene.rest.shape, scene.modes.shape[2]
        stepper, m = self.steppers(count), self.limit.size
        stepper.parameters[:count] = self.steppers.parameters[scene.plants]
        moved = _Motions(
            q=np.empty((self.steps, count, 1, n)), v=np.empty((self.steps, count, 1, n)),
            x=np.empty((self.steps + 1, count, 1, 2 * r)),
            action=np.empty((self.steps, count, 1, m)), whole=np.ones((count, 1), dtype=bool),
        )  # fmt: skip
        moved.x[0] = scene.x
        stepper.q[:count], stepper.v[:count] = np.split(scene.start()[:, 0], 2, axis=1)
        for k in range(self.steps):
            moved.q[k, :, 0], moved.v[k, :, 0] = stepper.q[:count], stepper.v[:count]
            moved.action[k] = np.clip(moved.x[k] @ scene.gain, -1.0, 1.0)
            stepper.torque[:count] = self.limit * moved.action[k, :, 0]
            stepper.advance()
            moved.whole[:, 0] &= stepper.status[:count] == 0
            moved.x[k + 1] = scene.modal(stepper.q[:count, None], stepper.v[:count, None])
        return moved

    def _open_loop(self, scene: _Scene, feed: Array, change: Array, shares: Array) -> _Motions:
        """Motions under feed + share change, limited, for every share."""
        action = np.clip(feed + shares[:, None] * change, -1.0, 1.0)
        steps, count, tries, m = action.shape
        rows = np.arange(count).repeat(tries)
        torques = (self.limit * action).reshape(steps, -1, m).swapaxes(1, 2)
        start = scene.start()[rows, 0].T
        path = self.steppers.motions(scene.plants[rows], start, torques)
        path = np.concatenate([start[None], path])
        q, v = np.split(path.swapaxes(1, 2).reshape(steps + 1, count, tries, -1), 2, axis=3)
        whole = np.isfinite(path).all(axis=(0, 1)).reshape(count, tries)
        return _Motions(q=q[:-1], v=v[:-1], x=scene.modal(q, v), action=action, whole=whole)

    def _costs(self, scene: _Scene, moved: _Motions) -> Array:
        """(N, L) costs of motions; infinite where one has diverged, or its cost overflows."""
        x, r = moved.x[1:], scene.modes.shape[2]
        costs = self.cost.effort * np.sum(moved.action**2, axis=(0, 3))
        costs += np.sum((x[:-1] @ scene.Q) * x[:-1], axis=(0, 3))
        costs += np.sum((x[-1] @ scene.P) * x[-1], axis=2)
        beyond = np.abs(x[..., :r] @ scene.bend) - self.margin
        costs += PRICE * np.sum(np.maximum(beyond, 0.0) ** 2, axis=(0, 3))
        return np.where(moved.whole & np.isfinite(costs), costs, np.inf)

    def _changes(self, scene: _Scene, moved: _Motions) -> Array:
        """Changes (T, N, 1, m) of the actions; none where a motion is beyond linearization."""
        changes = np.zeros_like(moved.action)
        for i in range(len(scene.x)):
            A, B = self._linearized(scene, moved, i)
            program = _program(
                A, B, moved.x[1:, i, 0].copy(), moved.action[:, i, 0].copy(), self.blocks,
                scene.Q[i], scene.P[i], self.cost.effort, scene.bend[i],
            )  # fmt: skip
            if all(np.isfinite(part).all() for part in program):
                found = _solved(self.margin, *program)
                changes[:, i, 0] = found.reshape(-1, self.limit.size)[self.blocks]
        return changes

    def _linearized(self, scene: _Scene, moved: _Motions, i: int) -> tuple[Array, Array]:
        """A (T, 2r, 2r) and B (T, m, 2r) of one motion, transposed: a row per difference."""
        shapes, m, steps = scene.shapes[i], self.limit.size, self.steps
        r, n = shapes.shape
        each = 1 + 2 * r + m
        q, v, action = (np.repeat(y[:, i], each, axis=1) for y in (moved.q, moved.v, moved.action))
        q[:, 1 : 1 + r] += PLACE * shapes
        v[:, 1 + r : 1 + 2 * r] += RATE * shapes
        action[:, 1 + 2 * r :] += ACTION * np.eye(m)
        rows = steps * each
        stepper = self.coarse(rows)
        stepper.parameters[:rows] = self.coarse.parameters[scene.plants[i]]
        stepper.q[:rows], stepper.v[:rows] = q.reshape(rows, n), v.reshape(rows, n)
        stepper.torque[:rows] = (self.limit * action).reshape(rows, m)
        stepper.advance()
        place, rate = (y[:rows].reshape(steps, each, n) for y in (stepper.q, stepper.v))
        modes = scene.modes[i]
        x = np.concatenate([(place - scene.rest[i]) @ modes, rate @ modes], axis=2)
        x = x[:, 1:] - x[:, :1]
        A = np.concatenate([x[:, :r] / PLACE, x[:, r : 2 * r] / RATE], axis=1)
        return A, np.ascontiguousarray(x[:, 2 * r :] / ACTION)


@outermost
def _program(
    A: Any, B: Any, x: Any, action: Any, blocks: Any, Q: Any, P: Any, effort: float, bend: Any
) -> Any:  # fmt: skip
    """Quadratic program of changes of the actions (T, m) that lead to states x (T, 2r).

    Curvature (V, V) and slope (V,) of half the cost; least and most changes (V,); bending (W,), and
    (W, V) by the changes. Matrices are transposed: x[k + 1] changes by dx A[k] + da B[k].
    """
    steps, m, size = B.shape
    count, (r, bends) = m * (blocks[-1] + 1), bend.shape
    curvature, slope = np.zeros((count, count)), np.zeros(count)
    least, most = np.full(count, -np.inf), np.full(count, np.inf)
    bent, bending = np.zeros(steps * bends), np.zeros((steps * bends, count))
    onto = np.zeros((count, size))
    for k in range(steps):
        first = m * blocks[k]
        known = first + m  # later changes do not count yet
        reached = onto[:known] @ A[k]
        for a in range(m):
            for i in range(size):
                reached[first + a, i] += B[k, a, i]
        weighed = reached @ (P if k == steps - 1 else Q)
        curved = weighed @ reached.T
        turned = reached[:, :r].copy() @ bend
        for a in range(known):
            for b in range(known):
                curvature[a, b] += curved[a, b]
            for i in range(size):
                slope[a] += weighed[a, i] * x[k, i]
                onto[a, i] = reached[a, i]
            for w in range(bends):
                bending[k * bends + w, a] = turned[a, w]
        for w in range(bends):
            for i in range(r):
                bent[k * bends + w] += x[k, i] * bend[i, w]
        for a in range(m):
            curvature[first + a, first + a] += effort
            slope[first + a] += effort * action[k, a]
            least[first + a] = max(least[first + a], -1.0 - action[k, a])
            most[first + a] = min(most[first + a], 1.0 - action[k, a])
    return curvature, slope, least, most, bent, bending


def _solved(
    margin: float, curvature: Array, slope: Array, least: Array, most: Array, bent: Array,
    bending: Array,
) -> Array:  # fmt: skip
    """(V,) changes within their limits that cost least; bending beyond the margin if it must be.

    Few rows of bending bind, so that they join the program only when a solution without them
    breaks them. Zeros where the solver finds no solution: the motion stays that of LQR.
    """
    solve, scale = quadratic_programs().solve, 1.0 / np.diag(curvature).max()
    curvature, slope, joined = scale * curvature, scale * slope, np.zeros(len(bent), dtype=bool)
    while True:
        rows = bent[joined]
        upper = np.concatenate([most, margin - rows])
        lower = np.concatenate([least, -margin - rows])
        soft = np.repeat(np.array([0, SOFT], dtype=np.int32), [len(slope), len(rows)])
        found, _, flag, _ = solve(curvature, slope, bending[joined], upper, lower, soft)
        if flag <= 0:
            return np.zeros_like(slope)
        broken = ~joined & (np.abs(bent + bending @ found) > margin)
        if not broken.any():
            return np.clip(found, least, most)
        joined |= broken


def nonlinear(
    env: Any, name: str, *, horizon: float, margin: float, **parameters: Any
) -> ModelBased:
    """Nonlinear predictive control to a resting target; the parameters are those of `model_based`.

    On filters of the nonlinear arm it assumes the heaviest payload consistent with the readings.
    """
    if "disturbance" in parameters:
        parameters |= {"caution": CAUTION, "filters": ExtendedFilters}
    law = partial(Nonlinear, env, horizon=horizon, margin=margin)
    return model_based(env, name, law, **parameters)
