"""A classical controller with a learned part, which a policy gives.

A policy names its base and the base's parameters in its description, so that it acts as it was
trained, whatever is tuned later.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.controllers.models.reading import Reading
from agents.hybrid.informed import expert
from agents.leaderboard.tracks import takes_part, track_of
from agents.policy import Controller, Policy, PolicyError
from agents.tuned import parameters_of
from dynamics.description import validate
from dynamics.types import AnyArray, Array

KEY = "base"  # in experiments and in the description of a policy
EXPERT = "expert"  # in the description of a policy that imitates a controller and needs none
FIELDS = ("controller", "learned", "parameters", "scale")


@runtime_checkable
class Observer(Protocol):
    """A controller that estimates the arm's state, and must know which actions were taken."""

    @property
    def n_known(self) -> int:
        """Number of estimated quantities."""
        ...

    def watched(self, observation: AnyArray, state: Any, episode_start: AnyArray | None) -> Any:
        """The state after an observation, for `told`."""
        ...

    def known(self, state: Any) -> AnyArray:
        """(N, n_known) estimates, scaled as observations are."""
        ...

    def told(self, state: Any, action: AnyArray) -> Any:
        """The state after actions (N, m) in [-1, 1] other than its own."""
        ...


class Base(Protocol):
    """The classical controller on which a policy acts."""

    added: int  # numbers of the policy's observation beyond the environment's

    def begin(
        self, observation: AnyArray, state: Any, episode_start: AnyArray | None
    ) -> tuple[AnyArray, Any]:
        """The policy's observation, and what `complete` needs of this step."""
        ...

    def complete(self, begun: Any, learned: AnyArray) -> tuple[AnyArray, Any]:
        """Actions (..., m) in [-1, 1] with the policy's (..., m), and the next state."""
        ...


class Residual:
    """Sum of both actions, clipped (Johannink et al., Residual RL for robot control, ICRA 2019).

    The policy also sees the controller's actions, and the state that it estimates.
    """

    def __init__(self, controller: Controller, scale: float, env: Any) -> None:
        self.controller, self.scale = controller, np.float32(scale)
        estimated = controller.n_known if isinstance(controller, Observer) else 0
        self.added = env.unwrapped.torque_limit.size + estimated

    def begin(
        self, observation: AnyArray, state: Any, episode_start: AnyArray | None
    ) -> tuple[AnyArray, Any]:
        """The observation, the controller's actions, its estimates; its actions and state."""
        own, state = self.controller.predict(observation, state, episode_start)
        own = np.asarray(own, np.float32)
        seen = [observation, own]
        if isinstance(self.controller, Observer):
            seen.append(self.controller.known(state).reshape(*np.shape(observation)[:-1], -1))
        return np.concatenate(seen, axis=-1, dtype=np.float32), (own, state)

    def complete(self, begun: Any, learned: AnyArray) -> tuple[AnyArray, Any]:
        """Add the policy's correction, and tell the controller the action that is applied."""
        own, state = begun
        action = np.clip(own + self.scale * learned, -1.0, 1.0)
        if isinstance(self.controller, Observer):
            state = self.controller.told(state, action)
        return action, state


class Advised(Residual):
    """The policy's actions alone, on what the controller estimates and would do itself."""

    def complete(self, begun: Any, learned: AnyArray) -> tuple[AnyArray, Any]:
        """Scale the policy's actions, and tell the controller which are applied."""
        own, state = begun
        return super().complete((np.zeros_like(own), state), learned)


class Distilled(Advised):
    """The policy's actions alone, on the observation; the controller only tells its own."""

    def __init__(self, controller: Controller, scale: float, env: Any) -> None:
        super().__init__(controller, 1.0, env)
        self.added = 0

    def begin(
        self, observation: AnyArray, state: Any, episode_start: AnyArray | None
    ) -> tuple[AnyArray, Any]:
        """The observation as it is; the controller's actions and state."""
        _, begun = super().begin(observation, state, episode_start)
        return observation, begun


class Alone:
    """The policy's actions alone, on what the controller estimates."""

    def __init__(self, controller: Controller, scale: float, env: Any) -> None:
        if not isinstance(controller, Observer):
            raise ValueError(
                f"{KEY}.learned: alone shows what a controller estimates; choose one with filters, "
                "such as lqg, or learned: residual."
            )
        self.controller, self.scale = controller, np.float32(scale)
        self.added = controller.n_known

    def begin(
        self, observation: AnyArray, state: Any, episode_start: AnyArray | None
    ) -> tuple[AnyArray, Any]:
        """The observation with the estimates; the controller's state."""
        state = self.controller.watched(observation, state, episode_start)
        known = self.controller.known(state).reshape(*np.shape(observation)[:-1], -1)
        return np.concatenate([observation, known], axis=-1, dtype=np.float32), state

    def complete(self, begun: Any, learned: AnyArray) -> tuple[AnyArray, Any]:
        """Scale the policy's actions, and tell the controller which are applied."""
        action = np.clip(self.scale * learned, -1.0, 1.0)
        return action, self.controller.told(begun, action)


