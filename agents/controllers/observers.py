"""Observers: what a model-based controller knows of the arm, from exact states or from sensors.

Coordinates are taken from the reference of `reference.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from agents.controllers.linear_model import KEPT, LinearModel, LinearModels, place_of
from agents.controllers.reading import Reading
from agents.controllers.reference import Course, Reference, followed
from dynamics.types import AnyArray, Array
from flexarm_env.hardware.sensors import Hardware
from flexarm_env.observations import BOUND

LEARNING = 40  # readings after which the gain of a filter stays
EXACT = 1e-4  # [rad], [of the scale] steps that stand for readings without counts
UNIFORM = 3.0**0.5  # half the width of a uniform distribution over its standard deviation


@dataclass(frozen=True)
class Estimate:
    """State of one environment about its reference, and the plant that is believed in."""

    model: LinearModel
    x: Array  # (2r,) modal coordinates and rates
    forward: Array  # (m,) [N m] torque of the reference


@dataclass
class _Sight:
    """Memory of `ExactState`."""

    course: Course
    offset: Array  # (N, n) of the reference at the last step


class ExactState:
    """The state as obs="state" gives it; the plant is the middle one."""

    parts = ("joint_error", "joint_rate", "modal_amplitude", "modal_rate")

    def __init__(self, env: Any, name: str) -> None:
        self.read, self.models = Reading.of(env), LinearModels.of(env)
        self.read.require(name, *self.parts)
        self.reference = Reference(self.models, [self.models.middle])

    def observe(
        self, x: AnyArray, memory: _Sight | None, fresh: AnyArray
    ) -> tuple[list[Estimate], _Sight]:
        """Estimates of N environments, and the memory for the next step."""
        models, dt, count = self.models, self.models.control_dt, len(x)
        course = followed(self.read, x, memory.course if memory else None, fresh, dt)
        place, speed = np.zeros((2, count, models.model.n))
        place[:, models.joints] = self.read(x, "joint_error")
        place[:, models.modal] = self.read(x, "modal_amplitude")
        speed[:, models.joints] = self.read(x, "joint_rate") - course.rate
        speed[:, models.modal] = self.read(x, "modal_rate")
        offset, forward = (x[:, 0] for x in self.reference.along(course))
        before = offset if memory is None else np.where(fresh[:, None], offset, memory.offset)
        speed -= (offset - before) / dt
        estimates = []
        for i in range(count):
            model = models.at(course.posture[i])
            state = np.concatenate([model.modes @ (place[i] - offset[i]), model.modes @ speed[i]])
            estimates.append(Estimate(model, state, forward[i]))
        return estimates, _Sight(course, offset)

    def act(self, memory: _Sight, torque: Array) -> None:
        """Nothing to note: torques (N, m) show in the next state."""


@dataclass
class _Bank:
    """Filters of all plants at one posture, stacked; states are (x, gauge biases), S in all."""

    A: Array  # (P, S, S)
    B: Array  # (P, S, m)
    C: Array  # (P, y, S)
    readings: Array  # (y, n) of coordinates, the same for all plants
    gain: Array  # (LEARNING, P, S, y) Kalman gain at the first readings; the last one stays
    precision: Array  # (LEARNING, P, y, y) of the innovations
    bulk: Array  # (LEARNING, P) minus twice the logarithm of the likeliest reading's probability


@dataclass
class Belief:
    """Memory of `KalmanFilters`: N environments, H hypotheses, D + 1 control steps, P plants."""

    course: Course
    steps: AnyArray  # (N,) since the start
    state: list[Array]  # N times (H, S): when the latest reading was taken
    surprise: Array  # (N, H) minus twice the logarithm of the readings' probability
    first: Array  # (N, y) first reading
    torque: Array  # (N, D + 1, P, m) [N m] past torques about the reference's, oldest first
    place: Array  # (N, D + 1, P, n) past references, from the target at the start
    forward: Array  # (N, P, m) [N m] torque of the reference
    estimates: list[Estimate] = field(default_factory=list)  # N, of the likeliest plant


class KalmanFilters:
    """Kalman filters of angles and curvatures: one per delay and plant that may be drawn.

    A filter estimates modal coordinates, their rates and the biases of the gauges; at the start it
    knows the first angles and the task's range of vibrations. Joint rates are differences of angles
    and add nothing. The filter with the smallest innovations since the start is believed
    (multiple-model estimation, Bar-Shalom, Li and Kirubarajan, Estimation with Applications, 2001,
    section 11.6); its estimate is predicted to the present with the torques since.
    """

    def __init__(self, env: Any, name: str, disturbance: float) -> None:
        core = env.unwrapped.core
        self.read, self.models = Reading.of(env), LinearModels.of(env)
        self.read.require(name, "joint_error", "root_curvature")
        self.limit = np.asarray(core.torque_limit, dtype=np.float64)
        self.disturbance, self.sensors = disturbance, Sensors.of(core)
        self.spread = _spread(core, self.models)
        self.plants = range(len(self.models.plants))
        self.reference = Reference(self.models, self.plants)
        self.hypotheses = list(product(self.plants, self.sensors.delays))
        self._plant = np.array([plant for plant, _ in self.hypotheses])
        self._delay = np.array([delay for _, delay in self.hypotheses])
        self._traits = _traits(*self.models.levels, self.sensors.delays)
        self._scales = np.ones((2, self.models.model.n))
        for row, name in enumerate(("joint_error", "joint_rate")):
            self._scales[row, self.models.joints] = self.read.scales[name]
        self._scales[:, self.models.modal] = core.scales.modal_scale, core.scales.modal_rate
        self._moving = "target_rate" in self.read
        self._bank = lru_cache(KEPT // len(self.plants))(self._stacked)

    @property
    def n_known(self) -> int:
        """Number of columns of `known`."""
        moving = self.limit.size if self._moving else 0
        return self._scales.size + moving + self._traits.shape[1]

    def observe(
        self, x: AnyArray, belief: Belief | None, fresh: AnyArray
    ) -> tuple[list[Estimate], Belief]:
        """Estimates of N environments, and the belief for the next step."""
        course = followed(
            self.read, x, belief.course if belief else None, fresh, self.models.control_dt
        )
        belief = self._begun(x, course, belief, fresh)
        self._refer(belief)
        angle = self.read(x, "joint_error") + course.way
        readings = np.concatenate([angle, self.read(x, "root_curvature")], axis=1)
        estimates: list[Any] = [None] * len(x)
        for group in _alike([state.shape[1] for state in belief.state]):
            self._take(belief, group, readings[group])
            for i, estimate in zip(group, self._present(belief, group), strict=True):
                estimates[i] = estimate
        belief.steps, belief.estimates = belief.steps + 1, estimates
        return estimates, belief

    def known(self, belief: Belief) -> AnyArray:
        """(N, k) believed joint errors, rates, modal amplitudes and their rates; plant and delay.

        States are scaled as observations are; where the target moves, the torque of the reference,
        over the torque limit, follows them. A drawn payload, stiffness and delay, from -1 to 1
        over their ranges, are means over the filters, weighted by their probabilities.
        """
        places, speeds = np.zeros((2, len(belief.estimates), self.models.model.n))
        for i, estimate in enumerate(belief.estimates):
            r, shapes = len(estimate.model.modes), estimate.model.shapes
            places[i], speeds[i] = shapes @ estimate.x[:r], shapes @ estimate.x[r:]
        likely = np.exp(0.5 * (belief.surprise.min(axis=1, keepdims=True) - belief.surprise))
        means = likely / likely.sum(axis=1, keepdims=True) @ self._traits
        states = np.hstack([places / self._scales[0], speeds / self._scales[1]])
        if self._moving:
            forward = np.array([estimate.forward for estimate in belief.estimates])
            states = np.hstack([states, forward / self.limit])
        return np.hstack([np.clip(states, -BOUND, BOUND), means])

    def act(self, belief: Belief, torque: Array) -> None:
        """Note the torques (N, m) [N m] of the coming step."""
        apart = torque[:, None] - belief.forward
        belief.torque = np.concatenate([belief.torque[:, 1:], apart[:, None]], axis=1)

    def _take(self, belief: Belief, group: AnyArray, reading: Array) -> None:
        """Update the filters of environments that new readings (G, y) reach.

        Before its delay, the first reading repeats.
        """
        banks = [self._bank(place_of(x)) for x in belief.course.posture[group]]
        step, first = belief.steps[group, None], belief.steps[group] == 0
        belief.first[group[first]] = reading[first]
        late = np.maximum(step - self.sensors.delays, 0)  # (G, D) readings taken since the start
        state = self._by_plant(np.array([belief.state[i] for i in group]))
        moved = state @ _turned(_each(banks, "A")) + self._past(belief.torque[group]) @ _turned(
            _each(banks, "B")
        )
        moved = np.where(first[:, None, None, None], state, moved)
        shift = self._past(belief.place[group]) @ _turned(_each(banks, "readings"))[:, None]
        innovation = reading[:, None, None] - shift - moved @ _turned(_each(banks, "C"))
        at = np.minimum(late, LEARNING - 1)
        gain, precision, bulk = (_each(banks, x, at) for x in ("gain", "precision", "bulk"))
        correction = np.einsum("gpdy,gdpsy->gpds", innovation, gain)
        surprise = np.einsum("gpdy,gdpyz,gpdz->gpd", innovation, precision, innovation)
        surprise += np.swapaxes(bulk, 1, 2)
        new = ((step > self.sensors.delays) | (step == 0))[:, None]
        changed = np.abs(reading - belief.first[group]) > 0.5 * self.sensors.quantum
        refuted = np.where(changed.any(axis=1), np.inf, 0.0)[:, None, None]
        surprise = np.where(new, surprise, refuted)
        belief.surprise[group] += surprise.reshape(len(group), -1)
        state = np.where(new[..., None], moved + correction, state)
        for i, filters in zip(group, state, strict=True):
            belief.state[i] = filters.reshape(-1, state.shape[-1])

    def _present(self, belief: Belief, group: AnyArray) -> list[Estimate]:
        """Estimates of the likeliest filters, predicted with the torques since their readings."""
        best = np.argmin(belief.surprise[group], axis=1)
        plants, ages = self._plant[best], np.minimum(self._delay[best], belief.steps[group])
        found = []
        for i, k, plant, age in zip(group, best, plants, ages, strict=True):
            posture = belief.course.posture[i]
            bank, now = self._bank(place_of(posture)), belief.state[i][k]
            for torque in belief.torque[i, belief.torque.shape[1] - age :, plant]:
                now = bank.A[plant] @ now + bank.B[plant] @ torque
            model = self.models.at(posture, plant)
            found.append(Estimate(model, now[: len(model.A)].copy(), belief.forward[i, plant]))
        return found

    def _by_plant(self, filters: Array) -> Array:
        """(G, P, D, S) states from (G, H, S)."""
        return filters.reshape(len(filters), len(self.plants), -1, filters.shape[-1])

    def _past(self, kept: Array) -> Array:
        """(G, P, D, k) values of the step before each delay's reading, from (G, D + 1, P, k)."""
        return np.swapaxes(kept[:, [-1 - delay for delay in self.sensors.delays]], 1, 2)

    def _refer(self, belief: Belief) -> None:
        """Move the references to the present; a resting target's stay zero."""
        if not self._moving:
            return
        place, belief.forward = self.reference.along(belief.course)
        place[:, :, self.models.joints] += belief.course.way[:, None]
        belief.place = np.concatenate([belief.place[:, 1:], place[:, None]], axis=1)

    def _begun(self, x: AnyArray, course: Course, belief: Belief | None, fresh: AnyArray) -> Belief:
        """The belief, begun anew where an episode starts: joints are where they are read."""
        n, m = self.models.model.n, self.limit.size
        if belief is None:
            count, past, plants = len(x), self.sensors.delays[-1] + 1, len(self.plants)
            belief = Belief(
                course=course,
                steps=np.zeros(count, np.int64),
                state=[np.zeros((0, 0))] * count,
                surprise=np.zeros((count, len(self.hypotheses))),
                first=np.zeros((count, len(self.sensors.noise))),
                torque=np.zeros((count, past, plants, m)),
                place=np.zeros((count, past, plants, n)),
                forward=np.zeros((count, plants, m)),
            )
        belief.course = course
        belief.steps[fresh], belief.surprise[fresh], belief.torque[fresh] = 0, 0.0, 0.0
        belief.place[fresh], belief.forward[fresh] = 0.0, 0.0
        error = self.read(x, "joint_error")
        for i in np.flatnonzero(fresh):
            modes = [self.models.at(course.posture[i], plant).modes for plant in self.plants]
            size = self._bank(place_of(course.posture[i])).A.shape[1]
            start = np.zeros((len(modes), size))
            for row, mode in zip(start, modes, strict=True):
                row[: len(mode)] = mode[:, self.models.joints] @ error[i]
            belief.state[i] = start[self._plant]
        return belief

    def _stacked(self, place: tuple[float, ...]) -> _Bank:
        """Filters at joint angles."""
        models = [self.models.at(np.array(place), plant) for plant in self.plants]
        found = map(self._filter, models)
        A, B, C, *learned = (np.array(list(part)) for part in zip(*found, strict=True))
        return _Bank(A, B, C, models[0].readings, *(np.moveaxis(part, 1, 0) for part in learned))

    def _filter(self, model: LinearModel) -> tuple[Array, ...]:
        """A, B, C of the state with biases; gains, precisions and bulks of the first readings."""
        biases, m, r = len(self.sensors.bias), self.limit.size, len(model.modes)
        A, C = block_diag(model.A, np.eye(biases)), np.hstack([model.C, np.eye(m + biases)[:, m:]])
        B = np.vstack([model.B, np.zeros((biases, m))])
        V = np.diag(self.sensors.noise**2)
        W = B @ np.diag((self.disturbance * self.limit) ** 2) @ B.T
        W += 1e-12 * np.trace(W) / len(W) * np.eye(len(W))
        P = np.zeros_like(A)
        places, rates = (model.modes @ spread for spread in self.spread)
        P[:r, :r], P[r : 2 * r, r : 2 * r] = places @ places.T, rates @ rates.T
        P[2 * r :, 2 * r :] = np.diag(self.sensors.bias**2)
        P += W
        learned, quantum = [], self.sensors.quantum
        for _ in range(LEARNING):
            S = C @ P @ C.T + V
            precision = np.asarray(np.linalg.inv(S), np.float64)
            gain = P @ C.T @ precision
            bulk = np.linalg.slogdet(2.0 * np.pi * S / np.outer(quantum, quantum))[1]
            learned.append((gain, precision, float(bulk)))
            P = A @ (P - gain @ C @ P) @ A.T + W
            P = 0.5 * (P + P.T)
        return A, B, C, *(np.array(list(part)) for part in zip(*learned, strict=True))


