"""Vector code that no expression graph writes: lanes between a workspace and other arrays."""

import platform
import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features

from dynamics.backends.numba_llvm import vector_code
from dynamics.backends.numba_llvm.program import cached_module
from dynamics.backends.numba_llvm.stepper_entries import LANES

MOVES = """
from dynamics.backends.numba_llvm.moves import lane_moves
from dynamics.runtime.jit import outermost
take, put, expect = lane_moves({lanes}, {apart})

@outermost
def there_and_back(source, w, numbers, flags):
    take(w, {apart}, 2, source, 3, 20)
    put(w, {apart}, 2, numbers, 1, 18)
    put(w, {apart}, 2, flags, 1, 18)
"""


@pytest.mark.parametrize(("lanes", "apart"), [(1, 1), (1, 7), (LANES, LANES)])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_lanes_move_between_workspace_and_arrays(
    lanes: int, apart: int, dtype: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Just those elements, converted; whatever is not zero is true."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path))
    text = MOVES.format(lanes=lanes, apart=apart)
    module = cached_module(f"moves_{lanes}_{apart}_{dtype}", lambda: text)
    source = np.arange(3.0 * LANES) % 5.0 - 3.0
    source[4] = np.nan
    w, numbers, flags = np.zeros(3 * apart + lanes, dtype), np.full(40, 7.0), np.zeros(40, np.bool_)

    module.there_and_back(source, w, numbers, flags)

    expected, stored, marked = np.zeros_like(w), np.full(40, 7.0), np.zeros(40, np.bool_)
    for k in range(2):
        moved = source[3 + 20 * k :][:lanes]
        expected[apart * (1 + k) :][:lanes] = moved
        stored[1 + 18 * k :][:lanes] = moved
        marked[1 + 18 * k :][:lanes] = moved != 0.0
    np.testing.assert_array_equal(w, expected)
    np.testing.assert_array_equal(numbers, stored)
    np.testing.assert_array_equal(flags, marked)


ROWS = """
from dynamics.backends.numba_llvm.moves import row_moves
from dynamics.runtime.jit import outermost
gather, scatter = row_moves({lanes})

@outermost
def there_and_back(source, first, w, lane, target, row):
    gather(w, {lanes}, source, first)
    scatter(w, {lanes} + lane, target, row)
"""


@pytest.mark.parametrize("lanes", [1, LANES])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_rows_move_between_workspace_and_arrays(
    lanes: int,
    dtype: str,
    order: Literal["C", "F"],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A row per lane, the last for all that are missing; one lane back into one row."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path))
    module = cached_module(f"rows_{lanes}_{dtype}", lambda: ROWS.format(lanes=lanes))
    source = np.array(np.arange(3.0 * (LANES + 2)).reshape(-1, 3), order=order)
    w, target = np.zeros(5 * lanes, dtype), np.full((4, 3), 7.0, order=order)

    module.there_and_back(source, 5, w, lanes - 1, target, 2)

    expected = source[np.minimum(5 + np.arange(lanes), LANES + 1)]
    np.testing.assert_array_equal(w[lanes : 4 * lanes].reshape(3, lanes), expected.T)
    np.testing.assert_array_equal(w[[*range(lanes), *range(4 * lanes, 5 * lanes)]], 0.0)
    np.testing.assert_array_equal(target[2], expected[-1])
    np.testing.assert_array_equal(target[[0, 1, 3]], 7.0)


BLOCKS = """
import numpy as np
from dynamics.backends.numba_llvm.{file} import block_moves
from dynamics.runtime.jit import outermost
take_rows, put_rows = block_moves({lanes}, {columns})

@outermost
def there_and_back(source, first, w, target, row):
    first, row = np.uint64(first), np.uint64(row)
    take_rows(w, {lanes}, source, first)
    put_rows(w, {lanes}, target, row)
"""


@pytest.mark.parametrize("lanes", [1, LANES, 2 * LANES])
@pytest.mark.parametrize("columns", [1, 2, 3, 16, 23])
@pytest.mark.parametrize(
    ("held", "given"),
    [("float64", "float32"), ("float32", "float64"), ("float64", "float64")],
)
@pytest.mark.parametrize("file", ["moves", "plain_code"])
@pytest.mark.parametrize("missing", [0, 1])
def test_blocks_of_rows_are_transposed(
    lanes: int,
    columns: int,
    held: str,
    given: str,
    file: str,
    missing: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Just those rows, a lane each, wherever the array begins; the last stands for missing ones."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path))
    text = BLOCKS.format(lanes=lanes, columns=columns, file=file)
    module = cached_module(f"blocks_{lanes}_{columns}_{held}_{given}_{file}", lambda: text)
    memory = np.arange((lanes + 4) * columns + 1.0).astype(given)
    source = memory[1:].reshape(-1, columns)
    w, target = np.zeros((columns + 2) * lanes, held), np.full((lanes + 2, columns), -7.0, given)
    count = lanes - missing  # of the rows from 3 and 1 on

    module.there_and_back(source[: 3 + count], 3, w, target[: 1 + count], 1)

    expected = source[np.minimum(3 + np.arange(lanes), 2 + count)]
    np.testing.assert_array_equal(w[lanes:-lanes].reshape(columns, lanes), expected.T)
    np.testing.assert_array_equal(w[[*range(lanes), *range(-lanes, 0)]], 0.0)
    np.testing.assert_array_equal(target[1 : 1 + count], expected[:count])
    np.testing.assert_array_equal(np.delete(target, np.s_[1 : 1 + count], axis=0), -7.0)


LONG = """
from dynamics.backends.numba_llvm.vector_code import straight_line
from dynamics.runtime.jit import outermost
LANES = {lanes}
{inner}

@outermost
def long(w):
    inner(w)
"""


def definition(name: str, lines: list[str], loose: bool = False) -> str:
    text = "\n".join([*lines, ""])
    return f"{name} = straight_line({name!r}, LANES, {text!r}, loose={loose})"


@pytest.mark.parametrize(("lanes", "register"), [(1, 32), (LANES, 32), (LANES, 64)])
@pytest.mark.parametrize("piece", [1, 7, 1000])
def test_pieces_of_a_function_are_the_function(
    lanes: int, register: int, piece: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values pass from piece to piece, through places that others had before; names may recur."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path))
    monkeypatch.setattr(vector_code, "PIECE", piece)
    monkeypatch.setattr(vector_code, "_register", lambda: register)
    rng = np.random.default_rng(0)
    lines = ["x0 = w[0]", "x1 = w[1]", "s = x0 * x1"]
    for k in range(2, 60):
        i, j = rng.integers(max(0, k - 25), k, 2)
        lines += [f"x{k} = {rng.uniform():.3f} * x{i} + x{j}"] + ["s = s + x0"] * (k % 9 == 0)
    lines += ["w[2] = x59 + s", "w[0] = x58"]
    text = LONG.format(lanes=lanes, inner=definition("inner", lines, loose=True))
    module = cached_module(f"long_{lanes}_{register}_{piece}", lambda: text)
    w = rng.uniform(size=3 * lanes)
    rows = w.reshape(3, lanes).copy()

    module.long(w)

    exec("\n".join(lines), {"w": rows})
    np.testing.assert_allclose(w, rows.ravel(), rtol=1e-13)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads its instructions")
@pytest.mark.parametrize("piece", [300, 1000])
@pytest.mark.parametrize(
    ("lanes", "numbers", "laid_out"),
    [(LANES, 40, True), (LANES, 400, True), (1, 400, True), (1, 40, False)],
)
def test_what_waits_on_the_stack_begins_with_a_cache_line_and_has_a_register_of_its_own(
    lanes: int, numbers: int, laid_out: bool, piece: int,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Or half of all processes would be slow, by chance, and all instructions a byte longer.

    But a few numbers of one lane are not worth it.
    """
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path))
    monkeypatch.setattr(vector_code, "PIECE", piece)
    lines = [f"x{k} = w[{k}]" for k in range(numbers)]
    lines += [f"w[{k}] = x{k} * x{numbers - 1 - k}" for k in range(numbers)]
    text = LONG.format(lanes=lanes, inner=definition("inner", lines))
    module = cached_module(f"waiting_{lanes}_{numbers}_{piece}", lambda: text)
    module.long(np.zeros(numbers * lanes))

    (code,) = module.long.inspect_asm().values()
    assert ("andq\t$-64, %rsp" in code) == laid_out
    assert not laid_out or code.count("(%rsp)") < 40 < code.count("(%rbx)")  # few: the entry's own


@pytest.mark.parametrize(
    ("told", "size"),
    [
        ("+avx2,+avx512f", 64),
        ("+avx2,-avx512f", 32),
        ("", 32),
        (None, 64 if get_host_cpu_features().get("avx512f") else 32),
    ],
)
def test_a_register_is_that_of_the_processor_compiled_for(
    told: str | None, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vector_code.config, "CPU_FEATURES", told)
    assert vector_code._register.__wrapped__() == size


@pytest.mark.parametrize(
    ("numbers", "loose", "register", "rounds"),
    [
        (40, False, 32, 1),
        (40, True, 32, 4),
        (700, False, 32, 4),
        (40, True, 64, 1),
        (700, False, 64, 1),
        (700, True, 64, 2),
    ],
)
def test_long_and_loose_functions_go_through_their_lanes_in_rounds(
    numbers: int, loose: bool, register: int, rounds: int,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Each multiplies a share of the lanes, as LLVM is told."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path))
    monkeypatch.setattr(vector_code, "_register", lambda: register)
    lines = [f"x{k} = w[{k}]" for k in range(numbers)]
    lines += [f"w[{k}] = x{k} * x{numbers - 1 - k}" for k in range(numbers)]
    text = LONG.format(lanes=LANES, inner=definition("inner", lines, loose))
    module = cached_module(f"rounds_{numbers}_{loose}_{register}", lambda: text)
    module.long(np.ones(numbers * LANES))

    (code,) = module.long.inspect_llvm().values()
    widths = re.findall(r"fmul [a-z ]*<(\d+) x double>", code)
    assert set(widths) == {str(LANES // rounds)}


AHEAD = """
from dynamics.backends.numba_llvm.moves import lane_moves
from dynamics.runtime.jit import outermost
take, put, expect = lane_moves({lanes})

@outermost
def ahead(numbers, first):
    expect(numbers, 1, first, 0)
"""


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads its instructions")
@pytest.mark.parametrize(
    ("lanes", "dtype", "lines"), [(1, "float64", 1), (LANES, "float64", 2), (LANES, "bool", 1)]
)
def test_what_is_expected_is_fetched_line_by_line_and_stays_as_it_is(
    lanes: int, dtype: str, lines: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also beyond an array's end, where there is nothing to fetch."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path))
    module = cached_module(f"ahead_{lanes}_{dtype}", lambda: AHEAD.format(lanes=lanes))
    numbers = np.ones(LANES, dtype)
    for first in (0, LANES, 10**12):
        module.ahead(numbers, first)
    assert numbers.all()
    (code,) = module.ahead.inspect_asm().values()
    assert code.count("prefetch") == lines
