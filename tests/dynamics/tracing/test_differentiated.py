"""Derivatives of a small program, run statement by statement and known in closed form."""

from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from dynamics.integrators.slots import Slots
from dynamics.tracing.assembly import Program
from dynamics.tracing.differentiated import differentiated
from dynamics.tracing.function import traced
from dynamics.tracing.method import Method
from dynamics.tracing.statements import (
    Call,
    Clear,
    ControlStep,
    Copy,
    Derivatives,
    Load,
    Pop,
    Push,
    Rows,
    Statement,
    Store,
    Substeps,
)
from tests.dynamics.tracing.test_adjoint import run

SUBSTEPS = 3
STATE, OUT = Rows("STATE", "state", 0, 2), Rows("OUT", "info", 0, 1)


def program() -> Program:
    """y := a b, then a := a + b and b := 2 b in every substep, then y := y + a^2; stores all three.

    Only the first call needs the a and b that substeps overwrite.
    """
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    functions = [
        traced("first", ca.Function("f", [x], [x[0] * x[1]]), [0], 2),
        traced("turn", ca.Function("f", [x], [ca.vertcat(x[0] + x[1], 2.0 * x[1])]), [0], 0),
        traced("last", ca.Function("f", [x, y], [y + x[0] ** 2]), [0, 2], 2),
    ]
    step = (
        Load("X", STATE), Clear("Y"), Call("first"), Substeps((Call("turn"),)), Call("last"),
        Copy("Y", "Z", OUT), Store("X", STATE), Store("Z", OUT),
    )  # fmt: skip
    sizes = {"X": 2, "Y": 1, "Z": 1}
    return Program(
        title="small", sizes=sizes, at={"X": 0, "Y": 2, "Z": 3}, slots=4,
        accelerations=functions[0], further=functions[1:], renewal=[],
        method=Method("rk4", [], {}, Slots(1, 0, 0, 0, 0, 0), None), routines={},
        entry=ControlStep(step=step, start=()), shared=[],
    )  # fmt: skip


def played(made: Program, statements: Iterable[Statement], w: Any, arrays: dict[str, Any]) -> Any:
    """The workspace after statements; `arrays` are written in place."""
    functions, stack = {f.name: f for f in made.functions}, arrays["stack"]
    for x in statements:
        match x:
            case Call(name):
                w = run(functions[name], w)
            case Clear(slots, count):
                w[made.at[slots] : made.at[slots] + count] = 0.0
            case Load(slots, rows):
                w[made.at[slots] : made.at[slots] + rows.count] = arrays[rows.array]
            case Store(slots, rows):
                arrays[rows.array][:] = w[made.at[slots] : made.at[slots] + rows.count]
            case Push(slots, skipped, count):
                first = made.at[slots] + skipped
                stack += w[first : first + count].tolist()
            case Pop(slots, skipped, count):
                first = made.at[slots] + skipped
                w[first : first + count] = stack[-count:]
                del stack[-count:]
            case Substeps(body):
                for _ in range(SUBSTEPS):
                    w = played(made, body, w, arrays)
    return w


def test_cotangents_and_derivatives_are_those_in_closed_form() -> None:
    """With a, b: a becomes a + 7 b, b becomes 8 b, and y becomes a b + (a + 7 b)^2."""
    made = differentiated(program())
    entry = made.entry
    assert isinstance(entry, Derivatives)
    a, b = before = np.array([0.7, 1.3])
    end = a + 7.0 * b
    slopes = np.array([[1.0, 7.0], [0.0, 8.0], [b + 2.0 * end, a + 14.0 * end]])
    arrays: dict[str, Any] = {"state": before.copy(), "info": np.zeros(1), "stack": []}
    played(made, entry.record, np.zeros(made.slots), arrays)
    np.testing.assert_allclose(arrays["state"], [end, 8.0 * b], rtol=1e-14)
    assert len(arrays["stack"]) == entry.fixed + SUBSTEPS * entry.per_substep

    bars = np.array([0.3, -0.2, 0.5])
    arrays |= {"state": before, "state_mirror": bars[:2].copy(), "info_mirror": bars[2:].copy()}
    played(made, entry.pull_back, np.full(made.slots, np.nan), arrays)
    np.testing.assert_allclose(arrays["state_mirror"], bars @ slopes, rtol=1e-13)
    assert not arrays["stack"]

    along = np.array([0.4, 0.1])
    arrays |= {"state": before.copy(), "state_mirror": along.copy(), "info_mirror": np.zeros(1)}
    played(made, entry.push_forward, np.zeros(made.slots), arrays)
    forward = np.concatenate([arrays["state_mirror"], arrays["info_mirror"]])
    np.testing.assert_allclose(forward, slopes @ along, rtol=1e-13)
