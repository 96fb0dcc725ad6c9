"""Columns of text files as loggers and spreadsheets write them.

Separator and decimal mark are those by which most cells of the last lines are numbers. The header
is the line that holds the named columns, wherever it stands, also behind the mark of a comment;
columns that no line names are counted from 1. A cell may be empty where a channel is sampled less
often than the others. Among the data, comments are left out.
"""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from io import StringIO
from itertools import islice, product, takewhile
from pathlib import Path

import numpy as np

from dynamics.description.validate import shown
from dynamics.measured.columns import require
from dynamics.types import Array

DIALECTS = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), (" ", ","))
SAMPLED = 50  # last lines, which tell the separator and the decimal mark
MOST_BEFORE = 2000  # lines before the data
MOST_UNITS = 2  # lines between the header and the data, such as units
COMMENT = "#%"
CLOCKS = ("%H:%M:%S.%f", "%I:%M:%S.%f %p")
DATES = ("", "%d.%m.%Y ", "%d/%m/%Y ", "%m/%d/%Y ", "%Y/%m/%d ", "%d-%m-%Y ", "%d-%b-%Y ")
FORMS = (None, *map("".join, product(DATES, CLOCKS)))  # None: ISO 8601

Row = tuple[int, list[str]]  # line number from 1, and cells


def read_text(
    path: Path, names: Sequence[str], titles: Sequence[str] = (), second: float = 1.0
) -> dict[str, Array]:
    """Columns of a text file by name, NaN where a cell is empty.

    Parameters
    ----------
    names : titles of columns, or their numbers from 1; the first is time.
    titles : of all columns of a file without a header.
    second : [s] unit in which clock times and dates are returned, from the first on.

    Raises
    ------
    ValueError : for a file that is no text, a missing column, a line of another width and a cell
        that is no number, with the line.
    """
    lines = StringIO(_decoded(path.read_bytes()), newline=None).readlines()
    rows, decimal = _rows(lines)
    places, width, data = _columns(rows, list(names), list(titles), decimal)
    data = [pair for pair in data if not lines[pair[0] - 1].lstrip().startswith(tuple(COMMENT))]
    cells = [_cells(line, row, places, width) for line, row in data]
    columns = zip(*cells, strict=True) if cells else ((),) * len(names)
    found = {}
    for name, texts in zip(names, columns, strict=True):
        if name == names[0] and any(":" in text for text in texts):
            found[name] = _stamps(texts, name, data) / second
        else:
            found[name] = _numbers(texts, name, data, decimal)
    return found


