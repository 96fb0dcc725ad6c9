"""Derivatives of straight-line functions: a function in, a function out.

Each slot of the workspace has a mirror, `mirror` slots further on. In a tangent function it holds
the derivative of the slot along a direction; in an adjoint function it holds the slot's cotangent,
the derivative of a later number by the slot.

Rules where a derivative jumps: a minimum and a maximum follow the operand that they return, the
first if both are equal; an absolute value and a square root have derivative zero at zero;
comparisons have derivative zero. A floor in the equations of an arm or an environment rounds a
reading to counts ("rounded"), and passes derivatives as if it did not round; a floor within an
elementary function counts turns, and has derivative zero.
"""

from collections.abc import Collection, Iterable
from dataclasses import replace

from dynamics.tracing.function import Function, written
from dynamics.tracing.ssa import Code

# operations whose derivative needs the values of their operands
_NONLINEAR = ("*", "/", "sqrt", "abs", "min", "max")
_CONSTANT = ("floor", "less", "at_most")  # between their jumps


def loads(function: Function) -> set[int]:
    """Slots that a function reads."""
    return {int(op[5:]) for op, _ in function.code.statements if op.startswith("load")}


def stores(function: Function) -> dict[int, int]:
    """Numbers of the values that a function writes, by slot."""
    return {slot: value for pairs in function.stores.values() for slot, value in pairs}


def adjoint(function: Function, mirror: int, passive: Collection[int] = ()) -> Function:
    """Function that takes cotangents back through `function`.

    It reads the slots that `function` read, as they were then, and the cotangents of what that
    stored; it adds to the cotangents of what that read. `passive` slots have no cotangents.
    """
    statements, results = function.code.statements, stores(function)
    results = {slot: value for slot, value in results.items() if slot not in passive}
    active = _active(function, passive)
    reached, needed = _reached(function, results.values(), active)
    code = Code()
    place = _replayed(function.code, needed, code)
    bars: dict[int, int] = {}

    def add(value: int, bar: int, sign: str = "+") -> None:
        if not active[value]:
            return
        if value in bars:
            bars[value] = code.emit(sign, bars[value], bar)
        else:
            bars[value] = bar if sign == "+" else code.emit("neg", bar)

    for slot, value in results.items():
        add(value, code.load(mirror + slot))
    found = {}
    for v in sorted(reached, reverse=True):
        op, args = statements[v]
        bar = bars[v]
        if op.startswith("load"):
            found[int(op[5:])] = bar
        elif op in "+-":
            add(args[0], bar)
            add(args[1], bar, op)
        elif op in ("neg", "rounded"):
            add(args[0], bar, "-" if op == "neg" else "+")
        else:
            for k, argument in enumerate(args):
                if active[argument]:
                    factor, sign = _slope(code, op, [place.get(a) for a in args], k)
                    add(argument, code.emit("*", bar, factor), sign)
    for slot, bar in found.items():
        if slot not in results:
            found[slot] = code.emit("+", code.load(mirror + slot), bar)
    for slot in results:
        if slot not in found:
            found[slot] = code.constant(0.0)
    outputs = {mirror + slot: value for slot, value in found.items()}
    return _named(function, "adjoint", code, outputs)


def tangent(function: Function, mirror: int, passive: Collection[int] = ()) -> Function:
    """Function that does as `function`, and takes derivatives along a direction with it."""
    statements, results = function.code.statements, stores(function)
    active = _active(function, passive)
    code = Code()
    place = _replayed(function.code, range(len(statements)), code)
    dots: dict[int, int] = {}
    for v, (op, args) in enumerate(statements):
        if not active[v]:
            continue
        if op.startswith("load"):
            dots[v] = code.load(mirror + int(op[5:]))
        elif op in "+-":
            dots[v] = _signed(code, op, *(dots.get(a) for a in args))
        elif op in ("neg", "rounded"):
            dots[v] = _signed(code, "-" if op == "neg" else "+", None, dots[args[0]])
        else:
            total = None
            for k, argument in enumerate(args):
                if argument in dots:
                    factor, sign = _slope(code, op, [place[a] for a in args], k)
                    total = _signed(code, sign, total, code.emit("*", dots[argument], factor))
            dots[v] = code.constant(0.0) if total is None else total
    outputs = {slot: place[value] for slot, value in results.items()}
    for slot, value in results.items():
        if slot not in passive:
            outputs[mirror + slot] = dots[value] if value in dots else code.constant(0.0)
    return _named(function, "tangent", code, outputs)


def _signed(code: Code, sign: str, a: int | None, b: int | None) -> int:
    """a + b or a - b, where one of the two may be missing."""
    if a is None:
        assert b is not None
        return b if sign == "+" else code.emit("neg", b)
    return a if b is None else code.emit(sign, a, b)


def _named(function: Function, kind: str, code: Code, outputs: dict[int, int]) -> Function:
    return replace(written(f"{function.name}_{kind}", code, outputs), loose=function.loose)


def _active(function: Function, passive: Collection[int]) -> list[bool]:
    """True of each value that depends smoothly on a slot that is not passive."""
    active: list[bool] = []
    for op, args in function.code.statements:
        if op.startswith("load"):
            active.append(int(op[5:]) not in passive)
        else:
            active.append(op not in _CONSTANT and any(active[a] for a in args))
    return active


def _reached(
    function: Function, results: Iterable[int], active: list[bool]
) -> tuple[set[int], set[int]]:
    """Active values on which the results depend, and values whose numbers their partials need."""
    statements = function.code.statements
    reached = {v for v in results if active[v]}
    needed: set[int] = set()
    for v in range(len(statements) - 1, -1, -1):
        op, args = statements[v]
        if v in reached:
            reached.update(a for a in args if active[a])
            if op == "*":
                needed.update(b for a, b in zip(args, args[::-1], strict=True) if active[a])
            elif op in _NONLINEAR:
                needed.update(args)
        if v in needed:
            needed.update(args)
    return reached, needed


def _replayed(source: Code, values: Iterable[int], code: Code) -> dict[int, int]:
    """Emit values of other code again; their new numbers."""
    place: dict[int, int] = {}
    for v in sorted(values):
        op, args = source.statements[v]
        place[v] = code.emit(op, *(place[a] for a in args))
        if v in source.names:
            code.names[place[v]] = source.names[v]
    return place


def _slope(code: Code, op: str, x: list[int | None], k: int) -> tuple[int, str]:
    """Factor and sign of the partial derivative of a nonlinear operation by its operand k.

    `x` are the operands; one that the derivative does not need may be missing.
    """
    if op == "*":
        return _needed(x[1 - k]), "+"
    emit, zero, one = code.emit, code.constant(0.0), code.constant(1.0)
    a, b = _needed(x[0]), _needed(x[-1])
    if op == "/":
        inverse = emit("/", one, b)
        return (inverse, "+") if k == 0 else (emit("*", emit("/", a, b), inverse), "-")
    if op == "abs":
        return emit("-", emit("less", zero, a), emit("less", a, zero)), "+"
    if op == "sqrt":
        root = emit("sqrt", a)
        positive = emit("less", zero, root)
        return emit("/", positive, emit("+", emit("+", root, root), emit("-", one, positive))), "+"
    if op in ("min", "max"):
        first = emit("at_most", *((a, b) if op == "min" else (b, a)))
        return (first if k == 0 else emit("-", one, first)), "+"
    raise TypeError(f"No derivative of operation {op!r}; add it to tracing/adjoint.py.")


def _needed(number: int | None) -> int:
    assert number is not None
    return number
