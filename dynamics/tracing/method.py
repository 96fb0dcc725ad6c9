"""An integrator's part of a program: straight-line functions, and the order of their calls."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from dynamics.formulations.linearized import aid
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.tracing import graphs
from dynamics.tracing.function import Function, traced
from dynamics.tracing.recorded_steps import recorded
from dynamics.tracing.statements import Call, Statements
from dynamics.tracing.traced_arm import TracedArm

LONGEST = 150_000  # operations of a Jacobian that compiles in about a minute

WHOLE_START, WHOLE_STEP = "whole_start", "whole_step"  # functions that a backend compiles itself


class Method(NamedTuple):
    """A method's part of a program."""

    integrator: str
    functions: list[Function]
    routines: Mapping[str, Statements]  # "start" and "step"
    places: Slots  # of one environment
    aid: Any  # the numbers of `Integrator.aid`, None without


def traced_method(
    integrator: str, arm: TracedArm, at: Mapping[str, int], inputs: Sequence[int]
) -> Method:
    """A method's part of the program of an arm; `at` are its slots, `inputs` those of its state.

    Of a method with a Jacobian only that is traced: recorded steps would be too long.
    """
    method = INTEGRATORS[integrator]
    places = Slots(arm.n, at["Q"], at["V"], at["ACC"], at["IMPLICIT"], at["SCRATCH"], at["TAU"])
    if method.aid == "jacobian":
        whole: dict[str, Statements] = {"start": (Call(WHOLE_START),), "step": (Call(WHOLE_STEP),)}
        return Method(integrator, [_jacobian(arm, inputs, at["SCRATCH"])], whole, places, None)
    known = aid(method.aid, arm.chain)
    start = recorded("start", method.start, at["H"], places, known)
    step = recorded("step", method.step, at["H"], places, known)
    routines = {
        name: tuple(map(Call, steps.calls)) for name, steps in (("start", start), ("step", step))
    }
    return Method(integrator, [*start.functions, *step.functions], routines, places, known)


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
