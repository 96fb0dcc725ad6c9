"""Rewards: a table of terms, and weights of them as presets, as a keyword and as wrappers.

reward = sum of weight times term. The environment measures the terms at every step and puts them
into info["reward_terms"]; the keyword `reward=` and the wrappers here only weigh them, so that both
give the same numbers to round-off.

Terms are plain functions on any scalars: floats, or symbols where an environment is compiled.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, SupportsFloat

import gymnasium as gym

from dynamics.description import validate

HEAVIEST = 1e9  # weight of a term


class Measured(NamedTuple):
    """What a reward term sees, all dimensionless."""

    error: Any  # tip error over reach
    speed: Any  # tip speed relative to the target's, over that of a typical move
    vibration: Any  # elastic tip displacement over 10 % of the reach
    rate: Any  # mean square over the joints of rate over that of a typical move
    effort: Any  # mean square of the actions
    change: Any  # mean square of the change of the actions
    failed: Any  # 1 or 0


def tracking(m: Measured) -> Any:
    """Closeness of the tip to its target: 1 on it, 1/2 at 10 % of the reach."""
    return 1.0 / (1.0 + 10.0 * m.error)


def precision(m: Measured) -> Any:
    """Narrow closeness: 1 on the target, 1/2 at the edge of the settled band, 2 % of the reach."""
    return 1.0 / (1.0 + (50.0 * m.error) ** 2)


def stillness(m: Measured) -> Any:
    """On the target and at rest: 1 there, 1/2 at 5 % of the reach or 10 % of a move's speed."""
    return 1.0 / (1.0 + (20.0 * m.error) ** 2 + (10.0 * m.speed) ** 2)


def distance(m: Measured) -> Any:
    """Negative tip error over the reach."""
    return -m.error


def tip_speed(m: Measured) -> Any:
    """Negative squared tip speed (of a typical move's), halved at 10 % of the reach off target."""
    return -(m.speed**2) / (1.0 + (10.0 * m.error) ** 2)


def vibration(m: Measured) -> Any:
    """Negative squared elastic tip displacement (of 10 % of the reach)."""
    return -(m.vibration**2)


def effort(m: Measured) -> Any:
    """Negative mean square of the actions."""
    return -m.effort


def smoothness(m: Measured) -> Any:
    """Negative mean square of the change of the actions."""
    return -m.change


def joint_rate(m: Measured) -> Any:
    """Negative mean square of the joint rates (of a typical move's)."""
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
        "smoothness": 0.02, "failure": 20.0,
    },
    "track": {"tracking": 0.6, "precision": 0.4, "smoothness": 0.02, "failure": 20.0},
    "damp": {"stillness": 1.0, "tip_speed": 0.5, "smoothness": 0.02, "failure": 20.0},
    "tip_tracking": {"tracking": 0.7, "precision": 0.3, "failure": 20.0},
    "vibration_suppression": {
        "tracking": 0.4, "stillness": 0.6, "vibration": 0.1, "smoothness": 0.02, "failure": 20.0,
    },
}  # fmt: skip


def resolve_weights(reward: str | Mapping[str, float]) -> dict[str, float]:
    """Weights of a preset's name or of a dict, checked; terms left out weigh nothing."""
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


class _WeighedReward(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Replace the reward by a weighted sum of info["reward_terms"]."""

    preset: str

    def __init__(self, env: gym.Env[Any, Any], weights: Mapping[str, float] | None = None) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, weights=weights)
        gym.Wrapper.__init__(self, env)
        chosen = resolve_weights(self.preset if weights is None else weights)
        self.weights = [chosen.get(name, 0.0) for name in TERMS]

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """One step; the reward is weighed anew."""
        observation, _, terminated, truncated, info = self.env.step(action)
        reward = 0.0
        for weight, term in zip(self.weights, info["reward_terms"].values(), strict=True):
            reward += weight * term
        return observation, reward, terminated, truncated, info


class TipTrackingReward(_WeighedReward):
    """Reward a tip close to its target; `weights` replaces the preset "tip_tracking"."""

    preset = "tip_tracking"


class VibrationSuppressionReward(_WeighedReward):
    """Reward a tip at rest on its target; `weights` replaces "vibration_suppression"."""

    preset = "vibration_suppression"