class Reference:
    """Joint angles that the controller follows: the target's, moved by up to `scale` [rad]."""

    added = 0

    def __init__(self, controller: Controller, scale: float, env: Any) -> None:
        if isinstance(controller, Observer):
            raise ValueError(
                f"{KEY}.learned: reference moves the readings, of which a controller with a filter "
                "makes a motion of the arm; choose learned: residual, or another controller."
            )
        self.controller = controller
        read = Reading.of(env)
        read.require("a reference", "joint_error")
        self.errors = read.slices["joint_error"]
        self.scale: Array = scale / read.scales["joint_error"]

    def begin(
        self, observation: AnyArray, state: Any, episode_start: AnyArray | None
    ) -> tuple[AnyArray, Any]:
        """The observation as it is."""
        return observation, (observation, state, episode_start)

    def complete(self, begun: Any, learned: AnyArray) -> tuple[AnyArray, Any]:
        """The controller's actions on errors from the reference."""
        observation, state, episode_start = begun
        moved = np.array(observation)
        moved[..., self.errors] -= self.scale * learned
        action, state = self.controller.predict(moved, state, episode_start)
        return np.asarray(action, np.float32), state


LEARNED: dict[str, type[Residual] | type[Alone] | type[Reference]] = {
    "residual": Residual,
    "advised": Advised,
    "distilled": Distilled,
    "alone": Alone,
    "reference": Reference,
}


@dataclass(frozen=True)
class Hybrid:
    """A policy on its base; the state is a pair of theirs."""

    base: Base
    policy: Policy

    @property
    def n_observation(self) -> int:
        """Size of the environment's observation."""
        return self.policy.n_observation - self.base.added

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions (..., m) in [-1, 1], and the next state."""
        before, memory = (None, None) if state is None else state
        seen, begun = self.base.begin(observation, before, episode_start)
        learned, memory = self.policy.predict(seen, memory, episode_start, deterministic)
        action, before = self.base.complete(begun, learned)
        return action, (before, memory)


def description(
    name: str,
    learned: str,
    scale: float,
    env_id: str,
    kwargs: Mapping[str, Any],
    parameters: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Description of a base with its parameters, the tuned ones by default.

    An expert that is told exact states beside `hardware` has those of exact states. Raises
    ValueError for a controller that was not tuned there.
    """
    validate.choice(learned, f"{KEY}.learned", LEARNED)
    validate.choice(name, f"{KEY}.controller", CONTROLLERS)
    if CONTROLLERS[name].ranges and not parameters:
        told = LEARNED[learned] is Distilled and CONTROLLERS[name].obs == ("state",)
        track = track_of(name, env_id, {} if told and [*kwargs] == ["hardware"] else kwargs)
        if track is None or not takes_part(name, env_id, track):
            raise ValueError(
                f"{KEY}.controller: {name} was not tuned for {env_id} with keywords "
                f"{validate.shown(dict(kwargs))}; choose the id as it is or with hardware: "
                "laboratory, or another controller, or give base.parameters."
            )
        parameters = parameters_of(name, env_id, track)
    return dict(zip(FIELDS, (name, learned, dict(parameters or {}), scale), strict=True))


def acting(policy: Policy, env: Any) -> Policy | Hybrid:
    """The policy, on its base if it has one, for an environment or a batch."""
    if KEY not in policy.about:
        return policy
    try:
        return Hybrid(base_of(policy.about[KEY], env), policy)
    except ValueError as error:
        raise PolicyError(f"The policy's base cannot act here: {error}") from None


def base_of(about: Any, env: Any) -> Base:
    """Base from its description, a table of FIELDS; raises ValueError."""
    given: Mapping[str, Any] = validate.mapping(about, KEY, FIELDS)
    name = validate.choice(given.get("controller"), f"{KEY}.controller", CONTROLLERS)
    learned = validate.choice(given.get("learned"), f"{KEY}.learned", LEARNED)
    parameters = CONTROLLERS[name].checked(given.get("parameters"), f"{KEY}.parameters")
    scale = validate.nonnegative(given.get("scale"), f"{KEY}.scale", "-")
    build = expert if LEARNED[learned] is Distilled else controller
    return LEARNED[learned](build(name, env, parameters), scale, env)
