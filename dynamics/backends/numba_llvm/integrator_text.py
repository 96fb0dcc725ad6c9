"""Integrators in a generated module: their straight-line functions, and the calls of these."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from numba.extending import register_jitable

from dynamics.formulations.linearized import aid
from dynamics.integrators.exponential import FrozenModes
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.tracing import graphs
from dynamics.tracing.function import Function, traced
from dynamics.tracing.recorded_steps import EVALUATE, Recorded, recorded
from dynamics.tracing.traced_arm import TracedArm

LONGEST = 150_000  # operations of a Jacobian that compiles in about a minute

for _method in INTEGRATORS.values():
    for _helper in _method.helpers:
        register_jitable(_helper)

# A method with a Jacobian is compiled as Python loops: recorded, it would be too long.
_LOOPS = """
METHOD = INTEGRATORS[{0!r}]
start_method, step_method = compiled(METHOD.start), compiled(METHOD.step)


@compiled
def evaluate(w):
    #evaluate
"""
_PLACES = "AT = Slots(N, Q, V, ACC, IMPLICIT, SCRATCH, TAU, LANES)"
_CALL = "{0}_method(w, w[H], evaluate, AT, AID)"
_MODES = "AID = FrozenModes(np.array({0!r}), np.array({1!r}))"
_STEPS = "AID = np.array({0!r})"
_PREPARE = "prepare_method = exact(INTEGRATORS[{0!r}].prepare)"
_PREPARED = "prepare_method(w, w[H], AT, AID)"


class MethodText(NamedTuple):
    """A method's part of a module."""

    functions: list[Function]  # straight-line ones
    setting: list[str]  # text before the entry points
    marks: Mapping[str, Sequence[str]]  # lines that marks of the entry points stand for


def method_text(
    integrator: str, arm: TracedArm, at: Mapping[str, int], inputs: Sequence[int]
) -> MethodText:
    """A method's part of the module of an arm; `at` are its slots, `inputs` those of its state."""
    method = INTEGRATORS[integrator]
    if method.aid == "jacobian":
        calls = {f"#{k}": [_CALL.format(k)] for k in ("start", "step")}
        jacobian = _jacobian(arm, inputs, at["SCRATCH"])
        return MethodText(
            [jacobian], [_PLACES, _LOOPS.format(integrator)], {"#prepare": [], **calls}
        )
    known = aid(method.aid, arm.chain)
    places = Slots(arm.n, at["Q"], at["V"], at["ACC"], at["IMPLICIT"], at["SCRATCH"], at["TAU"])
    start = recorded("start", method.start, at["H"], places, known)
    step = recorded("step", method.step, at["H"], places, known)
    functions = [*start.functions, *step.functions]
    marks = {"#prepare": [], "#start": _lines(start), "#step": _lines(step)}
    if known is None:
        return MethodText(functions, [], marks)
    if isinstance(known, FrozenModes):
        constants = _MODES.format(known.squares.tolist(), known.decays.tolist())
    else:
        constants = _STEPS.format(known.tolist()).replace("inf", "np.inf")
    setting = [_PLACES, constants, _PREPARE.format(integrator)]
    return MethodText(functions, setting, marks | {"#prepare": [_PREPARED]})


def _lines(steps: Recorded) -> list[str]:
    return ["#evaluate" if name == EVALUATE else f"{name}(w)" for name in steps.calls]


def _jacobian(arm: TracedArm, inputs: Sequence[int], scratch: int) -> Function:
    """AID, which writes the Jacobian of the accelerations."""
    graph = graphs.state_jacobian(arm)
    count = graph.n_instructions()
    if count > LONGEST:
        raise ValueError(
            f"The Jacobian of the accelerations takes {count} operations for this arm, too long "
            f"to compile (at most {LONGEST}); take integrator 'midpoint', implicit without one."
        )
    return traced("AID", graph, inputs, scratch)
