"""Linear-quadratic control of the tip about the target: LQR on states, LQG on sensors.

The cost of a control step is |tip error|^2 + (lead |tip velocity|)^2, in units of the settled band,
plus `effort` times the squared action of every joint, plus a little for the joints themselves,
which a tip does not fix where there are more than three. Joint errors are clipped before the gain:
a far target would otherwise saturate every torque for long (see Franklin, Powell and Emami-Naeini,
Feedback Control of Dynamic Systems, on saturation).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are

from agents.controllers.linear_model import LinearModel, LinearModels
from agents.controllers.reading import Reading
from dynamics.types import AnyArray, Array
from flexarm_env.tasks import SETTLED_BAND

JOINTS = 0.1  # weight of joint errors over that of tip errors


@dataclass
class _Design:
    """Gains of a controller at every posture it has met."""

    models: LinearModels
    limit: Array  # (m,) [N m]
    reach: float  # [m]
    effort: float  # [-]
    lead: float  # [s]
    known: dict[int, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, env: Any, effort: float, lead: float) -> "_Design":
        """Design for an environment; `lead` is over its move time."""
        base = env.unwrapped
        limit = np.asarray(base.torque_limit, dtype=np.float64)
        return cls(LinearModels.of(env), limit, base.reach, effort, lead * base.core.move_time)

    def gain(self, model: LinearModel) -> Array:
        """(m, 2r) K of tau = -K x."""
        key = id(model)
        if key not in self.known:
            self.known[key] = self._solved(model)
        return self.known[key]

    def _solved(self, model: LinearModel) -> Array:
        r = len(model.modes)
        place = model.tip.T @ model.tip / (SETTLED_BAND * self.reach) ** 2
        joints = model.shapes[self.models.joints]
        place += (JOINTS / SETTLED_BAND) ** 2 * joints.T @ joints
        Q = np.zeros((2 * r, 2 * r))
        Q[:r, :r], Q[r:, r:] = place, self.lead**2 * place
        R = np.diag(self.effort / self.limit**2)
        P = riccati(model.A, model.B, Q, R)
        return np.asarray(np.linalg.solve(R + model.B.T @ P @ model.B, model.B.T @ P @ model.A))


class LQR:
    """State feedback; needs obs="state".

    The model is that at the target of the episode's start. A moving target is followed with the
    torque, the joint angles and the bending of a steady acceleration at the target's own.
    """

    def __init__(self, env: Any, *, effort: float, lead: float, clip: float) -> None:
        self.read = Reading.of(env)
        self.read.require("lqr", "joint_error", "joint_rate", "modal_amplitude", "modal_rate")
        self.design = _Design.of(env, effort, lead)
        self.models, self.limit = self.design.models, self.design.limit
        self.clip = clip

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions; the state is the target's posture at the start, and its last rate."""
        x = np.atleast_2d(observation)
        rate = target_rate(self.read, x)
        fresh = fresh_of(state, episode_start, len(x))[:, None]
        posture, before = (posture_of(self.read, x), rate) if state is None else state
        posture = np.where(fresh, posture_of(self.read, x), posture)
        acceleration = (rate - np.where(fresh, rate, before)) / self.models.control_dt
        torque = np.empty((len(x), self.limit.size))
        for i, angles in enumerate(posture):
            model = self.models.at(angles)
            offset, forward = followed(model, self.models, acceleration[i])
            error = model.modes @ self._error(x[i], rate[i], offset)
            torque[i] = forward - self.design.gain(model) @ error.ravel()
        action = np.clip(torque / self.limit, -1.0, 1.0)
        return action.reshape(*np.shape(observation)[:-1], -1), (posture, rate)

    def _error(self, x: AnyArray, rate: Array, offset: Array) -> Array:
        """(2, n, 1) coordinates and rates from the target's, joint errors clipped."""
        joints, modal = self.models.joints, self.models.modal
        place, speed = np.zeros((2, self.models.model.n))
        place[joints], place[modal] = self.read(x, "joint_error"), self.read(x, "modal_amplitude")
        speed[joints], speed[modal] = self.read(x, "joint_rate") - rate, self.read(x, "modal_rate")
        place -= offset
        place[joints] = np.clip(place[joints], -self.clip, self.clip)
        return np.array([place, speed])[..., None]


