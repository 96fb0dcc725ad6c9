"""The functions of vector_code.py and moves.py in plain numba: slower, with public parts alone."""

import re
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable


@register_jitable
def _less(a, b):  # type: ignore[no-untyped-def]
    return 1.0 if a < b else 0.0


@register_jitable
def _at_most(a, b):  # type: ignore[no-untyped-def]
    return 1.0 if a <= b else 0.0


@register_jitable
def _min(a, b):  # type: ignore[no-untyped-def]
    return b if a > b else a  # a NaN in the first argument survives


@register_jitable
def _max(a, b):  # type: ignore[no-untyped-def]
    return b if a < b else a


_FUNCTIONS = {
    "floor": np.floor, "sqrt": np.sqrt, "abs": abs, "less": _less, "at_most": _at_most,
    "min": _min, "max": _max,
}  # fmt: skip


def straight_line(name: str, lanes: int, text: str, loose: bool = False) -> Any:
    """A function `name(w)` of these statements, lane by lane."""
    lines = re.sub(r"w\[(\d+)\]", lambda m: f"w[{int(m[1]) * lanes} + b]", text).splitlines()
    body = "\n".join(f"        {line}" for line in [*lines, "pass"])
    names = dict(_FUNCTIONS)
    exec(f"def {name}(w):\n    for b in range({lanes}):\n{body}\n", names)
    return njit(error_model="numpy")(names[name])


@cache
def lane_moves(lanes: int, apart: int | None = None) -> tuple[Any, Any, Any]:
    """`take`, `put` and `expect` of moves.py; `expect` does nothing."""
    between = lanes if apart is None else apart

    @register_jitable
    def take(w, at, count, array, first, stride):  # type: ignore[no-untyped-def]
        flat = array.reshape(array.size)
        for k in range(np.int64(count)):
            for b in range(lanes):
                w[np.int64(at) + k * between + b] = flat[np.int64(first) + k * np.int64(stride) + b]

    @register_jitable
    def put(w, at, count, array, first, stride):  # type: ignore[no-untyped-def]
        flat = array.reshape(array.size)
        for k in range(np.int64(count)):
            for b in range(lanes):
                flat[np.int64(first) + k * np.int64(stride) + b] = w[np.int64(at) + k * between + b]

    @register_jitable
    def expect(array, count, first, stride):  # type: ignore[no-untyped-def]
        return

    return take, put, expect


@cache
def row_moves(lanes: int) -> tuple[Any, Any]:
    """`gather` and `scatter` of moves.py."""

    @register_jitable
    def gather(w, at, rows, first):  # type: ignore[no-untyped-def]
        for k in range(rows.shape[1]):
            for b in range(lanes):
                row = min(np.int64(first) + b, rows.shape[0] - 1)
                w[np.int64(at) + k * lanes + b] = rows[row, k]

    @register_jitable
    def scatter(w, at, rows, row):  # type: ignore[no-untyped-def]
        for k in range(rows.shape[1]):
            rows[np.int64(row), k] = w[np.int64(at) + k * lanes]

    return gather, scatter


@cache
def block_moves(lanes: int, columns: int) -> tuple[Any, Any]:
    """`take_rows` and `put_rows` of moves.py."""
    gather, scatter = row_moves(lanes)

    @register_jitable
    def put_rows(w, at, rows, first):  # type: ignore[no-untyped-def]
        for b in range(min(lanes, rows.shape[0] - np.int64(first))):
            scatter(w, np.int64(at) + b, rows, np.int64(first) + b)

    return gather, put_rows
