"""Logs as loggers, spreadsheets, MATLAB and Simulink write them: the same signals from each."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.io import savemat

from dynamics.measured.log_file import Columns, Log, read_log

K = np.arange(12.0)
COLUMNS = Columns(time="t", command=("u",), encoder=("angle",), gauge=("strain",))
NUMBERED = Columns(time="1", command=("2",), encoder=("3",), gauge=("4",))
HEADER = "t;u;angle;strain"
TITLES = ("t", "u", "angle", "strain")


def lines(separator: str = ";", decimal: str = ".", header: str | None = HEADER) -> list[str]:
    """Time in steps of 5 ms, and three signals."""
    rows = [f"{0.005 * k:.3f};{-0.5 * k};{k + 0.25};{1e-6 * k:.1e}" for k in K]
    rows = rows if header is None else [header, *rows]
    return [row.replace(".", decimal).replace(";", separator) for row in rows]


def check(log: Log) -> None:
    assert_allclose(log.time, 0.005 * K, atol=1e-9)
    assert_allclose(log.command[:, 0], -0.5 * K)
    assert_allclose(log.encoder[:, 0], K + 0.25)
    assert_allclose(log.gauge[:, 0], 1e-6 * K)


def written(folder: Path, rows: list[str], name: str = "log.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes("\r\n".join([*rows, ""]).encode(encoding))
    return path


PREAMBLE = ["Logger 3, serial 42", "# Rate: 200 Hz", "Started;2026-01-31", "Channels;4", ""]
VARIANTS: dict[str, list[str]] = {
    "decimal comma": lines(decimal=","),
    "decimal comma and tabs": lines("\t", ","),
    "decimal comma and blanks": lines("  ", ","),
    "units below the header": [HEADER, "s;N m;rad;-", *lines(header=None)],
    "units and types below the header": [HEADER, "s;N m;rad;-", "double;;;", *lines(header=None)],
    "preamble": PREAMBLE + lines(),
    "preamble and decimal comma": PREAMBLE + lines(decimal=","),
    "commented header": ["# " + lines(",")[0], *lines(",")[1:]],
    "comments among the data": [*lines()[:5], "# 0.016;9;9;9", "% pause", *lines()[5:], "# end"],
    "blanks": lines("   "),
    "blanks in front and behind": [f"  {line}  " for line in lines(" ")],
    "comma and blank": lines(", "),
    "trailing comma": [line + "," for line in lines(",")],
    "trailing comma of the rows": [lines(",")[0], *(line + "," for line in lines(",")[1:])],
    "sep line": ["sep=;", *lines()],
    "sep line and decimal comma": ['"sep=;"', *lines(decimal=",")],
    "quoted": [";".join(f'"{cell}"' for cell in line.split(";")) for line in lines()],
    "text beside the numbers": [HEADER + ";note", *(f"{line};a, b" for line in lines(header=None))],
}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_text_file_is_read_as_it_comes(name: str, tmp_path: Path) -> None:
    check(read_log(written(tmp_path, VARIANTS[name]), COLUMNS))


@pytest.mark.parametrize("name", ["log.CSV", "log.dat", "log.txt", "log.Dat"])
def test_a_text_file_may_have_any_usual_suffix(name: str, tmp_path: Path) -> None:
    check(read_log(written(tmp_path, lines(), name), COLUMNS))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_a_text_file_may_have_any_usual_encoding(encoding: str, tmp_path: Path) -> None:
    strain = "Dehnung ε" if "utf" in encoding else "Dehnung µ"
    header = HEADER.replace("angle", "Winkel [°]").replace("strain", strain)
    columns = Columns(time="t", command=("u",), encoder=("Winkel [°]",), gauge=(strain,))
    check(read_log(written(tmp_path, lines(header=header), encoding=encoding), columns))


def test_columns_without_a_header_are_named_by_number_or_by_the_user(tmp_path: Path) -> None:
    for before in ([], ["Logger 3", "Channels;4"]):
        path = written(tmp_path, before + lines(header=None))
        check(read_log(path, NUMBERED))
        check(read_log(path, replace(COLUMNS, titles=TITLES)))
    check(read_log(written(tmp_path, lines()), NUMBERED))  # beside a header
    check(read_log(written(tmp_path, lines()), Columns(
        time="t", command=("2",), encoder=("angle",), gauge=("4",))))  # fmt: skip


@pytest.mark.parametrize("first", [0, 1])
def test_a_first_line_that_counts_the_columns_is_not_taken_as_a_sample(
    first: int, tmp_path: Path
) -> None:
    """A log that starts later than 1 s would else have one sample too many."""
    later = [f"{5.0 + 0.005 * k:.3f};{-0.5 * k};{k + 0.25};{1e-6 * k:.1e}" for k in K]
    header = ";".join(str(k + first) for k in range(4))
    with pytest.raises(ValueError, match=r"log.csv: line 1 holds .*; remove the line, or give"):
        read_log(written(tmp_path, [header, *later]), NUMBERED)
    titled = read_log(written(tmp_path, [header, *later]), replace(COLUMNS, titles=TITLES))
    assert titled.time.size == K.size + 1
    at_rest = ["0;0;0;0", *later]
    assert read_log(written(tmp_path, at_rest), NUMBERED).time.size == K.size + 1


def test_empty_cells_are_the_gaps_of_a_slower_channel(tmp_path: Path) -> None:
    """Half of the encoder's and all but one of the command's samples, which holds."""
    rows = []
    for k, line in enumerate(lines(header=None) + lines(header=None), 0):
        t, _, angle, strain = line.split(";")
        t = f"{0.005 * k:.3f}"
        rows.append(f"{t};{'0.5' if k == 0 else ''};{angle if k % 2 == 0 else 'NaN'};{strain}")
    log = read_log(written(tmp_path, [HEADER, *rows]), COLUMNS)
    assert_allclose(log.command[:, 0], 0.5)
    assert np.isfinite(log.encoder[::2]).all()
    assert np.isnan(log.encoder[1::2]).all()
    assert np.isfinite(log.gauge).all()


STAMPS = {  # before and after midnight, or a minute, with the milliseconds to come
    "ISO": ("2026-01-31T23:59:59.{}+01:00", "2026-02-01T00:00:00.{}+01:00"),
    "blank": ("2026-01-31 23:59:59.{}", "2026-02-01 00:00:00.{}"),
    "German": ("31.01.2026 23:59:59,{}", "01.02.2026 00:00:00,{}"),
    "British": ("31/01/2026 23:59:59.{}0000", "01/02/2026 00:00:00.{}0000"),
    "ambiguous": ("01/12/2026 23:59:59.{}", "02/12/2026 00:00:00.{}"),
    "American": ("01/31/2026 11:59:59.{} AM", "01/31/2026 12:00:00.{} PM"),
    "clock": ("10:00:59.{}", "10:01:00.{}"),
}


@pytest.mark.parametrize("kind", STAMPS)
@pytest.mark.parametrize("unit", ["s", "ms"])
def test_clock_times_and_dates_are_a_time(kind: str, unit: str, tmp_path: Path) -> None:
    """The unit of time does not matter."""
    before, after = STAMPS[kind]
    stamps = [(before if ms < 1000 else after).format(f"{ms % 1000:03d}")
              for ms in range(970, 1030, 5)]  # fmt: skip
    rows = lines(decimal="," if kind == "German" else ".", header=None)
    rows = [f"{stamp};{row.split(';', 1)[1]}" for stamp, row in zip(stamps, rows, strict=True)]
    check(read_log(written(tmp_path, [HEADER, *rows]), replace(COLUMNS, units={"time": unit})))


def test_a_whole_second_needs_no_decimals(tmp_path: Path) -> None:
    rows = [f"10:00:{k:02d};{line.split(';', 1)[1]}" for k, line in
            enumerate(lines(header=None))]  # fmt: skip
    log = read_log(written(tmp_path, [HEADER, *rows]), COLUMNS)
    assert_allclose(log.time, K)


def edited(number: int, line: str) -> list[str]:
    result = lines()
    result[number] = line
    return result


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        (lines(header=None), "it has no header; name its columns by number, 1 to 4, or give"),
        (edited(1, "0;zero;0;0"), "column 'u' holds 'zero' in line 2, which is no number"),
        (edited(4, "0,015;-1.234,5;3.25;0"), "column 't' holds '0,015' in line 5"),
        (edited(4, "0.015;-1.5;3.25"), "line 5 holds 3 values, but the header names 4"),
        (edited(4, "0.015;-1.5;3.25;0;0"), "line 5 holds 5 values, but the header names 4"),
        (edited(4, ";-1.5;3.25;0"), "column 't' is not finite at sample 4 of 12"),
        (edited(1, "0;;3.25;0"), "column 'u' is not finite at sample 1 of 12"),
        (edited(4, "0.015;-1.5;inf;0"), "column 'angle' is not finite at sample 4 of 12"),
        (edited(4, "0.015;-1.5;;0")[:11], "column 'angle' holds 9 readings in 10 samples"),
        ([*lines(decimal=","), "0,06;-6;1.234;0"], "'1.234' in line 14, which is no number with a"),
        (["sep=|", *lines("|")], "line 1 says that '|' separates columns; export the log with"),
        (edited(4, "31.01.2026 10:00;-1.5;3;0"), "holds '0.000' in line 2, which is no time"),
        ([*PREAMBLE, *lines(header="t;u;a;s")], "holds no column 'angle'; it holds ['t', 'u', "),
    ],
)  # fmt: skip
def test_text_that_cannot_be_read_is_refused_with_its_line(
    rows: list[str], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError) as refusal:
        read_log(written(tmp_path, rows), COLUMNS)
    assert str(refusal.value).startswith("log.csv: ")
    assert sentence in str(refusal.value)


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (Columns(time="1", gauge=("9",)), "holds no line with numbers in all of the columns"),
        (Columns(time="0", gauge=("1",)), "or by their numbers from 1"),
        (Columns(time="t", gauge=("9",)), "holds no column '9'; it holds"),
        (Columns(time="t", gauge=("u", "2")), "is named twice, by its title and by its number"),
        (Columns(time="t", gauge=("x",), titles=TITLES), "holds no column 'x'; it holds"),
    ],
)
def test_a_column_that_is_not_there_is_refused(
    columns: Columns, sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError) as refusal:
        read_log(written(tmp_path, lines()), columns)
    assert sentence in str(refusal.value)


def scope(**change: Any) -> dict[str, Any]:
    """Simulink's structure with time: the command and two signals in a matrix."""
    signals = np.zeros(2, dtype=[("values", object), ("dimensions", object), ("label", object)])
    signals[0] = (-0.5 * K[:, None], 1.0, "motor torque")
    signals[1] = (np.stack([K + 0.25, 1e-6 * K], axis=1), 2.0, "")
    return {"time": 0.005 * K[:, None], "signals": signals, "blockName": "rig/scope"} | change


