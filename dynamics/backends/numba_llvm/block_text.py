"""Statements of a program as lines of a generated module, for blocks of environments."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

from dynamics.tracing.statements import (
    ROW_PER_ENVIRONMENT,
    Call,
    Clear,
    Copy,
    Load,
    Noise,
    Pop,
    Prefetch,
    Push,
    Rows,
    Statement,
    Statements,
    Store,
    Substeps,
    WhereLost,
)

Routines = Mapping[str, Statements]


def filled(template: str, **blocks: Sequence[str]) -> str:
    """Text with a block of lines, indented, in place of each line that is a name in braces."""
    lines = []
    for line in template.splitlines():
        name = line.strip()
        if name.startswith("{") and name[1:-1] in blocks:
            indent = line[: line.index("{")]
            lines += [indent + other for other in blocks[name[1:-1]]]
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def indented(lines: Iterable[str]) -> list[str]:
    """Lines, one level further in."""
    return [f"    {line}" for line in lines]


def block_lines(statements: Iterable[Statement], routines: Routines) -> list[str]:
    """Lines for LANES environments side by side, from the one at `column` on."""
    return [line for x in statements for line in _block(x, routines)]


def _block(statement: Statement, routines: Routines) -> list[str]:
    match statement:
        case Call(name) if name in routines:
            return block_lines(routines[name], routines)
        case Call(name):
            return [f"{name}(w)"]
        case Clear(slots, count):
            lanes = "LANES" if count == 1 else f"np.uint64({count}) * LANES"
            return [f"for b in range({lanes}):", f"    w[{slots} + b] = 0.0"]
        case Push(_, _, count):
            return [*_of_stack(statement, "put"), f"top += np.uint64({count})"]
        case Pop(_, _, count):
            return [f"top -= np.uint64({count})", *_of_stack(statement, "take")]
        case Noise():
            return ["noise(w)"]
        case Substeps(body):
            return ["for _ in range(substeps):", *indented(block_lines(body, routines))]
        case Copy(source, target, rows):
            return [f"put(w, {source}, N_{rows.name}, w, {target}, LANES)"]
        case Prefetch(rows, following):
            at = _first(rows, "column + LANES" if following else "column")
            return [f"expect({rows.array}, N_{rows.name}, {at})"]
        case Load(slots, rows) if rows.array in ROW_PER_ENVIRONMENT:
            return [f"take_{rows.array}(w, {slots}, {rows.array}, column)"]
        case Store(slots, rows) if rows.array in ROW_PER_ENVIRONMENT:
            return [f"put_{rows.array}(w, {slots}, {rows.array}, column)"]
        case Load(slots, rows):
            return [_moved("take", slots, rows, "column")]
        case Store(slots, rows):
            return [_moved("put", slots, rows, "column")]
        case WhereLost(flag=flag, restored=restored, then=then):
            return _where_lost(flag, restored, block_lines(then, routines))
    raise TypeError(f"The LLVM backend starts episodes between steps, so not by {statement}.")


def _of_stack(statement: Push | Pop, move: str) -> list[str]:
    """Moves between slots and the rows of the stack from `top` on."""
    slots = f"{statement.slots} + np.uint64({statement.skipped}) * LANES"
    rows = "stack, top * width + column, width"
    return [f"{move}(w, {slots}, np.uint64({statement.count}), {rows})"]


def _moved(move: str, slots: str, rows: Rows, environment: str) -> str:
    return f"{move}(w, {slots}, N_{rows.name}, {rows.array}, {_first(rows, environment)})"


def _first(rows: Rows, environment: str) -> str:
    """Place of an environment in the first row, in the flat array, and from there to the next."""
    if rows.array in ROW_PER_ENVIRONMENT:
        return f"({environment}) * N_{rows.name}, LANES"
    return f"FIRST_{rows.name} * width + " * bool(rows.first) + f"{environment}, width"


def _where_lost(flag: str, restored: Iterable[Load], then: Iterable[str]) -> list[str]:
    """Restore some lanes; call for all of them."""
    loads = [line for x in restored for line in _lane(x, "column + b")]
    lines = [f"if w[{flag} + b] > 0.0:", *indented(loads)]
    return [
        "lost = 0",
        "for b in range(LANES):",
        f"    lost += w[{flag} + b] > 0.0",
        "if lost > 0:",
        *indented(["for b in range(LANES):", *indented(lines), *then]),
    ]


def listed_lines(statements: Iterable[Statement], routines: Routines) -> list[str]:
    """Lines for environments that `rows` lists, up to LANES of them from the entry `first` on.

    Lanes beyond the last entry repeat it, and store nothing.
    """
    lines = []
    for kind, group in groupby(statements, _lane_by_lane):
        moves = list(group)
        if not kind:
            lines += block_lines(moves, routines)
            continue
        lanes = "min(LANES, count - first)" if kind == "store" else "LANES"
        at = "first + b" if kind == "store" else "min(first + b, count - np.uint64(1))"
        body = [line for x in moves for line in _lane(x)]
        lines += [f"for b in range({lanes}):", f"    i = np.uint64(rows[{at}])", *indented(body)]
    return lines


def _lane_by_lane(statement: Statement) -> str:
    """Kind of a statement that moves numbers of one lane at a time; empty for others."""
    if isinstance(statement, Store):
        return "store"
    return "load" if isinstance(statement, Load | Copy | Clear) else ""


def _lane(statement: Statement, environment: str = "i") -> list[str]:
    match statement:
        case Clear(slots, 1):
            return [f"w[{slots} + b] = 0.0"]
        case Clear(slots, count):
            return [f"for k in range({count}):", f"    w[{slots} + k * LANES + b] = 0.0"]
        case Copy(source, target, rows):
            return [f"put_one(w, {source} + b, N_{rows.name}, w, {target} + b, LANES)"]
        case Load(slots, rows):
            return [_moved("take_one", f"{slots} + b", rows, environment)]
        case Store(slots, rows) if rows.array in ROW_PER_ENVIRONMENT:
            return [f"scatter(w, {slots} + b, {rows.array}, {environment})"]
        case Store(slots, rows):
            return [_moved("put_one", f"{slots} + b", rows, environment)]
    raise TypeError(f"No lines of one lane for {statement}.")
