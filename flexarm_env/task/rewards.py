"""Reward terms, presets of weights, and wrappers that apply other weights.

reward = sum of weight times term. The environment computes the terms at every step and puts them
into info["reward_terms"]. The keyword `reward=` and the wrappers here only set the weights, so both
give the same numbers to round-off.

A term is a plain function of scalars: floats, or CasADi symbols where an environment is compiled.
Rates are in units of the rate scale, tip speeds in units of reach times rate scale (`core.Core`).
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, SupportsFloat

import gymnasium as gym
import numpy as np

from dynamics.description import validate
from dynamics.types import AnyArray
from flexarm_env.task.tasks import SETTLED_BAND

HEAVIEST = 1e9  # largest weight of a term
FAILURE = 100.0  # weight of a failure: a hundred steps of the best reward


class Measured(NamedTuple):
    """Dimensionless quantities from which reward terms are computed."""

    error: Any  # tip error over reach
    speed: Any  # tip speed relative to the target, over reach times rate scale
    vibration: Any  # elastic tip displacement over 10 % of the reach
    rate: Any  # mean square over the joints of the joint rate over the rate scale
    effort: Any  # mean square of the actions
    change: Any  # mean square of the change of the actions
    failed: Any  # 1 at a step that ends the episode by failure, else 0


def tracking(m: Measured) -> Any:
    """Closeness of the tip to the target: 1 on it, 1/2 at 10 % of the reach."""
    return 1.0 / (1.0 + 10.0 * m.error)


def precision(m: Measured) -> Any:
    """Narrow closeness: 1 on the target, 1/2 at the edge of the settled band (2 % of reach)."""
    return 1.0 / (1.0 + (50.0 * m.error) ** 2)


def stillness(m: Measured) -> Any:
    """Closeness and rest: 1 at rest on the target, 1/2 at 5 % of the reach or speed 0.1."""
    return 1.0 / (1.0 + (20.0 * m.error) ** 2 + (10.0 * m.speed) ** 2)


def distance(m: Measured) -> Any:
    """Negative tip error over the reach."""
    return -m.error


def tip_speed(m: Measured) -> Any:
    """Negative squared tip speed, halved at a tip error of 10 % of the reach."""
    return -(m.speed**2) / (1.0 + (10.0 * m.error) ** 2)


def vibration(m: Measured) -> Any:
    """Negative squared elastic tip displacement, in units of 10 % of the reach."""
    return -(m.vibration**2)


def effort(m: Measured) -> Any:
    """Negative mean square of the actions."""
    return -m.effort


def smoothness(m: Measured) -> Any:
    """Negative mean square of the change of the actions."""
    return -m.change


def joint_rate(m: Measured) -> Any:
    """Negative mean square of the joint rates."""
    return -m.rate


def failure(m: Measured) -> Any:
    """-1 at the step that ends an episode by failure."""
    return -m.failed


TERMS: dict[str, Callable[[Measured], Any]] = {
    term.__name__: term
    for term in (
        tracking, precision, stillness, distance, tip_speed, vibration, effort, smoothness,
        joint_rate, failure,
    )
}  # fmt: skip

REWARDS: dict[str, dict[str, float]] = {
    "reach": {
        "tracking": 0.5, "precision": 0.25, "stillness": 0.25, "tip_speed": 0.02,
        "smoothness": 0.02, "failure": FAILURE,
    },
    "track": {"tracking": 0.6, "precision": 0.4, "smoothness": 0.02, "failure": FAILURE},
    "damp": {"stillness": 1.0, "tip_speed": 0.5, "smoothness": 0.02, "failure": FAILURE},
    "tip_tracking": {"tracking": 0.7, "precision": 0.3, "failure": FAILURE},
    "vibration_suppression": {
        "tracking": 0.4, "stillness": 0.6, "vibration": 0.1, "smoothness": 0.02, "failure": FAILURE,
    },
}  # fmt: skip


def goal_reward(achieved: AnyArray, desired: AnyArray, info: Any = None) -> Any:
    """(...) reward of tips (..., k) over the reach: 1 in the settled band of the goal, else 0.

    A failure ends the reward, so that no policy gains by one. `info` is not used.
    """
    apart = np.linalg.norm(np.subtract(achieved, desired, dtype=np.float64), axis=-1)
    return np.asarray(apart < SETTLED_BAND, dtype=np.float64)[()]


def resolve_weights(reward: str | Mapping[str, float]) -> dict[str, float]:
    """Checked weights by term, from the name of a preset or a dict; other weights are zero."""
    if isinstance(reward, str):
        if reward not in REWARDS:
            raise ValueError(
                f"Unknown reward {validate.shown(reward)}. Known: {sorted(REWARDS)}; or give a "
                "dict of weights."
            )
        return dict(REWARDS[reward])
    if not isinstance(reward, Mapping):
        raise ValueError(
            f"reward must be a name or a dict of weights, got {validate.shown(reward)}."
        )
    unknown = sorted(set(map(str, reward)) - set(TERMS))
    if unknown:
        raise ValueError(f"Unknown reward terms {unknown}. Known: {sorted(TERMS)}.")
    weights = {name: validate.number(x, f"The weight of {name!r}") for name, x in reward.items()}
    for name, weight in weights.items():
        if abs(weight) > HEAVIEST:
            raise ValueError(
                f"The weight of {name!r} must be at most {HEAVIEST:g} in size, got {weight!r}."
            )
    if not any(weights.values()):
        raise ValueError(f"At least one weight must differ from zero, got {weights!r}.")
    return weights


class _WeightedReward(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Replace the reward by a weighted sum of info["reward_terms"]."""

    preset: str

    def __init__(self, env: gym.Env[Any, Any], weights: Mapping[str, float] | None = None) -> None:
        chosen = resolve_weights(self.preset if weights is None else weights)
        stored = None if weights is None else chosen  # plain floats, for JSON
        gym.utils.RecordConstructorArgs.__init__(self, weights=stored)
        gym.Wrapper.__init__(self, env)
        self.weights = [chosen.get(name, 0.0) for name in TERMS]

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and return the reward with these weights."""
        observation, _, terminated, truncated, info = self.env.step(action)
        reward = 0.0
        for weight, term in zip(self.weights, info["reward_terms"].values(), strict=True):
            reward += weight * term
        return observation, reward, terminated, truncated, info


class TipTrackingReward(_WeightedReward):
    """Reward a tip close to the target; `weights` replaces the preset "tip_tracking"."""

    preset = "tip_tracking"


class VibrationSuppressionReward(_WeightedReward):
    """Reward a tip at rest on the target; `weights` replaces "vibration_suppression"."""

    preset = "vibration_suppression"
