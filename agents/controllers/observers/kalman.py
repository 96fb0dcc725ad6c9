"""Kalman filters of angles and curvatures: the observer of sensors.

Coordinates are taken from the reference of `reference.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from agents.controllers.models.linear_model import LinearModel, LinearModels, place_of
from agents.controllers.models.memory import kept
from agents.controllers.models.plan import Plan, Planner
from agents.controllers.models.preview import Preview
from agents.controllers.models.reading import UNIFORM, Reading, Sensors
from agents.controllers.models.reference import Reference
from agents.controllers.observers.exact import NEVER, Estimate, alike
from agents.controllers.observers.steps import predict, take
from dynamics.types import AnyArray, Array
from flexarm_env.task.observations import BOUND

SHARED = 2  # decimals [rad] within which postures share filters
MEMORY = 5e8  # bytes of filters that wait for other episodes at their postures
LEARNING = 40  # readings after which the gain of a filter stays


@dataclass(frozen=True, eq=False)
class _Bank:
    """Filters of all plants at one posture, stacked; states are (x, gauge biases), S in all.

    Matrices are transposed, so that the compiled loops add to neighbours.
    """

    models: list[LinearModel]  # P
    A: Array  # (P, S, S)
    B: Array  # (P, m, S)
    C: Array  # (P, S, y)
    D: Array  # (P, m, y)
    shapes: Array  # (P, r, n) of the modes
    turns: Array  # (P, r, m) modes of a turn of each joint, not transposed
    readings: Array  # (y, n) of coordinates, the same for all plants, not transposed
    gain: Array  # (LEARNING, P, y, S) Kalman gain at the first readings; the last one stays
    precision: Array  # (LEARNING, P, y, y) of the innovations
    bulk: Array  # (LEARNING, P) minus twice the logarithm of the likeliest reading's probability


@dataclass
class Belief:
    """Memory of `KalmanFilters`: N environments, H hypotheses, D + 1 control steps, P plants."""

    plan: Plan
    seen: Array  # of the targets' paths, see `Preview`
    banks: list[Any]  # N times _Bank
    steps: AnyArray  # (N,) since the start
    state: Array  # (N, H, most of S) when the latest reading was taken
    surprise: Array  # (N, H) minus twice the logarithm of the readings' probability
    first: Array  # (N, y) first reading
    torque: Array  # (N, D + 1, P, m) [N m] past torques about the reference's, oldest first
    place: Array  # (N, D + 2, P, n) past references, from the target at the start, the present last
    forward: Array  # (N, P, m) [N m] torque of the reference
    estimates: list[Estimate] = field(default_factory=list)  # N, of the assumed plant


class KalmanFilters:
    """Kalman filters of angles and curvatures: one per delay and plant of a grid.

    The grid reaches beyond what may be drawn: plants as `LinearModels` has them, and delays by
    LATER control steps where they are drawn at all. A filter estimates modal coordinates, their
    rates and the biases of the gauges; at the start it knows the first angles and the task's range
    of vibrations. Joint rates are differences of angles and add nothing. The filter with the
    smallest innovations since the start is chosen (multiple-model estimation, Bar-Shalom, Li and
    Kirubarajan, Estimation with Applications, 2001, section 11.6); its estimate is predicted to the
    present with the torques since.

    With `caution`, the choice is the heaviest plant whose filter is at most so much more surprised;
    among plants of one payload the softest, and of one stiffness the longest delay.
    """

    def __init__(
        self, env: Any, name: str, disturbance: float, planner: Planner | None = None,
        times: Array = NEVER, caution: float = 0.0,
    ) -> None:  # fmt: skip
        core = env.unwrapped.core
        self.read, self.models = Reading.of(env), LinearModels.of(env)
        self.read.require(name, "joint_error", "root_curvature")
        self.limit = np.asarray(core.torque_limit, dtype=np.float64)
        self.disturbance, self.sensors = disturbance, Sensors.of(core)
        self.spread = _spread(core, self.models)
        self.plants = range(len(self.models.plants))
        self.planner = planner or Planner(env, self.models)
        self.reference = Reference(self.models, self.plants)
        self.preview = Preview(env, self.models, times)
        self.hypotheses = list(product(self.plants, self.sensors.delays))
        self._delays = np.array(self.sensors.delays)
        self.caution, self._order = caution, np.arange(len(self.hypotheses))
        if caution:
            self._order = np.array(sorted(range(len(self.hypotheses)), key=self._mildness))
        self._traits = _traits(
            [*self.models.levels, self.sensors.delays], [*self.models.drawn, self.sensors.delay]
        )
        self._scales = np.ones((2, self.models.model.n))
        for row, part in enumerate(("joint_error", "joint_rate")):
            self._scales[row, self.models.joints] = self.read.scales[part]
        self._scales[:, self.models.modal] = core.scales.modal_scale, core.scales.modal_rate
        y = len(self.sensors.noise)
        self._most = 2 * self.models.model.n + len(self.sensors.bias)  # of S
        each = 8 * LEARNING * len(self.plants) * y * (self._most + y)  # bytes
        self._bank = kept(self._stacked, max(1, int(MEMORY / each)))

    @property
    def n_known(self) -> int:
        """Number of columns of `known`."""
        moving = self.limit.size if self.planner.moving else 0
        return self._scales.size + moving + self._traits.shape[1]

    def observe(
        self, x: AnyArray, belief: Belief | None, fresh: AnyArray
    ) -> tuple[list[Estimate], Belief]:
        """Estimates of N environments, and the belief for the next step."""
        plan = self.planner.follow(x, belief.plan if belief else None, fresh)
        belief = self._begun(x, plan, belief, fresh)
        self._refer(belief, fresh)
        angle = self.read(x, "joint_error") + plan.target.way
        readings = np.concatenate([angle, self.read(x, "root_curvature")], axis=1, dtype=np.float64)
        belief.estimates = self._estimated(belief, readings)
        belief.steps = belief.steps + 1
        return belief.estimates, belief

    def known(self, belief: Belief) -> AnyArray:
        """(N, k) estimated joint errors, rates, modal amplitudes and their rates; plant and delay.

        States are scaled as observations are; where the reference moves, they are about it, and its
        torque, over the torque limit, follows them. A drawn payload, stiffness and delay, -1 and 1
        at the ends of what is drawn, are means over the filters, weighted by their probabilities.
        """
        places, speeds = np.empty((2, len(belief.estimates), self.models.model.n))
        for rows, group in alike(belief.estimates):
            shapes = np.array([estimate.model.shapes for estimate in group])
            place, speed = np.split(np.array([x.x for x in group])[..., None], 2, axis=1)
            places[rows], speeds[rows] = (shapes @ place)[..., 0], (shapes @ speed)[..., 0]
        likely = np.exp(0.5 * (belief.surprise.min(axis=1, keepdims=True) - belief.surprise))
        means = likely / likely.sum(axis=1, keepdims=True) @ self._traits
        states = np.hstack([places / self._scales[0], speeds / self._scales[1]])
        if self.planner.moving:
            forward = np.array([estimate.forward for estimate in belief.estimates])
            states = np.hstack([states, forward / self.limit])
        return np.hstack([np.clip(states, -BOUND, BOUND), means])

    def act(self, belief: Belief, torque: Array) -> None:
        """Note the torques (N, m) [N m] of the coming step."""
        belief.torque = np.concatenate([belief.torque[:, 1:], belief.torque[:, :1]], axis=1)
        self.told(belief, torque)

    def told(self, belief: Belief, torque: Array) -> None:
        """Note other torques (N, m) [N m] of the coming step."""
        belief.torque[:, -1] = torque[:, None] - belief.forward

    def _estimated(self, belief: Belief, readings: Array) -> list[Estimate]:
        """Estimates of the likeliest filters after readings (N, y).

        Before its delay, the first reading repeats; filters of longer delays are refuted by
        readings that change earlier.
        """
        first = belief.steps == 0
        belief.first[first] = readings[first]
        apart = np.abs(readings - belief.first)
        changed: AnyArray = np.any(apart > 0.5 * self.sensors.quantum, axis=1)
        now, best = self._filtered(belief, readings, changed)
        ahead = self.preview.torques(belief.plan.target, belief.seen, best)
        found = []
        for i, (bank, plant) in enumerate(zip(belief.banks, best, strict=True)):
            model, forward = bank.models[plant], belief.forward[i, plant]
            found.append(Estimate(model, now[i, : len(model.A)], forward, ahead[i]))
        return found

    def _filtered(
        self, belief: Belief, readings: Array, changed: AnyArray
    ) -> tuple[Array, AnyArray]:
        """Present states (N, most of S) of the chosen filters about the reference, their plants.

        `changed` (N,) marks readings that differ from the first.
        """
        now, best = np.zeros((len(readings), self._most)), np.zeros(len(readings), np.int64)
        for bank, group in grouped(belief.banks):
            take(
                group, belief.steps, self._delays, readings, changed, self.planner.moving,
                bank.A, bank.B, bank.C, bank.D, bank.readings, bank.gain, bank.precision, bank.bulk,
                belief.torque, belief.place, belief.state, belief.surprise,
            )  # fmt: skip
            predict(
                group, belief.steps, self._delays, bank.A, bank.B, belief.torque, belief.state,
                belief.surprise, self._order, self.caution, best, now,
            )  # fmt: skip
        return now, best

    def _refer(self, belief: Belief, fresh: AnyArray) -> None:
        """Move the references to the present; a resting target's stay zero without a plan."""
        if not self.planner.moving:
            return
        place, belief.forward = self.reference.along(belief.plan.motion)
        place[:, :, self.models.joints] += belief.plan.motion.way[:, None]
        belief.place = np.concatenate([belief.place[:, 1:], place[:, None]], axis=1)
        belief.place[fresh] = place[fresh, None]

    def _begun(self, x: AnyArray, plan: Plan, belief: Belief | None, fresh: AnyArray) -> Belief:
        """The belief, begun anew where an episode starts: joints are where they are read."""
        n, m, count = self.models.model.n, self.limit.size, len(x)
        seen = self.preview.see(x, plan.target, belief.seen if belief else None, fresh)
        if belief is None:
            past, plants = self.sensors.delays[-1] + 1, len(self.plants)
            belief = Belief(
                plan=plan,
                seen=seen,
                banks=[None] * count,
                steps=np.zeros(count, np.int64),
                state=np.zeros((count, len(self.hypotheses), self._most)),
                surprise=np.zeros((count, len(self.hypotheses))),
                first=np.zeros((count, len(self.sensors.noise))),
                torque=np.zeros((count, past, plants, m)),
                place=np.zeros((count, past + 1, plants, n)),
                forward=np.zeros((count, plants, m)),
            )
        belief.plan, belief.seen = plan, seen
        belief.steps[fresh], belief.surprise[fresh], belief.torque[fresh] = 0, 0.0, 0.0
        belief.state[fresh], belief.place[fresh], belief.forward[fresh] = 0.0, 0.0, 0.0
        error = self.read(x, "joint_error")
        for i in np.flatnonzero(fresh).tolist():
            belief.banks[i] = self._at(plan.target.posture[i])
            self._start(belief, i, error[i])
        return belief

    def _start(self, belief: Belief, i: int, error: Array) -> None:
        """Set the states of one episode at its start: at rest, with joint errors (m,) [rad]."""
        start = belief.banks[i].turns @ (error - belief.plan.remaining_error[i])
        belief.state[i, :, : start.shape[1]] = np.repeat(start, len(self._delays), axis=0)

    def _mildness(self, hypothesis: int) -> tuple[float, float, int]:
        """Sorts the filters by what they expect, the worst first."""
        plant, delay = self.hypotheses[hypothesis]
        expected = self.models.plants[plant]
        return -expected.payload, expected.factor, -delay

    def _at(self, posture: Array) -> _Bank:
        return self._bank(place_of(posture, SHARED))

    def _bent(self, models: list[LinearModel]) -> Array:
        """(P, y, m) readings of what torques bend at once, of modes that the filters leave out."""
        return np.array([model.D for model in models])

    def _stacked(self, place: tuple[float, ...]) -> _Bank:
        """Filters at joint angles: gains, precisions and bulks of the first readings."""
        models = [self.models.at(np.array(place), plant) for plant in self.plants]
        A, B, C, P = self._with_biases(models)
        D = self._bent(models)
        disturbed, quantum = np.diag((self.disturbance * self.limit) ** 2), self.sensors.quantum
        W = B @ disturbed @ _turned(B)
        V = np.diag(self.sensors.noise**2) + D @ disturbed @ _turned(D)
        both = B @ disturbed @ _turned(D)  # (P, S, y) covariances of the state with the reading
        traces = np.trace(W, axis1=1, axis2=2)[:, None, None]
        W += 1e-12 * traces / W.shape[1] * np.eye(W.shape[1])
        P += W
        learned = []
        for _ in range(LEARNING):
            cross = P @ _turned(C) + both
            S = C @ cross + _turned(both) @ _turned(C) + V
            precision = np.linalg.inv(S)
            gain = cross @ precision
            bulk = np.linalg.slogdet(2.0 * np.pi * S / np.outer(quantum, quantum))[1]
            learned.append((_turned(gain), precision, bulk))
            P = A @ (P - gain @ _turned(cross)) @ _turned(A) + W
            P = 0.5 * (P + _turned(P))
        gains, precisions, bulks = map(np.array, zip(*learned, strict=True))
        A, B, C, D = (np.ascontiguousarray(_turned(matrices)) for matrices in (A, B, C, D))
        shapes = np.array([model.shapes.T for model in models])
        turns = np.array([model.modes[:, self.models.joints] for model in models])
        return _Bank(
            models, A, B, C, D, shapes, turns, models[0].readings, gains, precisions, bulks
        )

    def _with_biases(self, models: list[LinearModel]) -> tuple[Array, Array, Array, Array]:
        """A, B, C of the states with the gauges' biases, and their covariances at the start."""
        count, biases, m = len(models), len(self.sensors.bias), self.limit.size
        r = len(models[0].modes)
        S = 2 * r + biases
        A, P = np.zeros((2, count, S, S))
        B, C = np.zeros((count, S, m)), np.zeros((count, m + biases, S))
        A[:, : 2 * r, : 2 * r] = [model.A for model in models]
        B[:, : 2 * r] = [model.B for model in models]
        C[:, :, : 2 * r] = [model.C for model in models]
        A[:, 2 * r :, 2 * r :] = C[:, m:, 2 * r :] = np.eye(biases)
        modes = np.array([model.modes for model in models])
        for part, spread in zip((slice(r), slice(r, 2 * r)), self.spread, strict=True):
            apart = modes @ spread
            P[:, part, part] = apart @ _turned(apart)
        P[:, 2 * r :, 2 * r :] = np.diag(self.sensors.bias**2)
        return A, B, C, P


