"""Sum of a classical controller's action and a policy's (Johannink et al., ICRA 2019).

A policy names its base and the base's parameters in its description, so that it acts as it was
trained, whatever is tuned later.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.leaderboard.tracks import takes_part, track_of
from agents.policy import Controller, Policy, PolicyError
from agents.tune import parameters_of
from dynamics.description import validate
from dynamics.types import AnyArray

KEY = "residual"  # in the description of a policy


@runtime_checkable
class Listener(Protocol):
    """A controller that remembers actions, and must know which were taken."""

    def told(self, state: Any, action: AnyArray) -> Any:
        """The state after actions (N, m) in [-1, 1] other than its own."""
        ...


@dataclass(frozen=True)
class Base:
    """A controller whose actions are corrected, and the largest correction."""

    controller: Controller
    scale: float  # of the policy's actions

    def predict(
        self, observation: AnyArray, state: Any, episode_start: AnyArray | None
    ) -> tuple[AnyArray, AnyArray, Any]:
        """The base's actions (..., m), the policy's observation with them, and the next state."""
        own, state = self.controller.predict(observation, state, episode_start)
        own = np.asarray(own, np.float32)
        return own, np.concatenate([observation, own], axis=-1, dtype=np.float32), state

    def corrected(self, own: AnyArray, correction: AnyArray, state: Any) -> tuple[AnyArray, Any]:
        """Actions (..., m) that are taken, and the base's state after them."""
        action = np.clip(own + np.float32(self.scale) * correction, -1.0, 1.0)
        if isinstance(self.controller, Listener):
            state = self.controller.told(state, action)
        return action, state


@dataclass(frozen=True)
class Residual:
    """A policy on its base; the state is a pair of theirs."""

    base: Base
    policy: Controller

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions (..., m) in [-1, 1], and the next state."""
        before, memory = (None, None) if state is None else state
        own, seen, before = self.base.predict(observation, before, episode_start)
        correction, memory = self.policy.predict(seen, memory, episode_start, deterministic)
        action, before = self.base.corrected(own, correction, before)
        return action, (before, memory)


def description(base: str, scale: float, env_id: str, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Description of a base with its tuned parameters; a ValueError if it was not tuned there."""
    validate.choice(base, f"{KEY}.base", CONTROLLERS)
    parameters: dict[str, float] = {}
    if CONTROLLERS[base].ranges:
        track = track_of(base, env_id, kwargs)
        if track is None or not takes_part(base, env_id, track):
            raise ValueError(
                f"{KEY}.base: {base} was not tuned for {env_id} with keywords "
                f"{validate.shown(dict(kwargs))}; choose the id as it is or with hardware: "
                "laboratory, or another base."
            )
        parameters = parameters_of(base, env_id, track)
    return {"base": base, "parameters": parameters, "scale": scale}


def acting(policy: Policy, env: Any) -> Controller:
    """The policy, on its base if it has one, for an environment or a batch."""
    if KEY not in policy.about:
        return policy
    try:
        return Residual(base_of(policy.about[KEY], env), policy)
    except ValueError as error:
        raise PolicyError(f"The policy's base cannot act here: {error}") from None


def base_of(about: Any, env: Any) -> Base:
    """Base from its description, {base, parameters, scale}; raises ValueError."""
    given: Mapping[str, Any] = validate.mapping(about, KEY, ("base", "parameters", "scale"))
    name = validate.choice(given.get("base"), f"{KEY}.base", CONTROLLERS)
    known = list(CONTROLLERS[name].ranges)
    values = validate.mapping(given.get("parameters"), f"{KEY}.parameters", known)
    parameters = {
        key: validate.positive(values.get(key), f"{KEY}.parameters.{key}", "-") for key in known
    }
    scale = validate.nonnegative(given.get("scale"), f"{KEY}.scale", "-")
    return Base(controller(name, env, parameters), scale)


def n_taken(policy: Policy) -> int:
    """Size of the environment's observation; a policy on a base also sees the base's action."""
    return policy.n_observation - (policy.biases[-1].size if KEY in policy.about else 0)