def _alike(sizes: list[int]) -> list[AnyArray]:
    """Indices of environments whose states are equally large."""
    return [np.flatnonzero(np.array(sizes) == size) for size in sorted(set(sizes))]


def _each(banks: list[_Bank], name: str, at: AnyArray | None = None) -> Array:
    """(G or 1, ...) parts of banks, of their rows at (G, D) if given; of one bank if they agree."""
    first = getattr(banks[0], name)
    if all(bank is banks[0] for bank in banks):
        return np.asarray(first[None] if at is None else first[at])
    parts = [getattr(bank, name) for bank in banks]
    return np.array(parts if at is None else [x[k] for x, k in zip(parts, at, strict=True)])


def _turned(matrices: Array) -> Array:
    """(..., b, a) from (..., a, b)."""
    return np.swapaxes(matrices, -1, -2)


def fresh_of(state: Any, episode_start: AnyArray | None, count: int) -> AnyArray:
    """(N,) environments whose episode starts."""
    if state is None or episode_start is None:
        return np.full(count, state is None)
    return np.asarray(episode_start, dtype=bool)


def resumed(state: Array | None, episode_start: AnyArray | None, like: Array) -> Array:
    """State (..., N, m) of a controller, zero where an episode starts; `like` has its shape."""
    fresh = fresh_of(state, episode_start, like.shape[-2])
    return np.where(fresh[:, None], 0.0, np.zeros_like(like) if state is None else state)


