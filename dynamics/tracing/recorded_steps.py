"""Steps of an integrator as straight-line functions.

A method runs once on a workspace of symbols. Its operations between two evaluations of the
accelerations become one straight-line function. Like the arm's own straight-line code, it compiles
several times faster than loops.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from dynamics.integrators.slots import Slots
from dynamics.tracing.function import Function, traced

EVALUATE = "evaluate"  # name of the call that evaluates the accelerations


class Recorded(NamedTuple):
    """Functions of a step, and the order in which to call them."""

    functions: list[Function]
    calls: list[str]  # names of functions, and EVALUATE


def recorded(name: str, method: Callable[..., None], h: int, at: Slots, aid: Any) -> Recorded:
    """Record a start or step of a method.

    `h` is the slot of the step length; the functions are called `name`_0, `name`_1 and so on.
    """
    record = _Record(name, h)

    def evaluate(w: _Record) -> None:
        w.end_stretch()
        w.calls.append(EVALUATE)

    method(record, record[h], evaluate, at, aid)
    record.end_stretch()
    return Recorded(record.functions, record.calls)


class _Record:
    """A one-lane workspace of symbols that records reads and writes; slot `h` is never written."""

    def __init__(self, name: str, h: int) -> None:
        import casadi as ca

        self.name, self.h = name, {h: ca.SX.sym("h")}
        self.functions: list[Function] = []
        self.calls: list[str] = []
        self._begin()

    def _begin(self) -> None:
        self.read: dict[int, Any] = dict(self.h)
        self.written: dict[int, Any] = {}

    def __getitem__(self, slot: int) -> Any:
        import casadi as ca

        if slot in self.written:
            return self.written[slot]
        return self.read.setdefault(slot, ca.SX.sym(f"w{slot}"))

    def __setitem__(self, slot: int, value: Any) -> None:
        self.written[slot] = value

    def end_stretch(self) -> None:
        """Make a function of the values written since the last evaluation."""
        import casadi as ca

        if self.written:
            name = f"{self.name}_{len(self.functions)}"
            outputs = [ca.cse(ca.vertcat(*self.written.values()))]
            graph = ca.Function(name, list(self.read.values()), outputs)
            function = traced(name, graph, list(self.read), list(self.written), loose=True)
            self.functions.append(function)
            self.calls.append(name)
        self._begin()
