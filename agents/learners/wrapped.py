"""Models whose observations or actions wrappers changed in training, and no longer do.

They are known by what stable-baselines3's models hold; other controllers pass.
"""

from typing import Any

import gymnasium as gym
import numpy as np


def lost_normalization(model: Any) -> bool:
    """True if an on-policy model was trained with a VecNormalize that is not there.

    Such algorithms keep the latest original observations for it; off-policy ones do in any case.
    """
    original = getattr(model, "_last_original_obs", None)
    if original is None or not hasattr(model, "rollout_buffer"):
        return False
    return model.get_vec_normalize_env() is None


def other_actions(model: Any) -> str | None:
    """Limits or kind of a model's actions where they are not those of an arm, [-1, 1]."""
    space = getattr(model, "action_space", None)
    if not isinstance(space, gym.spaces.Box):
        return str(space) if isinstance(space, gym.Space) else None
    if np.all((space.low == -1.0) & (space.high == 1.0)):
        return None
    return f"[{space.low.min():g}, {space.high.max():g}]"


def refuse_wrapped(controller: Any) -> None:
    """Refuse a model whose observations or actions are not those of the environment.

    Raises
    ------
    ValueError : with the remedy.
    """
    if lost_normalization(controller):
        raise ValueError(
            "The model was trained with VecNormalize, whose statistics its zip does not hold; load "
            "it with env=VecNormalize.load(file, envs) and give export_policy(model, {}) of "
            "agents.learners.export, which normalizes."
        )
    normalizing = getattr(controller, "get_vec_normalize_env", lambda: None)()
    if normalizing is not None and normalizing.norm_obs:
        raise ValueError(
            "The model sees observations through its VecNormalize, got the environment's own; "
            "evaluate export_policy(model, {}) of agents.learners.export, which normalizes them."
        )
    seen = getattr(controller, "observation_space", None)
    if isinstance(seen, gym.spaces.Dict) and "privileged" in seen.spaces:
        raise ValueError(
            "The model's critic sees the true state, which is not among the observations; evaluate "
            "export_policy(model, {}) of agents.learners.export, the actor without the critic."
        )
    actions = other_actions(controller)
    if actions is not None:
        raise ValueError(
            f"The model acts in {actions}, but an arm takes actions in [-1, 1]; give an object "
            "whose predict converts them as the wrapper of the training did."
        )
