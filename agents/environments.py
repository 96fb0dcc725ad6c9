"""Environments as a file may describe them: an id of this package, and keywords that are data."""

import difflib
import inspect
import json
from typing import Any

import gymnasium as gym

from agents.sentences import shown
from flexarm_env.core import Core

OF_THE_BATCH = {"self", "task", "n_env", "single", "max_steps"}  # set by the id and the batch
KEYWORDS = sorted(
    set(inspect.signature(Core.__init__).parameters) - OF_THE_BATCH | {"max_episode_steps"}
)

# Errors by which Gymnasium, an environment or a learner refuses what it is given.
REFUSALS: tuple[type[Exception], ...] = (TypeError, ValueError, ArithmeticError, AssertionError)
REFUSALS += (MemoryError, RecursionError, ImportError, gym.error.Error)


def check_keywords(kwargs: Any, where: str) -> dict[str, Any]:
    """Keywords of an environment from a file or a command line, or a ValueError.

    Whatever else `gymnasium.make_vec` takes, such as wrappers, comes from a program only.
    """
    if not isinstance(kwargs, dict):
        raise ValueError(f"{where} must be a table such as {{obs: sensors}}, got {shown(kwargs)}.")
    for key in kwargs:
        if key not in KEYWORDS:
            near = difflib.get_close_matches(str(key), KEYWORDS, n=1)
            remedy = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(KEYWORDS)}."
            raise ValueError(f"unknown key {shown(key)} in {where}; {remedy}")
    try:
        json.dumps(kwargs, allow_nan=False)
    except (TypeError, ValueError):
        raise ValueError(
            f"{where} must hold finite numbers, text, lists and tables only, got {shown(kwargs)}."
        ) from None
    return kwargs