T, U, ANGLE, STRAIN = 0.005 * K, -0.5 * K, K + 0.25, 1e-6 * K
TABLE = np.stack([T, U, ANGLE, STRAIN], axis=1)
MATLAB: dict[str, tuple[dict[str, Any], list[str]]] = {
    "struct": ({"run": {"t": T, "sensors": {"angle": ANGLE[:, None], "strain": STRAIN}, "u": U}},
               ["run.t", "run.u", "run.sensors.angle", "run.sensors.strain"]),
    "matrix": ({"data": TABLE}, ["data:1", "data:2", "data:3", "data:4"]),
    "To File": ({"ans": TABLE.T}, ["ans:1", "ans:2", "ans:3", "ans:4"]),
    "structure with time": ({"scope": scope()}, ["scope.time", "scope.motor torque",
                                                 "scope.signals:2:1", "scope.signals:2:2"]),
    "one signal": ({"t": T, "a": {"time": T, "signals": {"values": ANGLE.reshape(1, 1, -1),
                                                         "label": "angle"}}, "u": U, "s": STRAIN},
                   ["a.time", "u", "a.angle", "s"]),
    "struct beside a structure with time": (
        {"scope": scope(strain=STRAIN), "run": {"time": T, "signals": TABLE[:, 1:3]}},
        ["run.time", "run.signals:1", "run.signals:2", "scope.strain"],
    ),
    "array of structs": (
        {"run": {"X": {"Data": T}, "Y": np.array([(U, 1), (ANGLE, 2), (STRAIN, 3)],
                                                 dtype=[("Data", object), ("Raster", object)])}},
        ["run.X.Data", "run.Y:1.Data", "run.Y:2.Data", "run.Y:3.Data"],
    ),
    "integers": ({"t": T, "u": U, "a": ANGLE, "s": STRAIN, "k": np.arange(12, dtype=np.int16)},
                 ["t", "u", "a", "s"]),
}  # fmt: skip


