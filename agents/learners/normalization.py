"""Running statistics by which a learner sees observations and rewards normalized.

The settings are those of stable-baselines3's VecNormalize, with its defaults.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.learners.algorithms import settings
from dynamics.description import validate
from dynamics.types import AnyArray

DEFAULTS: dict[str, Any] = {
    "norm_obs": True,
    "norm_reward": True,
    "clip_obs": 10.0,  # largest size of a normalized number
    "clip_reward": 10.0,
    "epsilon": 1e-8,  # added to variances
}
LIMITS = {"clip_obs": (1e-3, 1e6), "clip_reward": (1e-3, 1e6), "epsilon": (1e-12, 1.0)}
GAMMA = 0.99  # of algorithms without a discount
STORED = ("mean", "var", "count")  # of each of stable-baselines3's RunningMeanStd


def checked_normalization(
    given: Any, algorithm: str, gamma: float | None, stack: int
) -> bool | dict[str, Any]:
    """False, or every setting of a table `env.normalize`; raises ValueError.

    Rewards are discounted by the agent's `gamma`, which the table may only repeat.
    """
    where = "env.normalize"
    if given is False:
        return False
    if stack > 1 and "buffer_size" in settings(algorithm):
        raise ValueError(
            f"{where} and env.stack ({stack}) exclude each other for {algorithm}, whose replay "
            "buffer cannot hold both; set env.stack: 1 or env.normalize: false, or choose ppo."
        )
    if given is True:
        return dict(DEFAULTS)
    table = validate.mapping(given, where, [*DEFAULTS, "gamma"])
    own = table.pop("gamma", gamma)
    if own != gamma:
        raise ValueError(
            f"{where}.gamma is always agent.kwargs.gamma ({gamma}), got {validate.shown(own)}; "
            "leave it out."
        )
    result = DEFAULTS | table
    for key in ("norm_obs", "norm_reward"):
        validate.boolean(result[key], f"{where}.{key}")
    for key, (low, high) in LIMITS.items():
        result[key] = validate.number(result[key], f"{where}.{key}")
        if not low <= result[key] <= high:
            raise ValueError(
                f"{where}.{key} must be between {low:g} and {high:g}, got {result[key]!r}."
            )
    return result


def normalized(env: Any, settings: bool | dict[str, Any], gamma: float | None) -> Any:
    """A batch of stable-baselines3 with its observations and rewards normalized, as set."""
    from stable_baselines3.common.vec_env import VecNormalize

    if not isinstance(settings, dict):
        return env
    return VecNormalize(env, gamma=GAMMA if gamma is None else gamma, **settings)


def running(model: Any) -> dict[str, Any]:
    """Statistics of the model's environment by their names; none if nothing is normalized."""
    envs = model.get_vec_normalize_env()
    names = ("obs_rms", "ret_rms")
    found = {name: getattr(envs, name) for name in names if hasattr(envs, name)}
    parts = found.get("obs_rms")
    if isinstance(parts, dict):
        found |= {f"obs_rms/{name}": part for name, part in found.pop("obs_rms").items()}
    return found


def statistics(model: Any) -> dict[str, AnyArray]:
    """Means, variances and counts of the model's environment, named for a checkpoint.

    The running returns are left out: a resumed session starts new episodes.
    """
    return {
        f"normalize/{name}/{part}": np.asarray(getattr(found, part))
        for name, found in running(model).items()
        for part in STORED
    }


def restore_statistics(model: Any, arrays: Mapping[str, AnyArray]) -> None:
    """Restore what `statistics` returned into a new model; raises ValueError or LookupError."""
    wanted = statistics(model)
    extra = sorted(x for x in arrays if x.startswith("normalize/") and x not in wanted)
    if extra:
        raise ValueError(f"{extra[0]} belongs to a run with other settings of env.normalize.")
    for name, found in running(model).items():
        for part in STORED:
            key = f"normalize/{name}/{part}"
            value = validate.array(arrays[key], key, wanted[key].shape)
            if part != "mean" and (value < 0.0).any():
                raise ValueError(f"{key} must not be negative.")
            setattr(found, part, float(value) if part == "count" else value)
