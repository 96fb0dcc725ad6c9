"""Programs as data: their rows, and the statements inside others."""

import pytest

from dynamics.tracing.statements import (
    Call,
    Clear,
    ControlStep,
    Load,
    Noise,
    Rows,
    Store,
    Substeps,
    WhereLost,
    walked,
)

MOTION = Rows("STATE", "state", 0, 6)
LOST = WhereLost("LOST", (Load("Q", MOTION),), (Call("report"),))


def test_statements_inside_others_are_walked_too() -> None:
    repeated = Substeps((Call("step"), Clear("GOOD")))
    assert list(walked((repeated, LOST))) == [
        repeated, Call("step"), Clear("GOOD"), LOST, Load("Q", MOTION), Call("report"),
    ]  # fmt: skip


def test_rows_and_random_numbers_are_found_wherever_they_are() -> None:
    noise = Noise("NOISE", 2, "DRAWN", "ELAPSED")
    flags = Rows("FLAG", "flags", 0, 6)
    entry = ControlStep(step=(LOST,), start=(noise, Store("FLAGS", flags)))
    assert entry.rows == {"STATE": MOTION, "FLAG": flags}
    assert noise in list(entry.statements)


def test_two_groups_of_rows_do_not_share_a_name() -> None:
    others = Rows("STATE", "state", 6, 1)
    entry = ControlStep(step=(LOST,), start=(Load("Q", others),))
    with pytest.raises(ValueError, match="must not share a name"):
        _ = entry.rows
