"""Names of environments, keywords that files and command lines may give, and their refusals."""

import inspect
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

from dynamics.description import validate
from flexarm_env import IDS
from flexarm_env.core import Core
from flexarm_env.hardware.sensors import load_hardware
from flexarm_env.task.observations import observation_mode
from flexarm_env.task.tasks import find_task

SET_BY_ID = {"self", "task", "n_env", "single", "max_steps"}  # set by the id and the batch
KEYWORDS = sorted(
    set(inspect.signature(Core.__init__).parameters) - SET_BY_ID | {"max_episode_steps"}
)
ENDLESS = -1  # max_episode_steps of episodes without a time limit
# Errors with which Gymnasium, an environment or a learner refuses its arguments.
REFUSALS: tuple[type[Exception], ...] = (TypeError, ValueError, ArithmeticError, AssertionError)
REFUSALS += (MemoryError, RuntimeError, ImportError, gym.error.Error)


def title(env_id: str) -> str:
    """Short name of a task: its id without the package."""
    return env_id.removeprefix("FlexArm/")


def look_in_present_folder() -> Path:
    """Find a user's modules in the present folder too; `flexarm` is a script of another one."""
    here = Path.cwd()
    if str(here) not in sys.path:
        sys.path.append(str(here))
    return here


def check_keywords(kwargs: Any, where: str) -> dict[str, Any]:
    """Return an environment's keywords from a file or a command line, or raise ValueError.

    Other keywords of `gymnasium.make_vec`, such as wrappers, are refused.
    """
    keywords: dict[str, Any] = validate.mapping(kwargs, where, KEYWORDS)
    if keywords.get("max_episode_steps") == ENDLESS:
        raise ValueError(
            f"{where}.max_episode_steps must be a number of control steps, got {ENDLESS}: episodes "
            "without an end cannot be evaluated."
        )
    try:
        json.dumps(keywords, allow_nan=False)
    except (TypeError, ValueError, RecursionError):
        raise ValueError(
            f"{where} must hold finite numbers, text, lists and tables only, got "
            f"{validate.shown(kwargs)}."
        ) from None
    return keywords


def observation_kind(about: Mapping[str, Any]) -> str | None:
    """Kind of the observations of a policy's origin, and whether they show a path.

    None for an id that is not of this package. A ValueError for keywords that are not allowed.
    """
    env_id = about.get("env_id")
    if env_id not in IDS:
        return None
    own = check_keywords(about.get("env_kwargs", {}), "about.env_kwargs")
    keywords = IDS[env_id]["kwargs"] | own
    kind = observation_mode(
        keywords.get("obs"), load_hardware(keywords.get("hardware")) is not None
    )
    return f"{kind} with a path" if find_task(keywords["task"]).moving else kind