@dataclass(frozen=True)
class Sensors:
    """Errors of the sensors of an environment with m joints and g gauges."""

    delays: list[int]  # [control steps] that may be drawn
    quantum: Array  # (m + g,) steps between readings
    noise: Array  # (m + g,) standard deviations of the readings
    bias: Array  # (g,) [1/m] standard deviation of a gauge's bias

    @classmethod
    def of(cls, core: Any) -> "Sensors":
        """Sensors of an environment's core; those of ideal hardware are nearly exact."""
        scale, m = np.asarray(core.gauge_scale), core.arm.n_joint
        hardware = core.sensing.hardware if core.sensing else Hardware()
        count = 2.0 * np.pi / hardware.encoder_counts if hardware.encoder_counts else EXACT
        step = 1.0 / hardware.gauge_counts if hardware.gauge_counts else EXACT
        noise = np.hypot(hardware.gauge_noise, 0.5 * step / UNIFORM) * scale
        least, most = hardware.delay
        return cls(
            delays=list(range(least, most + 1)),
            quantum=np.array([*[count] * m, *(step * scale)]),
            noise=np.array([*[0.5 * count / UNIFORM] * m, *noise]),
            bias=hardware.gauge_bias / UNIFORM * scale,
        )


def _traits(*levels: Sequence[float]) -> Array:
    """(H, k) values of what is drawn, from -1 to 1; a column for each that may differ."""
    drawn = [np.linspace(-1.0, 1.0, len(found)) if len(found) > 1 else [None] for found in levels]
    rows = [[value for value in row if value is not None] for row in product(*drawn)]
    return np.array(rows, dtype=np.float64)


def _spread(core: Any, models: LinearModels) -> tuple[Array, Array]:
    """(n, w) standard deviations of the initial coordinates and rates, a column per vibration."""
    share = core.task.shake[1] / UNIFORM
    place, rate = np.zeros((2, models.model.n, max(len(core.scales.vibration), 1)))
    if models.modal and share:
        place[models.modal] = share * np.array(core.scales.vibration).T
        rate[models.modal] = share * np.array(core.scales.vibration_rate).T
    return place, rate
