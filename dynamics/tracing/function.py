"""Straight-line functions of the workspace: what a backend compiles."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dynamics.tracing.ssa import Code, from_graph

_TEXT = {
    "+": "{0} + {1}", "-": "{0} - {1}", "*": "{0} * {1}", "/": "{0} / {1}", "neg": "-{0}",
    "floor": "floor({0})", "sqrt": "sqrt({0})", "abs": "abs({0})",
    "min": "min({0}, {1})", "max": "max({0}, {1})", "less": "less({0}, {1})",
    "at_most": "at_most({0}, {1})",
}  # fmt: skip


@dataclass(frozen=True)
class Function:
    """Statements that read slots of the workspace and store values in slots."""

    name: str
    code: Code = field(default_factory=Code)
    stores: Mapping[int, Sequence[tuple[int, int]]] = field(default_factory=dict)
    # statement -> (slot, value) that are stored right after it
    loose: bool = False  # does little with each of many values

    @property
    def lines(self) -> list[str]:
        """Readable text, a statement a line: `x3 = w[2]`, `x7 = x3 * x5`, `w[9] = x7`."""
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
    """A function that reads a graph's inputs from these slots and stores its output in others.

    `output` is the first of adjoining slots, or the slot of every element.
    """
    code, values = from_graph(graph, inputs)
    slots = [output + i for i in range(len(values))] if isinstance(output, int) else output
    return Function(name, code, _earliest(code, zip(slots, values, strict=True)), loose)


def written(name: str, code: Code, values: Mapping[int, int]) -> Function:
    """A function of code that was written by hand; `values` are the numbers to store, by slot."""
    return Function(name, code, _earliest(code, values.items()))


def _earliest(code: Code, stores: Iterable[tuple[int, int]]) -> dict[int, list[tuple[int, int]]]:
    """Each store after the value's own statement, or after the last load of the slot.

    A value that waited for the end of a long function would be spilled until then.
    """
    loads = {int(op[5:]): v for v, (op, _) in enumerate(code.statements) if op.startswith("load")}
    result: dict[int, list[tuple[int, int]]] = {}
    for slot, value in stores:
        result.setdefault(max(value, loads.get(slot, 0)), []).append((slot, value))
    return result


def finite_check(state: Iterable[int], total: int, good: int) -> Function:
    """`check(w)`: increments `good` if this and every earlier state was finite.

    `total` is the slot of a sum of zeros, which anything that is not finite makes NaN for good.
    """
    code = Code()
    value, zero = code.load(total), code.constant(0.0)
    for slot in state:
        value = code.emit("+", value, code.emit("*", zero, code.load(slot)))
    finite = code.emit("at_most", code.emit("abs", value), zero)
    return written("check", code, {total: value, good: code.emit("+", code.load(good), finite)})
