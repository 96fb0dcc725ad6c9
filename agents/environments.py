"""Environments as a file may describe them: an id of this package, and keywords that are data."""

import difflib
import inspect
import json
import math
from typing import Any

import gymnasium as gym

from agents.sentences import shown
from flexarm_env.core import Core

OF_THE_BATCH = {"self", "task", "n_env", "single", "max_steps"}  # set by the id and the batch
KEYWORDS = sorted(
    set(inspect.signature(Core.__init__).parameters) - OF_THE_BATCH | {"max_episode_steps"}
)

# Beyond these a step takes hours, and compiled code hears no signal.
LARGEST = {"control_dt": 10.0, "substeps": 100_000, "max_episode_steps": 10**9, "threads": 1024}
# Errors by which Gymnasium, an environment or a learner refuses what it is given.
REFUSALS: tuple[type[Exception], ...] = (TypeError, ValueError, ArithmeticError, AssertionError)
REFUSALS += (MemoryError, RuntimeError, ImportError, gym.error.Error)


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
        value, largest = kwargs[key], LARGEST.get(key, math.inf)
        if isinstance(value, int | float) and value > largest:
            raise ValueError(f"{key} in {where} must be at most {largest:_}, got {shown(value)}.")
    try:
        json.dumps(kwargs, allow_nan=False)
    except (TypeError, ValueError):
        raise ValueError(
            f"{where} must hold finite numbers, text, lists and tables only, got {shown(kwargs)}."
        ) from None
    return kwargs
