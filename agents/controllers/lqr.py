"""Linear-quadratic control of the tip about the target: LQR on states, LQG on sensors.

The cost of a control step is |tip error|^2 + (lead |tip velocity|)^2, in units of the settled band,
plus `effort` times the squared action of every joint, plus a little for the joints themselves,
which a tip does not fix where there are more than three. Joint errors are clipped before the gain:
a far target would otherwise saturate every torque for long (see Franklin, Powell and Emami-Naeini,
Feedback Control of Dynamic Systems, on saturation).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
from scipy.linalg import solve_discrete_are

from agents.controllers.models.linear_model import KEPT, LinearModel, LinearModels
from agents.controllers.models.memory import Remembering, fresh_of, kept
from agents.controllers.models.plan import TimedMoves
from agents.controllers.observers.exact import Estimate, ExactState, alike
from agents.controllers.observers.kalman import Belief, KalmanFilters
from dynamics.types import AnyArray, Array
from flexarm_env.task.tasks import SETTLED_BAND

JOINTS = 0.1  # weight of joint errors over that of tip errors


class Cost:
    """Quadratic cost of a control step; `lead` is over the environment's move time."""

    def __init__(self, env: Any, models: LinearModels, *, effort: float, lead: float) -> None:
        base = env.unwrapped
        self.models, self.reach = models, base.reach
        self.limit = np.asarray(base.torque_limit, dtype=np.float64)
        self.move_time = base.core.move_time
        self.effort, self.lead = effort, lead * self.move_time

    def of(self, model: LinearModel) -> tuple[Array, Array]:
        """Q (2r, 2r) of x'Qx and R (m, m) of tau'R tau."""
        r = len(model.modes)
        place = model.tip.T @ model.tip / (SETTLED_BAND * self.reach) ** 2
        joints = model.shapes[self.models.joints]
        place += (JOINTS / SETTLED_BAND) ** 2 * joints.T @ joints
        Q = np.zeros((2 * r, 2 * r))
        Q[:r, :r], Q[r:, r:] = place, self.lead**2 * place
        return Q, np.diag(self.effort / self.limit**2)

    def refuse_unsolvable(self) -> None:
        """Raise a LinAlgError where the weights allow no gain."""
        model = self.models.at(np.zeros(len(self.models.joints)))
        try:
            riccati(model.A, model.B, *self.of(model))
        except np.linalg.LinAlgError:
            raise np.linalg.LinAlgError(
                f"effort ({self.effort:g}) and lead ({self.lead / self.move_time:g}) leave LQR's "
                "Riccati equation without a solution; take values nearer to 1 and 0.1."
            ) from None


class Gain:
    """tau = forward - K x, with the joint errors in x clipped to `clip` [rad]."""

    def __init__(self, cost: Cost, clip: float = np.inf) -> None:
        self.cost, self.clip = cost, clip
        self.of = kept(self._gains, KEPT)

    def __call__(self, estimates: list[Estimate]) -> Array:
        """(N, m) [N m] torques, not yet limited."""
        torques = np.empty((len(estimates), self.cost.limit.size))
        for rows, group in alike(estimates):
            torques[rows] = self._torques(group)
        return torques

    def _torques(self, estimates: list[Estimate]) -> Array:
        terms = zip(*(self.of(estimate.model) for estimate in estimates), strict=True)
        K, joints, modes = map(np.array, terms)
        x = np.array([estimate.x for estimate in estimates])[..., None]
        place = joints @ x[:, : joints.shape[2]]
        x[:, : joints.shape[2]] -= modes @ (place - np.clip(place, -self.clip, self.clip))
        return np.array([estimate.forward for estimate in estimates]) - (K @ x)[..., 0]

    def _gains(self, model: LinearModel) -> tuple[Array, Array, Array]:
        """K (m, 2r), joint angles (m, r) per mode, modes (r, m) per joint angle."""
        (Q, R), joints = self.cost.of(model), self.cost.models.joints
        K = gain(model, riccati(model.A, model.B, Q, R), R)
        return K, model.shapes[joints], model.modes[:, joints]


def gain(model: LinearModel, P: Array, R: Array) -> Array:
    """(m, 2r) K of tau = -K x, where the cost-to-go is x'P x and that of torques tau'R tau."""
    A, B = model.A, model.B
    return np.asarray(np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A))


def riccati(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Solution of the discrete Riccati equation; a LinAlgError where the weights allow none.

    Balancing, which is tried first, can fail by round-off that depends on the processor.
    """
    for balanced in (True, False):
        try:
            return np.asarray(solve_discrete_are(A, B, Q, R, balanced=balanced), dtype=np.float64)
        except (ValueError, np.linalg.LinAlgError) as error:
            reason = str(error)
    raise np.linalg.LinAlgError(reason)


class ModelBased(Remembering):
    """A law on the estimates of an observer, whose memory is the controller's."""

    def __init__(self, env: Any, observer: Any, law: Any) -> None:
        self.observer, self.law = observer, law
        self.limit = np.asarray(env.unwrapped.torque_limit, dtype=np.float64)

    def act(self, x: AnyArray, memory: Any, fresh: AnyArray) -> tuple[AnyArray, Any]:
        """Actions and the memory."""
        estimates, memory = self.observer.observe(x, memory, fresh)
        torque = np.clip(self.law(estimates), -self.limit, self.limit)
        self.observer.act(memory, torque)
        return torque / self.limit, memory


class OutputFeedback(ModelBased):
    """Control on Kalman filters, which remember the torques."""

    @property
    def n_known(self) -> int:
        """Number of columns of `known`."""
        return int(self.observer.n_known)

    def watched(
        self, observation: AnyArray, state: Belief | None, episode_start: AnyArray | None
    ) -> Belief:
        """The belief after an observation; no torque is noted before `told`."""
        x = np.atleast_2d(observation)
        _, belief = self.observer.observe(x, state, fresh_of(state, episode_start, len(x)))
        self.observer.act(belief, np.zeros((len(x), self.limit.size)))
        return cast(Belief, belief)

    def known(self, state: Belief) -> AnyArray:
        """(N, n_known) estimates of the filters, see `KalmanFilters.known`."""
        return np.asarray(self.observer.known(state))

    def told(self, state: Belief, action: AnyArray) -> Belief:
        """The belief after actions (N, m) in [-1, 1] other than its own were taken."""
        self.observer.told(state, np.atleast_2d(action) * self.limit)
        return state


def model_based(
    env: Any, name: str, law: Callable[[Cost], Any], *, effort: float, lead: float,
    load: float | None = None, disturbance: float | None = None,
    filters: type[KalmanFilters] = KalmanFilters, **observing: Any,
) -> ModelBased:  # fmt: skip
    """Controller of a law, which is made of its cost; `observing` are keywords of the observer.

    It needs obs="state"; with a `disturbance` it needs obs="sensors" and has filters. With a `load`
    it acts about planned moves.
    """
    if load is not None:
        observing["planner"] = TimedMoves(env, LinearModels.of(env), load)
    kind: type[ModelBased] = ModelBased if disturbance is None else OutputFeedback
    observer: Any = (
        ExactState(env, name, **observing)
        if disturbance is None
        else filters(env, name, disturbance, **observing)
    )
    cost = Cost(env, observer.models, effort=effort, lead=lead)
    cost.refuse_unsolvable()
    return kind(env, observer, law(cost))


def regulator(env: Any, name: str, *, clip: float = np.inf, **parameters: Any) -> ModelBased:
    """LQR, with a `disturbance` LQG; the parameters are those of `model_based`."""
    return model_based(env, name, partial(Gain, clip=clip), **parameters)
