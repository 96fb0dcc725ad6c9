"""Logs of rigs: text and MAT files whose columns and units the user names."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynamics.description import validate
from dynamics.measured.columns import Columns as Columns  # of the arguments of `read_log`
from dynamics.measured.mat_file import read_mat
from dynamics.measured.text_file import read_text
from dynamics.types import AnyArray, Array

MOST_BYTES = 268_435_456
ROWS = (10, 200_000)  # fewest and most samples
TEXT, MAT = (".csv", ".txt", ".dat"), (".mat",)  # suffixes, in either case


@dataclass(frozen=True)
class Log:
    """Signals of one run of a rig, in SI units."""

    time: Array  # (N,) [s] strictly increasing
    command: Array  # (N, n_torque) [N m] or [N], each held until the next sample
    encoder: Array  # (N, n_joint) [rad] or [m], NaN between the readings of a slower one
    gauge: Array  # (N, n_gauge) [1/m] curvature, [-] strain or [rad]; NaN as above

    def __post_init__(self) -> None:
        validate.clean(self, time=validate.array(self.time, "Log.time", (None,)))
        if np.any(np.diff(self.time) <= 0.0):
            raise ValueError("Log.time must increase from sample to sample.")
        for name in ("command", "encoder", "gauge"):
            validate.unmasked(getattr(self, name), f"Log.{name}")
            shape = np.shape(getattr(self, name))
            if len(shape) != 2 or len(self.time) != shape[0]:
                raise ValueError(
                    f"Log.{name} must have a row for each of the {len(self.time)} times and a "
                    f"column for each signal, got shape {shape}."
                )
        if not np.isfinite(self.command).all():
            raise ValueError("Log.command must be finite; repeat the value that a motor holds.")

    def since(self, first: float, last: float = math.inf) -> "Log":
        """The samples from a time [s] on, such as the release of a plucked arm, up to another.

        Raises
        ------
        ValueError : for times that are no numbers, or between which there are too few samples.
        """
        for time, noun in ((first, "first time"), (last, "last time")):
            validate.number(0.0 if math.isinf(time) else time, noun, "s")
        there = (self.time >= first) & (self.time <= last)
        if there.sum() < ROWS[0]:
            until = "on" if math.isinf(last) else f"to {last:.6g} s"
            raise ValueError(
                f"From {first:.6g} s {until} the log holds {there.sum()} samples, and a fit "
                f"needs {ROWS[0]}; its time runs from {self.time[0]:.6g} to {self.time[-1]:.6g} s."
            )
        return Log(self.time[there], self.command[there], self.encoder[there], self.gauge[there])


def read_log(path: str | Path | Sequence[str | Path], columns: Columns) -> Log:
    """Read and check the named columns of a text file, or of the MAT files of one run.

    Raises
    ------
    ValueError : for a file that cannot be read, a missing column, a value that is infinite or no
        number, columns of unequal length, or time that does not increase; one sentence with the
        place.
    """
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(one) for one in path]
    if not paths:
        raise ValueError("A log needs at least one file, got [].")
    factors = columns.factors()
    for one in paths:
        _check_file(one, alone=len(paths) == 1)
    try:
        if paths[0].suffix.lower() in TEXT:
            found = read_text(paths[0], columns.names, columns.titles, factors[0])
        else:
            found = read_mat(paths, columns.names)
        table = _table(found, columns) * factors
    except ValueError as error:
        raise ValueError(f"{paths[0].name}: {error}") from None
    stops = np.cumsum([1, len(columns.command), len(columns.encoder)])
    time, command, encoder, gauge = np.split(table, stops, axis=1)
    return Log(time[:, 0], command, encoder, gauge)


def _check_file(path: Path, alone: bool) -> None:
    suffix = path.suffix.lower()
    if suffix not in (*TEXT, *MAT):
        raise ValueError(f"{path} must end in one of {[*TEXT, *MAT]}.")
    if suffix in TEXT and not alone:
        raise ValueError(f"{path.name}: only MAT files of one run are read together; join them.")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError(f"{path.name}: must have at most {MOST_BYTES} bytes.")
        path.open("rb").close()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error}).") from None


def _table(found: Mapping[str, AnyArray], columns: Columns) -> Array:
    """(N, columns) values whose first column, time, increases; NaN where a channel has none.

    A command holds until the next.
    """
    lengths = {name: column.size for name, column in found.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(
            f"columns have unequal lengths: {lengths}; bring them onto one time, NaN where a "
            "channel has no reading."
        )
    size = next(iter(lengths.values()))
    if not ROWS[0] <= size <= ROWS[1]:
        raise ValueError(f"must hold {ROWS[0]} to {ROWS[1]} samples, got {size}.")
    for (name, column), kind in zip(found.items(), columns.kinds, strict=True):
        _check_column(name, column, kind)
    time = next(iter(found.values()))
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        raise ValueError(
            f"time must increase, but sample {back[0] + 2} ({time[back[0] + 1]:.9g}) does not "
            f"follow sample {back[0] + 1} ({time[back[0]]:.9g})."
        )
    held = {name: _holding(found[name]) for name in columns.command}
    return np.stack(list((dict(found) | held).values()), axis=1)


def _check_column(name: str, column: AnyArray, kind: str) -> None:
    size = column.size
    allowed = np.isnan(column) & (kind != "time")
    if kind == "command":
        allowed[:1] = False
    bad = np.flatnonzero(~np.isfinite(column) & ~allowed)
    if bad.size:
        more = f" and {bad.size - 1} more" if bad.size > 1 else ""
        raise ValueError(
            f"column {name!r} is not finite at sample {bad[0] + 1} of {size}{more}; cut or repair "
            "what is not."
        )
    readings = int(np.isfinite(column).sum())
    if kind in ("encoder", "gauge") and readings < ROWS[0]:
        raise ValueError(
            f"column {name!r} holds {readings} readings in {size} samples, and a fit needs "
            f"{ROWS[0]}; name another column, or give a longer log."
        )


def _holding(command: AnyArray) -> AnyArray:
    """Command whose values hold where the next ones are missing."""
    last = np.maximum.accumulate(np.where(np.isfinite(command), np.arange(command.size), 0))
    return command[last]