def grouped(banks: list[_Bank]) -> list[tuple[_Bank, AnyArray]]:
    """Every bank with the indices of its environments."""
    places: dict[_Bank, list[int]] = {}
    for i, bank in enumerate(banks):
        places.setdefault(bank, []).append(i)
    return [(bank, np.array(group)) for bank, group in places.items()]


def _turned(matrices: Array) -> Array:
    """(..., b, a) from (..., a, b)."""
    return np.swapaxes(matrices, -1, -2)


def _traits(levels: Sequence[Sequence[float]], drawn: Sequence[tuple[float, float]]) -> Array:
    """(H, k) values of a grid, -1 and 1 at the ends of what is drawn; a column if it is drawn."""
    values = np.array(list(product(*levels)), dtype=np.float64)
    low, high = np.array(drawn, dtype=np.float64).T
    differ = high > low
    return np.asarray((2.0 * values - low - high)[:, differ] / (high - low)[differ])


def _spread(core: Any, models: LinearModels) -> tuple[Array, Array]:
    """(n, w) standard deviations of the initial coordinates and rates, a column per vibration."""
    share = core.task.shake[1] / UNIFORM
    place, rate = np.zeros((2, models.model.n, max(len(core.scales.vibration), 1)))
    if models.modal and share:
        place[models.modal] = share * np.array(core.scales.vibration).T
        rate[models.modal] = share * np.array(core.scales.vibration_rate).T
    return place, rate
