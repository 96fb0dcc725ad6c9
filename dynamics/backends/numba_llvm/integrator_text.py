"""The part of an integrator in a generated module beside its straight-line functions."""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

from numba.extending import register_jitable

from dynamics.integrators.exponential import FrozenModes
from dynamics.integrators.table import INTEGRATORS
from dynamics.runtime.jit import exact
from dynamics.tracing.method import WHOLE_START, WHOLE_STEP, Method

for _method in INTEGRATORS.values():
    for _helper in _method.helpers:
        register_jitable(_helper)


@cache
def preparation(integrator: str) -> Any:
    """The method's `prepare`, which numba compiles once for all programs."""
    return exact(INTEGRATORS[integrator].prepare)


# A method with a Jacobian is compiled as Python loops: recorded, it would be too long.
_LOOPS = """
METHOD = INTEGRATORS[{0!r}]
start_method, step_method = compiled(METHOD.start), compiled(METHOD.step)


@compiled
def evaluate(w):
{1}


@compiled
def {2}(w):
    start_method(w, w[H], evaluate, AT, AID)


@compiled
def {3}(w):
    step_method(w, w[H], evaluate, AT, AID)

"""
_PLACES = "AT = Slots(N, Q, V, ACC, IMPLICIT, SCRATCH, TAU, LANES)"
_MODES = "AID = FrozenModes(np.array({0!r}), np.array({1!r}))"
_STEPS = "AID = np.array({0!r})"
_PREPARE = "prepare_method = preparation({0!r})"
_PREPARED = "prepare_method(w, w[H], AT, AID)"


class Setting(NamedTuple):
    """Text of a method before the entry points, and where the step length becomes known."""

    text: list[str]
    prepare: list[str]


def setting(method: Method, evaluation: Sequence[str]) -> Setting:
    """Text of a method; `evaluation` are the lines that evaluate the accelerations."""
    if INTEGRATORS[method.integrator].aid == "jacobian":
        lines = "\n".join(f"    {line}" for line in evaluation)
        return Setting(
            [_PLACES, _LOOPS.format(method.integrator, lines, WHOLE_START, WHOLE_STEP)], []
        )
    if method.aid is None:
        return Setting([], [])
    if isinstance(method.aid, FrozenModes):
        constants = _MODES.format(method.aid.squares.tolist(), method.aid.decays.tolist())
    else:
        constants = _STEPS.format(method.aid.tolist()).replace("inf", "np.inf")
    return Setting([_PLACES, constants, _PREPARE.format(method.integrator)], [_PREPARED])
