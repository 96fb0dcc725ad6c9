"""A user's own controller: imported by its name, made for an environment, checked at every call."""

import importlib
from collections.abc import Callable
from traceback import format_exception_only
from typing import Any

import numpy as np

from agents.environments import look_in_present_folder
from agents.learners.wrapped import refuse_wrapped
from agents.policy import Controller
from dynamics.description import validate
from dynamics.types import AnyArray

CALL = "it is called as predict(observation, state, episode_start) and returns action, state"
FAILURES = (Exception, SystemExit)  # whatever a stranger's code raises, but for an interrupt


class UsersControllerError(ValueError):
    """A user's controller that cannot be ranked; the message names it in one sentence."""


def users_class(name: str) -> Callable[[Any], Any]:
    """The class that a user names on the command line as mymodule:MyController."""
    module, _, attribute = name.partition(":")
    here = look_in_present_folder()
    try:
        if not module or module.startswith("."):
            raise ImportError("its module needs a name that does not start with a dot")
        found: Callable[[Any], Any] = getattr(importlib.import_module(module), attribute)
    except FAILURES as error:
        raise UsersControllerError(
            f"--controllers {name} cannot be imported: {reason(error)}. Write module:Class, the "
            f"module without .py and in {here} or installed."
        ) from error
    return found


def users_controller(name: str, env: Any, seed: int) -> Controller:
    """A user's controller, after one call on the first observation of an episode."""
    made = users_class(name)
    try:
        subject = made(env)
        refuse_wrapped(subject)
    except FAILURES as error:
        raise UsersControllerError(
            f"--controllers {name} cannot be made: {reason(error)}; it is called with the "
            "environment."
        ) from error
    checked = Checked(name, subject, env.action_space.shape[1:])
    observation, _ = env.reset(seed=[seed])
    checked.predict(observation, None, np.ones(1, dtype=bool))
    return checked


class Checked:
    """A user's controller whose actions are finite numbers, a row per environment, or an error."""

    def __init__(self, name: str, subject: Any, shape: tuple[int, ...]) -> None:
        self.name = name
        self.subject = subject
        self.shape = shape  # of the action of one environment

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions of the controller, and its next state."""
        try:
            action, state = self.subject.predict(observation, state, episode_start)
            action = np.asarray(action)
        except FAILURES as error:
            raise UsersControllerError(
                f"--controllers {self.name} failed in predict: {reason(error)}; {CALL}."
            ) from error
        return self.numbers(action, (len(observation), *self.shape)), state

    def numbers(self, action: AnyArray, shape: tuple[int, ...]) -> AnyArray:
        """The action, if it has this shape and its numbers are finite in float32."""
        if action.shape != shape:
            raise UsersControllerError(
                f"--controllers {self.name} gave actions of shape {action.shape}, expected "
                f"{shape}: a row per environment; {CALL}."
            )
        if action.dtype.kind not in "biuf":
            given = validate.shown(action.ravel()[0].item())
            raise UsersControllerError(
                f"--controllers {self.name} gave {given} as an action, expected numbers; {CALL}."
            )
        with np.errstate(over="ignore"):
            finite = np.isfinite(action.astype(np.float32))
        if not finite.all():
            raise UsersControllerError(
                f"--controllers {self.name} gave the action {action[~finite][0]}, which is not a "
                f"finite number in float32; {CALL}."
            )
        return action


def reason(error: BaseException) -> str:
    """The last line that a traceback of the error would have, without a full stop."""
    return format_exception_only(error)[-1].strip().rstrip(".")
