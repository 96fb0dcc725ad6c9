"""The log keeps every row despite incomplete lines, foreign bytes and a full disk."""

import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.run_folder.callback import EpisodeStatistics
from agents.run_folder.log import append_row, read_rows, repair_log

ROWS = [{"session": 0, "steps": n, "return": 0.5 * n, "settled": None} for n in (10, 20, 30)]
TEXT = "".join(json.dumps(row) + "\n" for row in ROWS).encode()
NO_ROWS = [
    b"5",
    b"null",
    b"{}",
    b"[]",
    b'"text"',
    b"\xff\xfe\x00\x81",
    b'{"session": 0, "steps": 10, "re',
    b'{"session": 0, "steps": "10"}',
    b'{"session": 0, "steps": 1.5}',
    b'{"session": true, "steps": 1}',
    b'{"session": 0}',
    b'{"session": 0, "steps": -1}',
    b'{"session": 1000000000000000, "steps": 1}',
    b'{"session": 0, "steps": 1, "return": "high"}',
    b'{"session": 0, "steps": 1, "return": NaN}',
    b'{"session": 0, "steps": 1, "return": 1e999}',
    b'{"session": 0, "steps": 1, "return": [1]}',
    b'{"session": 0, "steps": 1' + b"0" * 400 + b"}",
    b'{"session": 0, "steps": 1' + b"0" * 5000 + b"}",
    b"[" * 100_000,
]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "metrics.jsonl"
    for row in ROWS:
        append_row(path, row)
    return path


def test_appended_rows_are_read_back(path: Path) -> None:
    assert path.read_bytes() == TEXT
    assert read_rows(path) == (ROWS, 0)
    assert read_rows(path.with_name("none")) == ([], 0)


@pytest.mark.parametrize("line", NO_ROWS)
def test_a_line_that_is_not_a_row_is_skipped_and_counted(path: Path, line: bytes) -> None:
    path.write_bytes(line + b"\n" + TEXT + line + b"\n")
    assert read_rows(path) == (ROWS, 2)


@pytest.mark.parametrize("fragment", NO_ROWS)
def test_a_fragment_at_the_end_is_cut_off(path: Path, fragment: bytes) -> None:
    path.write_bytes(TEXT + fragment)
    assert f"cut off an incomplete last line of {len(fragment)} bytes" in repair_log(path)
    append_row(path, ROWS[0])
    assert read_rows(path) == ([*ROWS, ROWS[0]], 0)


def test_a_complete_last_row_gets_its_line_end(path: Path) -> None:
    path.write_bytes(TEXT[:-1])
    assert repair_log(path) == ""
    assert path.read_bytes() == TEXT


@pytest.mark.parametrize("content", [b"", TEXT, TEXT + b"5\n"])
def test_a_log_of_complete_lines_is_unchanged(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    assert repair_log(path) == ""
    assert path.read_bytes() == content
    assert repair_log(path.with_name("none")) == ""


@pytest.mark.parametrize("fits", [0, 1, 30])
def test_a_row_that_does_not_fit_on_the_disk_is_removed(
    path: Path, fits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, free = os.write, [fits]

    def nearly_full(descriptor: int, data: bytes) -> int:
        if not free[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = write(descriptor, data[: free[0]])
        free[0] -= written
        return written

    monkeypatch.setattr(os, "write", nearly_full)
    with pytest.raises(OSError, match="No space left"):
        append_row(path, ROWS[0])
    assert path.read_bytes() == TEXT


def test_a_row_that_is_written_in_pieces_is_complete(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write: Any = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:7]))
    append_row(path, ROWS[0])
    assert read_rows(path) == ([*ROWS, ROWS[0]], 0)


def test_means_are_those_of_the_episodes_that_ended() -> None:
    """One that fails is not settled; running returns begin anew."""
    statistics = EpisodeStatistics(2, before=5)
    assert set(statistics.means().values()) == {None}
    end = {"tip_error": 0.1, "settled": True, "TimeLimit.truncated": True}
    statistics.add(np.array([1.0, 2.0]), np.array([False, True]), [{}, end])
    statistics.add(
        np.array([3.0, 5.0]), np.array([True, True]),
        [{"tip_error": 0.3, "settled": True}, end | {"settled": False}],
    )  # fmt: skip
    expected = {
        "return": 11.0 / 3.0,
        "tip_error": 0.5 / 3.0,
        "settled": 1.0 / 3.0,
        "failed": 1.0 / 3.0,
    }
    assert statistics.means() == pytest.approx(expected)
    assert statistics.episodes == 8
