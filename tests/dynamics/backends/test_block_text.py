"""Statements printed for blocks of environments: what they say when they run on arrays."""

from typing import Any

import numpy as np

from dynamics.backends.numba_llvm.block_text import block_lines, filled, listed_lines
from dynamics.tracing.statements import (
    Call,
    Clear,
    Copy,
    Load,
    Prefetch,
    Rows,
    Statement,
    Store,
    Substeps,
    WhereLost,
)

LANES, WIDTH = 4, 12
STATE, FLAG = Rows("STATE", "state", 1, 2), Rows("FLAG", "flags", 0, 1)


def names(**others: Any) -> dict[str, Any]:
    """The names that printed lines use: slots 0 and 1 are A, 2 and 3 are B, 4 is LOST."""

    def moves(lanes: int) -> tuple[Any, Any]:
        def pairs(at: int, count: int, first: int, stride: int) -> Any:
            rows, lane = np.arange(count)[:, None], np.arange(lanes)
            return at + LANES * rows + lane, int(first) + stride * rows + lane

        def take(w: Any, at: int, count: int, array: Any, first: int, stride: int) -> None:
            slots, elements = pairs(at, count, first, stride)
            w[slots] = array.reshape(-1)[elements]

        def put(w: Any, at: int, count: int, array: Any, first: int, stride: int) -> None:
            slots, elements = pairs(at, count, first, stride)
            array.reshape(-1)[elements] = w[slots]

        return take, put

    (take, put), (take_one, put_one) = moves(LANES), moves(1)
    state = np.arange(3.0 * WIDTH).reshape(3, WIDTH)
    return {
        "np": np, "LANES": LANES, "A": 0, "B": 2 * LANES, "LOST": 4 * LANES, "take": take,
        "put": put, "take_one": take_one, "put_one": put_one, "N_STATE": 2, "FIRST_STATE": 1,
        "N_FLAG": 1, "w": np.zeros(5 * LANES), "state": state,
        "flags": np.zeros((1, WIDTH), bool), "width": WIDTH, "column": 4, **others,
    }  # fmt: skip


def run(lines: list[str], given: dict[str, Any]) -> dict[str, Any]:
    exec("\n".join(lines), given)
    return given


def block(*statements: Statement, **others: Any) -> dict[str, Any]:
    return run(block_lines(statements, {}), names(**others))


def test_a_block_is_loaded_copied_and_stored() -> None:
    found = block(Load("A", STATE), Copy("A", "B", STATE), Clear("A"), Store("B", STATE))
    columns = np.arange(3.0 * WIDTH).reshape(3, WIDTH)[1:3, 4:8]
    assert (found["w"][2 * LANES : 4 * LANES] == columns.ravel()).all()
    assert (found["w"][:LANES] == 0.0).all()
    assert (found["state"][1:3, 4:8] == columns).all()


def test_only_lost_lanes_are_restored() -> None:
    """The functions behind run once, for all lanes."""
    w, calls = np.full(5 * LANES, -1.0), []
    w[4 * LANES :] = [0.0, 1.0, 0.0, 0.0]
    lost = WhereLost("LOST", (Load("A", STATE),), (Call("report"),))
    found = block(lost, w=w, report=calls.append)
    assert found["w"][:LANES].tolist() == [-1.0, WIDTH + 5.0, -1.0, -1.0]
    assert len(calls) == 1
    w[4 * LANES :] = 0.0
    block(lost, w=w, report=calls.append)
    assert len(calls) == 1


def test_listed_environments_are_loaded_and_stored_by_their_numbers() -> None:
    """The last one stands in for missing ones, and is stored once."""
    statements = (Load("A", STATE), Clear("LOST"), Call("report"), Store("A", FLAG))
    given = names(rows=[7, 2], first=0, count=2, report=lambda w: None)
    found = run(listed_lines(statements, {}), given)
    assert found["w"][:LANES].tolist() == [WIDTH + 7.0, *3 * [WIDTH + 2.0]]
    assert np.flatnonzero(found["flags"]).tolist() == [2, 7]


def test_routines_are_printed_in_place_and_substeps_repeat_them() -> None:
    routines = {"step": (Call("step_0"), Call("evaluate")), "evaluate": (Call("accelerations"),)}
    lines = block_lines((Call("command"), Substeps((Call("step"),))), routines)
    assert lines == [
        "command(w)", "for _ in range(substeps):", "    step_0(w)", "    accelerations(w)",
    ]  # fmt: skip


def test_rows_are_prefetched_where_they_will_be_written() -> None:
    lines = block_lines((Prefetch(STATE, next=True), Prefetch(Rows("OBS", "obs", 0, 3))), {})
    assert lines == [
        "expect(state, N_STATE, FIRST_STATE * width + column + LANES, width)",
        "expect(obs, N_OBS, (column) * N_OBS, LANES)",
    ]


def test_blocks_are_filled_in_with_their_indent() -> None:
    text = filled("def f():\n    {body}\n    return {}\n", body=["a = 1", "    b"])
    assert text == "def f():\n    a = 1\n        b\n    return {}\n"
