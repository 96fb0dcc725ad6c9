"""Source of a method in a generated module: functions, and the lines that call them.

Most methods run once on a workspace of symbols: what they do between two evaluations becomes one
straight-line function, as the arm's own code is, which compiles several times faster than their
loops. A method with a Jacobian is compiled as it stands, because it has more to do than an
evaluation.
"""

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from dynamics.integrators import INTEGRATORS
from dynamics.lowering import render_function

if TYPE_CHECKING:
    from dynamics.model import Model

LONGEST = 150_000  # operations of a Jacobian that compiles in about a minute
_LOOPS = """
METHOD = INTEGRATORS[{0!r}]
start_method, step_method = compiled(METHOD.start), compiled(METHOD.step)


@compiled
def evaluate(w):
    #evaluate
"""
_CALL = "{0}_method(w, w[H], evaluate, LANES, N, Q, V, ACC, IMPLICIT, SCRATCH, AID)"
_PREPARE = """
AID = np.array({1!r})
prepare_method = compiled(INTEGRATORS[{0!r}].prepare)
"""
_PREPARED = "prepare_method(w, w[H], LANES, N, SCRATCH, AID)"

Marks = Mapping[str, Sequence[str]]


def method_code(
    integrator: str, n: int, at: Mapping[str, int], modes: Any = None
) -> tuple[list[str], Marks]:
    """Text of the functions for n coordinates and the slots `at`, and the lines that call them.

    H holds the step's length; #evaluate stands for the lines that find accelerations. `modes` are
    the aid of a method that freezes them.
    """
    method = INTEGRATORS[integrator]
    if method.aid == "jacobian":
        calls = {f"#{k}": [_CALL.format(k)] for k in ("start", "step")}
        return [_LOOPS.format(integrator)], {"#prepare": [], **calls}
    start = _recorded("start", method.start, n, at, modes)
    step = _recorded("step", method.step, n, at, modes)
    functions = [*start.functions, *step.functions]
    calls = {"#prepare": [], "#start": start.calls, "#step": step.calls}
    if method.aid == "modes":
        functions.append(_PREPARE.format(integrator, modes.tolist()))
        calls["#prepare"] = [_PREPARED]
    return functions, calls


def jacobian_code(model: "Model", inputs: Sequence[int], scratch: int) -> str:
    """Text of AID, which finds the Jacobian of the accelerations.

    Raises
    ------
    ValueError : for a Jacobian that is too long to compile.
    """
    count = model.jacobian_graph.n_instructions()
    if count > LONGEST:
        raise ValueError(
            f"The Jacobian of the accelerations takes {count} operations for this arm, too long "
            f"to compile (at most {LONGEST}); take integrator 'midpoint', implicit without one."
        )
    return render_function("AID", model.jacobian_graph, inputs, scratch)


def _recorded(
    name: str, function: Callable[..., None], n: int, at: Mapping[str, int], modes: Any
) -> "_Record":
    """One straight-line function per stretch between evaluations, and the lines that call them."""
    record = _Record(name, at["H"])

    def evaluate(w: _Record) -> None:
        w.end_stretch()
        w.calls.append("#evaluate")

    places = (at[x] for x in ("Q", "V", "ACC", "IMPLICIT", "SCRATCH"))
    function(record, record[at["H"]], evaluate, 1, n, *places, modes)
    record.end_stretch()
    return record


class _Record:
    """A workspace of one lane whose numbers are symbols; the slot H is never written."""

    dtype = SimpleNamespace(type=float)

    def __init__(self, name: str, h: int) -> None:
        import casadi as ca

        self.name, self.h = name, {h: ca.SX.sym("h")}
        self.functions: list[str] = []
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
        """Make a function of what has been written since the last evaluation."""
        import casadi as ca

        if self.written:
            name = f"{self.name}_{len(self.functions)}"
            outputs = [ca.cse(ca.vertcat(*self.written.values()))]
            graph = ca.Function(name, list(self.read.values()), outputs)
            text = render_function(name, graph, list(self.read), list(self.written), loose=True)
            self.functions.append(text)
            self.calls.append(f"{name}(w)")
        self._begin()