def _decoded(raw: bytes) -> str:
    """Text in UTF-8, UTF-16 or, where it is neither, in the code page 1252 of Windows."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    elif b"\0" in raw[:2]:
        encodings = ["utf-16-le" if raw[1:2] == b"\0" else "utf-16-be"]
    else:
        encodings = ["utf-8-sig", "cp1252"]
    for encoding in encodings:
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise ValueError("is no text in UTF-8, UTF-16 or Windows-1252; export the log as CSV.")


def _rows(lines: list[str]) -> tuple[list[Row], str]:
    """Cells of all lines that are not blank, and the decimal mark."""
    told = re.fullmatch(r'"?sep=(.)"?', lines[0].strip(" \n"), re.IGNORECASE) if lines else None
    dialects = [pair for pair in DIALECTS if not told or pair[0] == told[1]]
    if told and not dialects:
        raise ValueError(
            f"line 1 says that {told[1]!r} separates columns; export the log with one of "
            f"{sorted({pair[0] for pair in DIALECTS})}."
        )
    last = [text for text in lines if text.strip() and text.lstrip()[0] not in COMMENT][-SAMPLED:]
    separator, decimal = max(dialects, key=lambda pair: _share(last, *pair))
    rows = [row for row in _split(lines, separator) if any(row[1])]
    return rows[1:] if told else rows, decimal


def _split(lines: list[str], separator: str) -> Iterator[Row]:
    """Cells of lines, without the mark of a comment."""
    bare = (text.strip(" \n").lstrip(COMMENT + " ") for text in lines)
    reader = csv.reader(bare, delimiter=separator, skipinitialspace=True)
    for row in reader:
        yield reader.line_num, [cell.strip() for cell in row]


def _share(lines: list[str], separator: str, decimal: str) -> tuple[float, int]:
    """Share of the filled cells that are numbers, and their count; none of a single column."""
    rows = [list(filter(None, row)) for _, row in _split(lines, separator)]
    cells = [cell for row in rows if len(row) > 1 for cell in row]
    count = sum(_is_number(_pointed(cell, decimal)) for cell in cells)
    return (count / len(cells) if cells else 0.0), count


def _pointed(cell: str, decimal: str) -> str:
    """A cell with a decimal point; empty for one with a point where a comma is the decimal mark."""
    return cell if decimal == "." else ("" if "." in cell else cell.replace(",", "."))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _columns(
    rows: list[Row], names: list[str], titles: list[str], decimal: str
) -> tuple[list[int], int, list[Row]]:
    """Places of the named columns, the number of columns, and the rows of the data."""
    words = [name for name in names if not name.isdecimal()]
    early = [row for _, row in rows[:MOST_BEFORE]]
    header = titles
    if words and not titles:
        at = next((k for k, row in enumerate(early) if set(words) <= set(row)), None)
        if at is None:
            raise _no_column(early, words, decimal)
        header = _trimmed(early[at])
        places = _places(names, header)
        units = islice(early, at + 1, at + 1 + MOST_UNITS)
        first = (
            at + 1 + sum(1 for _ in takewhile(lambda row: not _values(row, places, decimal), units))
        )
        return places, len(header), rows[first:]
    places = _places(names, header) if header else [int(name) - 1 for name in names]
    whole = (k for k, row in enumerate(early) if _values(row, places, decimal) == len(names))
    first = next(whole, -1)
    if first < 0 or min(places) < 0:
        raise ValueError(
            f"holds no line with numbers in all of the columns {shown(names)}; name the columns by "
            "their titles, or by their numbers from 1."
        )
    if not header:
        _check_first(*rows[first])
    return places, len(header or early[first]), rows[first:]


def _check_first(line: int, row: list[str]) -> None:
    """Refuse a first sample that counts the columns from 0 or 1, as a header may."""
    cells = _trimmed(row)
    if any(cells == [str(k + first) for k in range(len(cells))] for first in (0, 1)):
        raise ValueError(
            f"line {line} holds {shown(row)}, which are numbers of columns or the first sample; "
            "remove the line, or give the titles of all columns if it is a sample."
        )


def _places(names: list[str], header: list[str]) -> list[int]:
    require([name for name in names if name in header or not name.isdecimal()], header)
    places = [header.index(name) if name in header else int(name) - 1 for name in names]
    for name, place in zip(names, places, strict=True):
        if place not in range(len(header)):
            raise ValueError(f"holds no column {name!r}; it holds {shown(header)}.")
        if places.count(place) > 1:
            raise ValueError(f"column {name!r} is named twice, by its title and by its number.")
    return places


def _values(row: list[str], places: Iterable[int], decimal: str) -> int:
    """Number of the cells at places that hold a number or a clock time."""
    cells = [_pointed(row[k], decimal) or row[k] for k in places if k < len(row)]
    return sum(_is_number(cell) or bool(re.search(r"\d:\d\d", cell)) for cell in cells)


def _no_column(early: list[list[str]], words: list[str], decimal: str) -> ValueError:
    """Refusal of columns that no line names, with the line that looks most like a header."""
    counts = [2 * _values(row, range(len(row)), decimal) > len(row) for row in early]
    before = early[: counts.index(True)] if True in counts else early
    if early and not before:
        return ValueError(
            f"holds no column {words[0]!r}: it has no header; name its columns by number, 1 to "
            f"{len(_trimmed(early[0]))}, or give the titles of all of them."
        )
    likely = max(reversed(before), key=lambda row: len(set(words) & set(row)), default=[])
    missing = next(word for word in words if word not in likely)
    return ValueError(f"holds no column {missing!r}; it holds {shown(_trimmed(likely))}.")


def _trimmed(row: list[str]) -> list[str]:
    """A row without the empty cells at its end, which trailing separators make."""
    while row and not row[-1]:
        row = row[:-1]
    return row


def _cells(line: int, row: list[str], places: list[int], width: int) -> list[str]:
    """Named cells of a row of the data."""
    if len(row) < width or any(row[width:]):
        raise ValueError(f"line {line} holds {len(row)} values, but the header names {width}.")
    return [row[k] for k in places]


def _numbers(texts: Sequence[str], name: str, data: list[Row], decimal: str) -> Array:
    values = []
    for text, (line, _) in zip(texts, data, strict=True):
        number = _pointed(text, decimal)
        if text and not _is_number(number):
            mark = " with a decimal comma" if decimal == "," else ""
            raise ValueError(
                f"column {name!r} holds {shown(text)} in line {line}, which is no number{mark}."
            )
        values.append(float(number or math.nan))
    return np.array(values)


def _stamps(texts: Sequence[str], name: str, data: list[Row]) -> Array:
    """Seconds (N,) from the first of clock times, with or without dates.

    Of days and months that may stand in either order, the one that takes less time.
    """
    best: Array | None = None
    for form in FORMS:
        try:
            times = [_stamp(text, form) for text in texts]
            seconds = np.array([(time - times[0]).total_seconds() for time in times])
        except (ValueError, TypeError):
            continue
        if best is None or np.ptp(seconds) < np.ptp(best):
            best = seconds
    if best is not None:
        return best
    unread = (k for k, text in enumerate(texts) if not any(_reads(text, form) for form in FORMS))
    k = next(unread, 0)
    raise ValueError(
        f"column {name!r} holds {shown(texts[k])} in line {data[k][0]}, which is no time such as "
        "2026-01-31 10:00:01.25, 31.01.2026 10:00:01.25 or 10:00:01.25, all in the same form."
    )


def _reads(text: str, form: str | None) -> bool:
    try:
        _stamp(text, form)
    except ValueError:
        return False
    return True


def _stamp(text: str, form: str | None) -> datetime:
    if form is None:
        return datetime.fromisoformat(text)
    text = text.replace(",", ".")
    text = re.sub(r"(:\d\d)(?!:|\d|\.)", r"\1.0", text)  # a second without decimals
    return datetime.strptime(re.sub(r"(\.\d{6})\d+", r"\1", text), form)
