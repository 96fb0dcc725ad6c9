"""Straight-line functions on the workspace, which a backend compiles."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dynamics.tracing.graph_to_ssa import from_graph
from dynamics.tracing.ssa import Code

_TEXT = {
    "+": "{0} + {1}", "-": "{0} - {1}", "*": "{0} * {1}", "/": "{0} / {1}", "neg": "-{0}",
    "floor": "floor({0})", "rounded": "floor({0})", "sqrt": "sqrt({0})", "abs": "abs({0})",
    "min": "min({0}, {1})", "max": "max({0}, {1})", "less": "less({0}, {1})",
    "at_most": "at_most({0}, {1})",
}  # fmt: skip


@dataclass(frozen=True)
class Function:
    """Straight-line code, and the stores of its values into slots of the workspace."""

    name: str
    code: Code = field(default_factory=Code)
    stores: Mapping[int, Sequence[tuple[int, int]]] = field(default_factory=dict)
    # statement -> (slot, value) pairs stored right after it
    loose: bool = False  # few operations on each of many values

    @property
    def lines(self) -> list[str]:
        """Readable text, one statement per line: `x3 = w[2]`, `x7 = x3 * x5`, `w[9] = x7`."""
        code, lines = self.code, []
        for v, (op, args) in enumerate(code.statements):
            if op.startswith("load"):
                lines.append(f"x{v} = w[{op[5:]}]")
            elif v not in code.names:
                lines.append(f"x{v} = {_TEXT[op].format(*(code.text(a) for a in args))}")
            lines += [f"w[{slot}] = {code.text(value)}" for slot, value in self.stores.get(v, ())]
        return lines


def traced(
    name: str, graph: Any, inputs: Sequence[int], output: int | Sequence[int], loose: bool = False
) -> Function:
    """Function of a CasADi graph with one output.

    `inputs` are the first slots of the graph's inputs. `output` is the first of consecutive slots
    for the output, or a list of slots, one per element.
    """
    code, values = from_graph(graph, inputs)
    slots = [output + i for i in range(len(values))] if isinstance(output, int) else output
    return Function(name, code, _earliest(code, zip(slots, values, strict=True)), loose)


def written(name: str, code: Code, values: Mapping[int, int]) -> Function:
    """Function of hand-written code; `values` maps slots to the numbers of the values to store."""
    return Function(name, code, _earliest(code, values.items()))


def _earliest(code: Code, stores: Iterable[tuple[int, int]]) -> dict[int, list[tuple[int, int]]]:
    """Place each store right after its value's statement, or after the last load of its slot.

    Stores at the end of a long function would keep their values live, and spilled, until then.
    """
    loads = {int(op[5:]): v for v, (op, _) in enumerate(code.statements) if op.startswith("load")}
    result: dict[int, list[tuple[int, int]]] = {}
    for slot, value in stores:
        result.setdefault(max(value, loads.get(slot, 0)), []).append((slot, value))
    return result


def finite_check(state: Iterable[int], total: int, good: int) -> Function:
    """`check(w)`: increments slot `good` if this and every earlier state was finite.

    Slot `total` sums zero times the state, so a non-finite value turns it into NaN permanently.
    """
    code = Code()
    value, zero = code.load(total), code.constant(0.0)
    for slot in state:
        value = code.emit("+", value, code.emit("*", zero, code.load(slot)))
    finite = code.emit("at_most", code.emit("abs", value), zero)
    return written("check", code, {total: value, good: code.emit("+", code.load(good), finite)})
