"""Logs of rigs: CSV and MAT files whose columns and units the user names."""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import numpy as np

from dynamics.description import validate
from dynamics.description.validate import shown
from dynamics.types import AnyArray, Array

MOST_BYTES = 268_435_456
ROWS = (10, 200_000)  # fewest and most samples
SEPARATORS = ",;\t"
UNITS: dict[str, dict[str, float]] = {  # kind of signal: unit: factor to SI
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "command": {"N m": 1.0, "mN m": 1e-3, "N": 1.0},
    "encoder": {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi, "m": 1.0, "mm": 1e-3},
    "gauge": {"1/m": 1.0, "strain": 1.0, "microstrain": 1e-6},
}


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Names of a file's columns, or of a MAT file's variables, and their units.

    A unit is a name in UNITS or a factor to SI, such as the radians of one count; the first one
    of a kind's UNITS is that of a kind without one.
    """

    time: str
    command: tuple[str, ...] = ()  # per driven joint; each value holds until the next sample
    encoder: tuple[str, ...] = ()  # per joint
    gauge: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)  # by kind: time, command, ...

    @property
    def names(self) -> list[str]:
        """All columns, in the order of the kinds in UNITS."""
        return [self.time, *self.command, *self.encoder, *self.gauge]

    def factor(self, kind: str) -> float:
        """Factor from the unit of a kind of signal to SI."""
        unit = self.units.get(kind, next(iter(UNITS[kind])))
        try:
            result = UNITS[kind][unit] if unit in UNITS[kind] else float(unit)
        except ValueError:
            result = 0.0
        if not (math.isfinite(result) and result):
            raise ValueError(
                f"The unit of {kind} must be one of {list(UNITS[kind])} or a factor to SI, "
                f"got {shown(unit)}."
            )
        return result


@dataclass(frozen=True)
class Log:
    """Signals of one run of a rig, in SI units."""

    time: Array  # (N,) [s] strictly increasing
    command: Array  # (N, n_torque) [N m] or [N], each held until the next sample
    encoder: Array  # (N, n_joint) [rad] or [m]
    gauge: Array  # (N, n_gauge) [1/m] curvature, or [-] strain

    def since(self, first: float) -> "Log":
        """The samples from a time [s] on, such as the release of a plucked arm."""
        k = int(np.searchsorted(self.time, validate.number(first, "first time", "s")))
        if len(self.time) - k < ROWS[0]:
            raise ValueError(
                f"From {first:.6g} s on the log holds {len(self.time) - k} samples, and a fit "
                f"needs {ROWS[0]}; its time runs from {self.time[0]:.6g} to {self.time[-1]:.6g} s."
            )
        return Log(self.time[k:], self.command[k:], self.encoder[k:], self.gauge[k:])


def read_log(path: str | Path, columns: Columns) -> Log:
    """Read and check the named columns of a .csv, .txt or .mat file.

    Raises
    ------
    ValueError : for a file that cannot be read, a missing column, a value that is no finite number,
        columns of unequal length, or time that does not increase; one sentence with the place.
    """
    path = Path(path)
    unknown = sorted(set(columns.units) - set(UNITS))
    if unknown:
        raise ValueError(f"Unknown kinds of units {unknown}. Known: {list(UNITS)}.")
    factors = {kind: columns.factor(kind) for kind in UNITS}
    if path.suffix not in READERS:
        raise ValueError(f"{path.name} must end in one of {list(READERS)}.")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError(f"must have at most {MOST_BYTES} bytes.")
        found = READERS[path.suffix](path, columns.names)
        table = _table(found)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None
    stops = np.cumsum([1, len(columns.command), len(columns.encoder)])
    time, command, encoder, gauge = np.split(table, stops, axis=1)
    return Log(
        (time * factors["time"])[:, 0],
        command * factors["command"],
        encoder * factors["encoder"],
        gauge * factors["gauge"],
    )


def _table(found: Mapping[str, AnyArray]) -> Array:
    """(N, columns) finite values whose first column, time, increases."""
    lengths = {name: column.size for name, column in found.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"columns have unequal lengths: {lengths}.")
    size = next(iter(lengths.values()))
    if not ROWS[0] <= size <= ROWS[1]:
        raise ValueError(f"must hold {ROWS[0]} to {ROWS[1]} samples, got {size}.")
    for name, column in found.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise ValueError(
                f"column {name!r} is not finite at sample {bad[0] + 1} of {size} and "
                f"{bad.size - 1} more; cut or repair these samples."
            )
    time = next(iter(found.values()))
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        raise ValueError(
            f"time must increase, but sample {back[0] + 2} ({time[back[0] + 1]:.9g}) does not "
            f"follow sample {back[0] + 1} ({time[back[0]]:.9g})."
        )
    return np.stack(list(found.values()), axis=1)


def _read_text(path: Path, names: list[str]) -> dict[str, AnyArray]:
    """Columns of a text file with a header line, separated as the header is."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"must be UTF-8 text ({error.reason} at byte {error.start}).") from None
    header = text.partition("\n")[0]
    separator = max(SEPARATORS, key=header.count)
    rows = csv.reader(StringIO(text), delimiter=separator, skipinitialspace=True)
    titles = [title.strip() for title in next(rows, [])]
    _require(names, titles)
    places = [titles.index(name) for name in names]
    values: list[list[float]] = []
    for row in filter(None, rows):
        if len(row) != len(titles):
            raise ValueError(
                f"line {rows.line_num} holds {len(row)} values, but the header names {len(titles)}."
            )
        values.append([_number(row[k], titles[k], rows.line_num) for k in places])
    table = np.array(values).reshape(-1, len(names))
    return dict(zip(names, table.T, strict=True))


def _number(text: str, name: str, line: int) -> float:
    try:
        return float(text) if text.strip() else math.nan
    except ValueError:
        raise ValueError(
            f"column {name!r} holds {shown(text)} in line {line}, which is no number."
        ) from None


def _read_mat(path: Path, names: list[str]) -> dict[str, AnyArray]:
    """Variables of a MAT file up to version 7.2, each a vector."""
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        _require(names, [name for name, _, _ in whosmat(path)])
        held = loadmat(path, variable_names=names)
    except NotImplementedError:
        raise ValueError("is a MAT file of version 7.3; save it with -v7.") from None
    except (MatReadError, TypeError, KeyError, IndexError) as error:
        raise ValueError(f"cannot be read as a MAT file ({error}).") from None
    for name in names:
        column = held[name]
        if column.dtype.kind not in "buif" or column.size != max(column.shape, default=0):
            raise ValueError(
                f"variable {name!r} must be a vector of numbers, got {column.dtype} of shape "
                f"{column.shape}."
            )
    return {name: held[name].astype(np.float64).ravel() for name in names}


def _require(names: list[str], present: list[str]) -> None:
    missing = [name for name in names if name not in present]
    if missing:
        raise ValueError(f"holds no column {missing[0]!r}; it holds {shown(present)}.")
    repeated = [name for name in names if names.count(name) > 1 or present.count(name) > 1]
    if repeated:
        raise ValueError(f"column {repeated[0]!r} is named twice.")


READERS = {".csv": _read_text, ".txt": _read_text, ".mat": _read_mat}
