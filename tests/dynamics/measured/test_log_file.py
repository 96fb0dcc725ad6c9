"""Logs of rigs: units and columns, and files that cannot be used."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.io import savemat

from dynamics.measured.log_file import MOST_BYTES, Columns, Log, read_log
from dynamics.types import Array

COLUMNS = Columns(
    time="t",
    command=("u",),
    encoder=("angle",),
    gauge=("strain",),
    units={"time": "ms", "command": "mN m", "encoder": "0.5", "gauge": "microstrain"},
)
HEADER = "t,angle,unused,u,strain"


def rows(count: int = 12) -> list[str]:
    return [f"{5 * k},{2 * k},x,{-k},{k}" for k in range(count)]


def csv_file(folder: Path, lines: list[str], header: str = HEADER) -> Path:
    path = folder / "log.csv"
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


def test_masked_readings_are_refused_in_place_of_what_they_hide() -> None:
    time, hidden = np.arange(12.0), np.ma.masked_greater(np.ones((12, 1)) * 7.0, 5.0)
    columns = {"command": np.zeros((12, 1)), "encoder": np.zeros((12, 1)), "gauge": hidden}
    with pytest.raises(ValueError, match=r"Log.gauge must have no masked entries, got 12 of 12"):
        Log(time, **columns)
    with pytest.raises(ValueError, match=r"Log.time must have no masked entries, got 1 of 12"):
        Log(np.ma.masked_equal(time, 3.0), **columns | {"gauge": hidden.filled(np.nan)})


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_columns_are_found_by_name_and_given_in_si_units(tmp_path: Path, separator: str) -> None:
    path = csv_file(tmp_path, [row.replace(",", separator) for row in rows()],
                    HEADER.replace(",", separator))  # fmt: skip
    log = read_log(path, COLUMNS)
    k = np.arange(12.0)
    assert_allclose(log.time, 5e-3 * k)
    assert_allclose(log.command, -1e-3 * k[:, None])
    assert_allclose(log.encoder, k[:, None])
    assert_allclose(log.gauge, 1e-6 * k[:, None])


def test_a_mat_file_gives_the_log_of_a_csv_file(tmp_path: Path) -> None:
    k = np.arange(12.0)
    held = {"t": 5.0 * k, "angle": 2 * k[:, None], "u": -k, "strain": k, "other": "text"}
    savemat(tmp_path / "log.mat", held)
    log, other = (
        read_log(path, COLUMNS) for path in (tmp_path / "log.mat", csv_file(tmp_path, rows()))
    )
    for name in ("time", "command", "encoder", "gauge"):
        assert_allclose(getattr(log, name), getattr(other, name))


def test_a_log_may_have_a_gauge_alone_and_begin_later(tmp_path: Path) -> None:
    columns = Columns(time="t", gauge=("strain",), units={"time": "ms"})
    log = read_log(csv_file(tmp_path, rows(20)), columns)
    assert log.command.shape == log.encoder.shape == (20, 0)
    later = log.since(0.05)
    assert_allclose(later.time, 5e-3 * np.arange(10.0, 20.0))
    assert_allclose(later.gauge[:, 0], np.arange(10.0, 20.0))
    for first, sentence in (
        (0.06, "From 0.06 s on the log holds 8 samples, and a fit needs 10; its time runs from 0 "),
        (float("nan"), "first time"),
    ):
        with pytest.raises(ValueError, match=sentence):
            log.since(first)


def edited(number: int, line: str) -> list[str]:
    lines = rows()
    lines[number] = line
    return lines


@pytest.mark.parametrize(
    ("lines", "header", "sentence"),
    [
        (rows(), "t,angle,unused,u,gauge", "holds no column 'strain'; it holds"),
        (rows(), "t,angle,t,u,strain", "column 't' is there 2 times, in one file or"),
        (edited(3, "15,6,x,-3,inf"), HEADER, "column 'strain' is not finite at sample 4 of 12"),
        (edited(3, ",6,x,-3,3"), HEADER, "column 't' is not finite at sample 4 of 12"),
        (edited(3, "15,six,x,-3,3"), HEADER, "column 'angle' holds 'six' in line 5"),
        (edited(3, "15,6,x,-3"), HEADER, "line 5 holds 4 values, but the header names 5"),
        (edited(3, "10,6,x,-3,3"), HEADER, "time must increase, but sample 4 (10)"),
        (edited(3, "9,6,x,-3,3"), HEADER, "time must increase, but sample 4 (9)"),
        (rows(9), HEADER, "must hold 10 to 200000 samples, got 9"),
        ([], "", "holds no column 't'"),
    ],
)
def test_bad_text_files_are_refused_with_the_place(
    tmp_path: Path, lines: list[str], header: str, sentence: str
) -> None:
    with pytest.raises(ValueError) as refusal:
        read_log(csv_file(tmp_path, lines, header), COLUMNS)
    assert str(refusal.value).startswith("log.csv: ")
    assert sentence in str(refusal.value)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"angle": np.arange(11.0)}, "columns have unequal lengths: {'t': 12, 'u': 12, 'angle'"),
        ({"angle": np.ones((12, 2))}, "variable 'angle' must be a vector of numbers"),
        ({"angle": "text"}, "variable 'angle' must be a vector of numbers"),
        ({"angle": 1j * np.ones(12)}, "variable 'angle' must be a vector of numbers"),
    ],
)
def test_bad_mat_variables_are_refused(
    tmp_path: Path, change: dict[str, object], sentence: str
) -> None:
    k = np.arange(12.0)
    savemat(tmp_path / "log.mat", {"t": k, "angle": k, "u": k, "strain": k} | change)
    with pytest.raises(ValueError) as refusal:
        read_log(tmp_path / "log.mat", COLUMNS)
    assert sentence in str(refusal.value)


def test_files_that_are_no_logs_are_refused(tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_bytes(
        b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"x" * 99
    )
    (tmp_path / "short.mat").write_bytes(b"no")
    savemat(tmp_path / "cut.mat", {"t": np.arange(99.0) ** 0.5}, do_compression=True)
    (tmp_path / "cut.mat").write_bytes((tmp_path / "cut.mat").read_bytes()[:-50])
    (tmp_path / "log.csv").write_bytes(b"t,\x81\n1,2\n")
    (tmp_path / "log.xlsx").write_bytes(b"")
    for name, sentence in (
        ("log.mat", "version 7.3"), ("short.mat", "cannot be read as a MAT file"),
        ("cut.mat", "cannot be read as a MAT file"), ("log.csv", "is no text in UTF-8"),
        ("log.xlsx", "must end in one of"), ("none.csv", "cannot be read (No such file"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=sentence[:8]) as refusal:
            read_log(tmp_path / name, COLUMNS)
        assert sentence in str(refusal.value)
    with pytest.raises(ValueError, match=r"^\. must end in one of"):
        read_log(".", COLUMNS)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    with path.open("wb") as file:
        file.truncate(MOST_BYTES + 1)  # takes no room on the disk
    with pytest.raises(ValueError, match="at most"):
        read_log(path, COLUMNS)


@pytest.mark.parametrize(
    ("units", "sentence"),
    [
        ({"time": "min"}, "The unit of time must be one of ['s', 'ms', 'us'] or a factor"),
        ({"encoder": "nan"}, "got 'nan'"),
        ({"encoder": "0"}, "got '0'"),
        ({"gauge 1": "deg"}, "Unknown kinds of units ['gauge 1']"),
    ],
)
def test_units_are_names_or_factors(units: dict[str, str], sentence: str, tmp_path: Path) -> None:
    columns = Columns(time="t", command=("u",), encoder=("angle",), units=units)
    with pytest.raises(ValueError) as refusal:
        read_log(csv_file(tmp_path, rows()), columns)
    assert sentence in str(refusal.value)


def test_columns_are_titles_or_numbers(tmp_path: Path) -> None:
    path = csv_file(tmp_path, rows())
    named = read_log(path, Columns(time="t", encoder=("angle",)))
    numbered = read_log(path, Columns(time=1, encoder=[np.int64(2)]))  # type: ignore[arg-type]
    assert_allclose(numbered.encoder, named.encoder)
    with pytest.raises(ValueError, match=r"Columns.encoder must be a tuple .* write \('angle',\)"):
        Columns(time="t", encoder="angle")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"Columns.gauge must hold titles, or numbers .* got 1.5"):
        Columns(time="t", gauge=(1.5,))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="needs at least one file"):
        read_log([], Columns(time="t"))


T = np.arange(12.0)


@pytest.mark.parametrize(
    ("time", "command", "gauge", "sentence"),
    [
        (T, T, T[:, None], r"Log\.command must have a row for each of the 12 times and a column"),
        (T, T[:, None], T[:10, None], r"Log\.gauge must have .*, got shape \(10, 1\)"),
        (T, T[:, None] * np.nan, T[:, None], r"Log\.command must be finite"),
        (T[::-1], T[:, None], T[:, None], r"Log\.time must increase"),
        (T * np.nan, T[:, None], T[:, None], r"Log\.time"),
    ],
)
def test_arrays_that_are_no_log_are_refused(
    time: Array, command: Array, gauge: Array, sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        Log(time, command, np.zeros((12, 0)), gauge)