@dataclass
class _Belief:
    """Knowledge of LQG between two steps, for each of D delays."""

    x: list[Array]  # N times (D, 2r): estimated state when the latest reading was taken
    surprise: Array  # (D, N) sum of squared innovations over their variances
    torque: Array  # (N, latest + 1, m) [N m] past torques, oldest first
    posture: Array  # (N, m) [rad] target


class LQG:
    """Output feedback: steady Kalman filters, one per possible delay, and the LQR gain.

    The readings are joint angles and curvatures; joint rates are their differences and add nothing.
    The filter with the smallest innovations since the start is believed (multiple-model estimation,
    Bar-Shalom, Li and Kirubarajan, Estimation with Applications, 2001, section 11.6); its estimate
    is predicted to the present with the torques since.
    """

    def __init__(
        self, env: Any, *, effort: float, lead: float, clip: float, disturbance: float
    ) -> None:
        self.read = Reading.of(env)
        self.read.require("lqg", "joint_error", "root_curvature")
        self.design = _Design.of(env, effort, lead)
        self.models, self.limit = self.design.models, self.design.limit
        self.clip, self.disturbance = clip, disturbance
        self.delays, self.noise = _sensors(env.unwrapped.core)
        self._filters: dict[int, tuple[Array, Array]] = {}

    def predict(
        self,
        observation: AnyArray,
        state: _Belief | None = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, _Belief]:
        """Actions; the state is a belief."""
        x = np.atleast_2d(observation)
        error = self.read(x, "joint_error")
        readings = np.concatenate([error, self.read(x, "root_curvature")], axis=1)
        belief = self._started(x, error, state, fresh_of(state, episode_start, len(x)))
        torque = np.empty((len(x), self.limit.size))
        for i, posture in enumerate(belief.posture):
            model = self.models.at(posture)
            now = self._clipped(model, self._present(model, belief, i, readings[i]))
            torque[i] = np.clip(-self.design.gain(model) @ now, -self.limit, self.limit)
        belief.torque = np.concatenate([belief.torque[:, 1:], torque[:, None]], axis=1)
        action = torque / self.limit
        return action.reshape(*np.shape(observation)[:-1], -1), belief

    def _clipped(self, model: LinearModel, x: Array) -> Array:
        """(2r,) state with joint errors clipped."""
        r, joints = len(model.modes), self.models.joints
        place = model.shapes @ x[:r]
        place[joints] = np.clip(place[joints], -self.clip, self.clip)
        return np.concatenate([model.modes @ place, x[r:]])

    def _present(self, model: LinearModel, belief: _Belief, i: int, reading: Array) -> Array:
        """(2r,) present state of environment i, after its filters took a reading."""
        gain, precision = self._filter(model)
        past = belief.torque[i]
        for k, delay in enumerate(self.delays):
            x = model.A @ belief.x[i][k] + model.B @ past[-1 - delay]
            innovation = reading - model.C @ x
            belief.x[i][k] = x + gain @ innovation
            belief.surprise[k, i] += innovation @ precision @ innovation
        best = int(np.argmin(belief.surprise[:, i]))
        now: Array = belief.x[i][best]
        for torque in past[len(past) - self.delays[best] :]:
            now = model.A @ now + model.B @ torque
        return now.copy()

    def _started(
        self, x: AnyArray, error: Array, belief: _Belief | None, fresh: AnyArray
    ) -> _Belief:
        """The belief, begun anew where an episode starts: the arm rests at its first reading."""
        if belief is None:
            count, m = len(self.delays), self.limit.size
            belief = _Belief(
                x=[np.zeros((count, 0))] * len(x),
                surprise=np.zeros((count, len(x))),
                torque=np.zeros((len(x), self.delays[-1] + 1, m)),
                posture=np.zeros((len(x), m)),
            )
        belief.surprise[:, fresh], belief.torque[fresh] = 0.0, 0.0
        belief.posture[fresh] = posture_of(self.read, x)[fresh]
        for i in np.flatnonzero(fresh):
            model = self.models.at(belief.posture[i])
            place = np.zeros(self.models.model.n)
            place[self.models.joints] = error[i]
            start = np.concatenate([model.modes @ place, np.zeros(len(model.modes))])
            belief.x[i] = np.tile(start, (len(self.delays), 1))
        return belief

    def _filter(self, model: LinearModel) -> tuple[Array, Array]:
        """(2r, m + g) steady Kalman gain of a reading, and the precision of the innovations."""
        key = id(model)
        if key not in self._filters:
            W = model.B @ np.diag((self.disturbance * self.limit) ** 2) @ model.B.T
            W += 1e-12 * np.trace(W) / len(W) * np.eye(len(W))
            V = np.diag(self.noise**2)
            P = riccati(model.A.T, model.C.T, W, V)
            precision: Array = np.asarray(np.linalg.inv(model.C @ P @ model.C.T + V), np.float64)
            self._filters[key] = P @ model.C.T @ precision, precision
        return self._filters[key]


