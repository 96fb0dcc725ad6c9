"""Kalman filters whose predictions are the arm's own, not those of a linear model.

Links that throw one another about couple by their rates, which no model linearized at rest knows.
Gains alone are linear here: those of `KalmanFilters` at the target posture (constant-gain extended
Kalman filter: Safonov and Athans, Robustness and computational aspects of nonlinear stochastic
estimators and regulators, IEEE Trans. Automatic Control 23, 1978).
"""

from typing import Any

import numpy as np

from agents.controllers.models.linear_model import LinearModel
from agents.controllers.models.nonlinear import PlantSteppers
from agents.controllers.models.plan import Planner
from agents.controllers.observers.exact import NEVER
from agents.controllers.observers.kalman import Belief, KalmanFilters, grouped
from agents.controllers.observers.steps import correct
from dynamics.types import AnyArray, Array
from flexarm_env.task.observations import BOUND

REFUTED = 60.0  # surprise above the least at which a filter ends: e^30 times less likely
MOST = 256  # filters that are stepped together


class ExtendedFilters(KalmanFilters):
    """`KalmanFilters` of the nonlinear arm.

    A filter's state has the arm's coordinates, their rates and the biases of the gauges; `torque`
    of its `Belief` are whole torques. Estimates are about the reference, in modes. A filter that
    is refuted ends, so that few are left to be stepped soon after the start; so does one whose
    state leaves what observations can show. Where none is left, all begin anew at the reading.
    """

    def __init__(
        self, env: Any, name: str, disturbance: float, planner: Planner | None = None,
        times: Array = NEVER, caution: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__(env, name, disturbance, planner, times, caution)
        core = env.unwrapped.core
        self.steppers = PlantSteppers(core, self.models)
        self._late = np.array([delay for _, delay in self.hypotheses])

    def told(self, belief: Belief, torque: Array) -> None:
        """Note other torques (N, m) [N m] of the coming step."""
        belief.torque[:, -1] = torque[:, None]

    def _bent(self, models: list[LinearModel]) -> Array:
        """(P, y, m) zeros: the arm that predicts has all its modes."""
        return np.zeros_like(super()._bent(models))

    def _start(self, belief: Belief, i: int, error: Array) -> None:
        belief.state[i][:, self.models.joints] = belief.plan.target.posture[i] + error

    def _filtered(
        self, belief: Belief, readings: Array, changed: AnyArray
    ) -> tuple[Array, AnyArray]:
        steps, surprise, state = belief.steps[:, None], belief.surprise, belief.state
        waiting = (steps > 0) & (steps <= self._late)
        surprise[waiting & changed[:, None]] = np.inf
        surprise[surprise > surprise.min(axis=1, keepdims=True) + REFUTED] = np.inf
        alive = ~waiting & np.isfinite(surprise)
        rows, filters = np.nonzero(alive & (steps > 0))
        torque = belief.torque[rows, -1 - self._late[filters], 0]
        state[rows, filters] = self._stepped(state[rows, filters], torque, filters)
        origin = self._origin(belief)
        for bank, group in grouped(belief.banks):
            correct(
                group, belief.steps, self._delays, readings, alive, origin, bank.shapes,
                bank.readings, bank.gain, bank.precision, bank.bulk, state, surprise,
            )  # fmt: skip
        left = np.nonzero(alive)
        alive[left] = self._shown(state[left], origin[left[0]])
        surprise[~waiting & ~alive] = np.inf
        for i in np.flatnonzero(np.all(surprise == np.inf, axis=1)).tolist():
            surprise[i, ~waiting[i]], state[i] = 0.0, 0.0
            self._start(belief, i, readings[i, : len(self.models.joints)])
        likely = surprise[:, self._order] <= surprise.min(axis=1, keepdims=True) + self.caution
        best = self._order[np.argmax(likely, axis=1)]
        plants = best // len(self._delays)
        return self._about(belief, self._present(belief, best), plants), plants

    def _present(self, belief: Belief, best: AnyArray) -> Array:
        """(N, most of S) states of the chosen filters after the torques since the readings."""
        now = belief.state[np.arange(len(best)), best]
        for age in range(self._delays[-1], 0, -1):
            rows = np.flatnonzero((self._late[best] >= age) & (belief.steps >= age))
            now[rows] = self._stepped(now[rows], belief.torque[rows, -age, 0], best[rows])
        return now

    def _shown(self, state: Array, origin: Array) -> AnyArray:
        """(k,) states (k, most of S) that observations can show; `origin` is (k, n)."""
        n = self.models.model.n
        place, speed = state[:, :n] - origin, state[:, n : 2 * n]
        scaled = np.abs(np.hstack([place / self._scales[0], speed / self._scales[1]]))
        return np.all(scaled <= BOUND, axis=1)

    def _about(self, belief: Belief, now: Array, plants: AnyArray) -> Array:
        """The states about the references, which start at rest, in modal coordinates and rates."""
        n, joints, rows = self.models.model.n, self.models.joints, np.arange(len(now))
        here, before = (belief.place[rows, -age, plants] for age in (1, 2))
        speed, motion = (here - before) / self.models.control_dt, belief.plan.motion
        speed[:, joints] += 0.5 * self.models.control_dt * motion.acceleration
        place, speed = now[:, :n] - self._origin(belief) - here, now[:, n : 2 * n] - speed
        found = np.zeros_like(now)
        for i, (bank, plant) in enumerate(zip(belief.banks, plants, strict=True)):
            modes = bank.models[plant].modes
            found[i, : 2 * len(modes)] = np.concatenate([modes @ place[i], modes @ speed[i]])
        return found

    def _origin(self, belief: Belief) -> Array:
        """(N, n) coordinates from which readings and references are taken."""
        posture = belief.plan.target.posture
        origin = np.zeros((len(posture), self.models.model.n))
        origin[:, self.models.joints] = posture
        return origin

    def _stepped(self, state: Array, torque: Array, filters: AnyArray) -> Array:
        """States (k, most of S) after a control step with torques (k, m) [N m].

        One that diverges within the step stays as it is.
        """
        n, plants = self.models.model.n, filters // len(self._delays)
        for first in range(0, len(state), MOST):
            part = state[first : first + MOST]
            count, those = len(part), slice(first, first + MOST)
            stepper = self.steppers(count)
            stepper.q[:count], stepper.v[:count] = part[:, :n], part[:, n : 2 * n]
            stepper.torque[:count] = torque[those]
            stepper.parameters[:count] = self.steppers.parameters[plants[those]]
            stepper.advance()
            part[:, :n], part[:, n : 2 * n] = stepper.q[:count], stepper.v[:count]
        return state
