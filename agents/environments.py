"""Environments as a file may describe them: an id of this package, and keywords that are data."""

import inspect
import json
from typing import Any

import gymnasium as gym

from dynamics.description import validate
from flexarm_env.core import Core

OF_THE_BATCH = {"self", "task", "n_env", "single", "max_steps"}  # set by the id and the batch
KEYWORDS = sorted(
    set(inspect.signature(Core.__init__).parameters) - OF_THE_BATCH | {"max_episode_steps"}
)
# Errors by which Gymnasium, an environment or a learner refuses what it is given.
REFUSALS: tuple[type[Exception], ...] = (TypeError, ValueError, ArithmeticError, AssertionError)
REFUSALS += (MemoryError, RuntimeError, ImportError, gym.error.Error)


def check_keywords(kwargs: Any, where: str) -> dict[str, Any]:
    """Keywords of an environment from a file or a command line, or a ValueError.

    All else that `gymnasium.make_vec` takes, such as wrappers, comes from a program only.
    """
    keywords: dict[str, Any] = validate.mapping(kwargs, where, KEYWORDS)
    try:
        json.dumps(keywords, allow_nan=False)
    except (TypeError, ValueError, RecursionError):
        raise ValueError(
            f"{where} must hold finite numbers, text, lists and tables only, got "
            f"{validate.shown(kwargs)}."
        ) from None
    return keywords