def riccati(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Solution of the discrete Riccati equation; a LinAlgError where the weights allow none."""
    try:
        return np.asarray(solve_discrete_are(A, B, Q, R), dtype=np.float64)
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from None


def posture_of(read: Reading, x: AnyArray) -> Array:
    """(N, m) [rad] target angles; the first, which does not matter without gravity, is zero."""
    error = read(x, "joint_error")
    posture = np.zeros_like(error)
    if "joint_sin" in read:
        angle = np.arctan2(read(x, "joint_sin"), read(x, "joint_cos"))
        posture[:, -angle.shape[1] :] = angle - error[:, -angle.shape[1] :]
    return posture


def target_rate(read: Reading, x: AnyArray) -> Array:
    """(N, m) [rad/s] rate of the target."""
    return (
        read(x, "target_rate") if "target_rate" in read else np.zeros_like(read(x, "joint_error"))
    )


def followed(model: LinearModel, models: LinearModels, acceleration: Array) -> tuple[Array, Array]:
    """(n,) coordinates off the target and (m,) [N m] torque of a steady joint acceleration.

    The links bend under it, and the joints turn so far that the tip stays on the target.
    """
    joints, modal = models.joints, models.modal
    offset = np.zeros(len(model.M))
    if modal and acceleration.any():
        load = -model.M[np.ix_(modal, joints)] @ acceleration
        offset[modal] = np.linalg.solve(model.K[np.ix_(modal, modal)], load)
        gap = model.tip_of[:, modal] @ offset[modal]
        offset[joints] = -np.linalg.lstsq(model.tip_of[:, joints], gap, rcond=1e-6)[0]
    return offset, model.M[np.ix_(joints, joints)] @ acceleration


def fresh_of(state: Any, episode_start: AnyArray | None, count: int) -> AnyArray:
    """(N,) environments whose episode starts."""
    if state is None or episode_start is None:
        return np.full(count, state is None)
    return np.asarray(episode_start, dtype=bool)


def _sensors(core: Any) -> tuple[list[int], Array]:
    """Possible delays [control steps], and standard deviations of the readings."""
    gauges = np.asarray(core.gauge_scale)
    hardware = core.sensing.hardware if core.sensing else None
    if hardware is None:
        return [0], np.array([*[1e-5] * core.arm.n_joint, *(1e-4 * gauges)])
    count = 2.0 * np.pi / hardware.encoder_counts if hardware.encoder_counts else 1e-5
    quantum = 1.0 / hardware.gauge_counts if hardware.gauge_counts else 1e-4
    deviation = np.hypot(hardware.gauge_noise, np.hypot(hardware.gauge_bias, quantum) / 3.0)
    angles = [count / np.sqrt(12.0)] * core.arm.n_joint
    least, most = hardware.delay
    return list(range(least, most + 1)), np.array([*angles, *(deviation * gauges)])