def named(names: list[str]) -> Columns:
    return Columns(time=names[0], command=(names[1],), encoder=(names[2],), gauge=(names[3],))


@pytest.mark.parametrize("kind", MATLAB)
def test_a_mat_file_is_read_as_it_comes(kind: str, tmp_path: Path) -> None:
    variables, names = MATLAB[kind]
    savemat(tmp_path / "log.MAT", variables)
    check(read_log(tmp_path / "log.MAT", named(names)))


def test_the_mat_files_of_one_run_are_read_together(tmp_path: Path) -> None:
    parts = {"a.mat": {"data_u": TABLE[:, [0, 1]]}, "b.mat": {"angle": ANGLE, "strain": STRAIN}}
    for name, variables in parts.items():
        savemat(tmp_path / name, variables)
    columns = named(["data_u:1", "data_u:2", "angle", "strain"])
    check(read_log([tmp_path / name for name in parts], columns))
    savemat(tmp_path / "c.mat", {"angle": ANGLE})
    with pytest.raises(ValueError, match="'angle' is there 2 times, in one file or in several"):
        read_log([tmp_path / name for name in [*parts, "c.mat"]], columns)
    with pytest.raises(ValueError, match="only MAT files of one run are read together"):
        read_log([tmp_path / "a.mat", written(tmp_path, lines())], columns)


