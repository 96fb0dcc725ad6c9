"""Observers: what a model-based controller knows of the arm, from exact states or from sensors.

Coordinates are taken from the reference of `reference.py`.
"""

from dataclasses import dataclass
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
        references = [self.reference.at(course, i) for i in range(count)]
        offset = np.array([offset[0] for offset, _ in references])
        before = offset if memory is None else np.where(fresh[:, None], offset, memory.offset)
        speed -= (offset - before) / dt
        estimates = []
        for i in range(count):
            model = models.at(course.posture[i])
            state = np.concatenate([model.modes @ (place[i] - offset[i]), model.modes @ speed[i]])
            estimates.append(Estimate(model, state, references[i][1][0]))
        return estimates, _Sight(course, offset)

    def act(self, memory: _Sight, torque: Array) -> None:
        """Nothing to note: torques (N, m) show in the next state."""


@dataclass
class _Bank:
    """Filters of all plants at one posture, stacked; states are (x, gauge biases), S in all."""

    A: Array  # (P, S, S)
    B: Array  # (P, S, m)
    C: Array  # (P, y, S)
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
        self._bank = lru_cache(KEPT // len(self.plants))(self._stacked)

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
        estimates = [self._estimate(belief, i, y) for i, y in enumerate(readings)]
        belief.steps = belief.steps + 1
        return estimates, belief

    def act(self, belief: Belief, torque: Array) -> None:
        """Note the torques (N, m) [N m] of the coming step."""
        apart = torque[:, None] - belief.forward
        belief.torque = np.concatenate([belief.torque[:, 1:], apart[:, None]], axis=1)

    def _estimate(self, belief: Belief, i: int, reading: Array) -> Estimate:
        """Estimate of environment i after its filters took a reading (y,)."""
        posture, step, past = belief.course.posture[i], int(belief.steps[i]), belief.torque[i]
        bank = self._bank(place_of(posture))
        self._take(bank, belief, i, reading)
        best = int(np.argmin(belief.surprise[i]))
        plant, delay = self.hypotheses[best]
        now: Array = belief.state[i][best]
        for torque in past[len(past) - min(delay, step) :, plant]:
            now = bank.A[plant] @ now + bank.B[plant] @ torque
        model = self.models.at(posture, plant)
        return Estimate(model, now[: len(model.A)].copy(), belief.forward[i, plant])

    def _take(self, bank: _Bank, belief: Belief, i: int, reading: Array) -> None:
        """Update the filters that a new reading reaches; before its delay the first one repeats."""
        step = int(belief.steps[i])
        if step == 0:
            belief.first[i] = reading
        new = (self._delay < step) | (step == 0)
        plant, delay, state = self._plant[new], self._delay[new], belief.state[i][new]
        if step:
            past = belief.torque[i][-1 - delay, plant]
            state = _times(bank.A[plant], state) + _times(bank.B[plant], past)
        seen = self.models.at(belief.course.posture[i]).readings
        shift = belief.place[i][-1 - delay, plant] @ seen.T
        innovation = reading - shift - _times(bank.C[plant], state)
        at = np.minimum(np.maximum(step - delay, 0), LEARNING - 1)
        belief.state[i][new] = state + _times(bank.gain[at, plant], innovation)
        belief.surprise[i][new] += bank.bulk[at, plant] + np.einsum(
            "hi,hij,hj->h", innovation, bank.precision[at, plant], innovation
        )
        if np.any(np.abs(reading - belief.first[i]) > 0.5 * self.sensors.quantum):
            belief.surprise[i][~new] = np.inf

    def _refer(self, belief: Belief) -> None:
        """Move the references to the present; a resting target's stay zero."""
        if "target_rate" not in self.read:
            return
        found = [self.reference.at(belief.course, i) for i in range(len(belief.forward))]
        place = np.array([offset for offset, _ in found])
        place[:, :, self.models.joints] += belief.course.way[:, None]
        belief.place = np.concatenate([belief.place[:, 1:], place[:, None]], axis=1)
        belief.forward = np.array([forward for _, forward in found])

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
        found = [self._filter(self.models.at(np.array(place), plant)) for plant in self.plants]
        A, B, C, *learned = (np.array(list(part)) for part in zip(*found, strict=True))
        return _Bank(A, B, C, *(np.moveaxis(part, 1, 0) for part in learned))

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


def _times(matrices: Array, vectors: Array) -> Array:
    """(H, a) products of (H, a, b) and (H, b)."""
    return np.matmul(matrices, vectors[..., None])[..., 0]


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


def _spread(core: Any, models: LinearModels) -> tuple[Array, Array]:
    """(n, w) standard deviations of the initial coordinates and rates, a column per vibration."""
    share = core.task.shake[1] / UNIFORM
    place, rate = np.zeros((2, models.model.n, max(len(core.scales.vibration), 1)))
    if models.modal and share:
        place[models.modal] = share * np.array(core.scales.vibration).T
        rate[models.modal] = share * np.array(core.scales.vibration_rate).T
    return place, rate
