"""Training log: one JSON row per line, appended atomically and repaired after a kill."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agents.files import sync

Row = dict[str, Any]
COUNTS = ("session", "steps")  # in every row
LARGEST_COUNT = 10**12
LARGEST = 1e300  # bound on the magnitude of numbers in a row


def append_row(path: Path, row: Mapping[str, Any]) -> None:
    """Append a row and flush it to the disk; an incomplete row is removed again."""
    extend(path, json.dumps(row, allow_nan=False).encode() + b"\n")


def extend(path: Path, rest: bytes) -> None:
    """Append bytes to a file, all or none."""
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        length = os.fstat(descriptor).st_size
        try:
            while rest:
                rest = rest[os.write(descriptor, rest) :]
            os.fsync(descriptor)
        except BaseException:
            os.ftruncate(descriptor, length)
            raise
    finally:
        os.close(descriptor)


def read_rows(path: Path) -> tuple[list[Row], int]:
    """Rows of the log, and the number of lines that are not rows."""
    content = path.read_bytes() if path.exists() else b""
    lines = [line for line in content.split(b"\n") if line]
    rows = [row for row in map(parsed, lines) if row is not None]
    return rows, len(lines) - len(rows)


def parsed(line: bytes) -> Row | None:
    """Row in a line; None if the line is not a row."""
    try:
        row = json.loads(line.decode())
    except (ValueError, RecursionError):
        return None
    if not isinstance(row, dict) or not all(is_count(row.get(name)) for name in COUNTS):
        return None
    return row if all(is_value(value) for value in row.values()) else None


def is_count(value: Any) -> bool:
    """True if the value is an int from 0 to LARGEST_COUNT."""
    return type(value) is int and 0 <= value <= LARGEST_COUNT


def is_value(value: Any) -> bool:
    """True if a row may have the value: a finite number, or None in place of an infinite one."""
    return value is None or (type(value) in (int, float) and abs(value) < LARGEST)


def repair_log(path: Path) -> str:
    """Terminate the last line: a complete row gets its line end, a fragment is cut off.

    Returns a sentence about the fragment, or an empty text.
    """
    content = path.read_bytes() if path.exists() else b""
    end = content.rfind(b"\n") + 1
    fragment = content[end:]
    if not fragment:
        return ""
    if parsed(fragment) is not None:
        extend(path, b"\n")
        return ""
    os.truncate(path, end)
    sync(path)
    return f"{path}: cut off an incomplete last line of {len(fragment)} bytes."