@pytest.mark.parametrize(
    ("variables", "name", "sentence"),
    [
        ({"a": TABLE}, "a", "got a matrix of shape (12, 4): name a:1 to a:4"),
        ({"a": {"b": "text"}}, "a.b", "variable 'a.b' must be a vector of numbers, got str"),
        ({"a": scope()}, "a.angle", "holds no column 'a.angle'; it holds"),
        ({"a": scope(signals={"label": "angle"})}, "a.angle", "no column 'a.angle'"),
        ({"a": {"time": T, "signals": "none"}}, "a.signals", "vector of numbers, got str"),
        ({"a": np.ones((2, 3, 12))}, "a", "got float64 of shape (2, 3, 12)"),
        (
            {"a": np.array([1, "x"], dtype=object)},
            "a:2",
            "'a:2' must be a vector of numbers, got str",
        ),
    ],
)
def test_what_is_no_vector_is_refused(
    variables: dict[str, Any], name: str, sentence: str, tmp_path: Path
) -> None:
    savemat(tmp_path / "log.mat", {"t": T} | variables)
    with pytest.raises(ValueError) as refusal:
        read_log(tmp_path / "log.mat", Columns(time="t", gauge=(name,)))
    assert sentence in str(refusal.value)


def test_an_object_of_matlab_is_refused_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As SciPy returns a file with a timeseries."""
    savemat(tmp_path / "log.mat", {"t": T})
    found = {"None": np.zeros(1, dtype="V8"), "__function_workspace__": np.zeros(9), "t": T}
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: found)
    with pytest.raises(ValueError, match=r"an object, such as a timeseries .* time = ts\.Time"):
        read_log(tmp_path / "log.mat", Columns(time="t", gauge=("ts",)))


def test_a_column_may_have_its_own_unit(tmp_path: Path) -> None:
    units = {"gauge": "microstrain", "angle": "deg", "strain": "1e-3"}
    columns = Columns(
        time="t", command=("u",), encoder=("angle",), gauge=("strain", "5"), units=units
    )
    rows = [f"{line};{line.split(';')[3]}" for line in lines()]
    rows[0] = f"{HEADER};other"
    log = read_log(written(tmp_path, rows), columns)
    assert_allclose(log.encoder[:, 0], np.radians(K + 0.25))
    assert_allclose(log.gauge, np.outer(1e-6 * K, [1e-3, 1e-6]))


@pytest.mark.parametrize("shape", [(1, 4), (4, 1), (2, 2)])
def test_the_vectors_of_a_cell_array_are_columns_in_the_order_of_matlab(
    shape: tuple[int, int], tmp_path: Path
) -> None:
    cells = np.empty(4, dtype=object)
    cells[:] = [0.005 * K, -0.5 * K, K + 0.25, 1e-6 * K]
    savemat(tmp_path / "log.mat", {"c": cells.reshape(shape, order="F")})
    columns = Columns(time="c:1", command=("c:2",), encoder=("c:3",), gauge=("c:4",))
    check(read_log(tmp_path / "log.mat", columns))
    with pytest.raises(
        ValueError, match=r"no column 'c:5'; it holds \['c:1', 'c:2', 'c:3', 'c:4'\]"
    ):
        read_log(tmp_path / "log.mat", replace(columns, gauge=("c:5",)))
