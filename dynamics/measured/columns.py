"""Names and units of a log's columns."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral

from dynamics.description.validate import clean, shown

UNITS: dict[str, dict[str, float]] = {  # kind of signal: unit: factor to SI
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "command": {"N m": 1.0, "mN m": 1e-3, "N": 1.0},
    "encoder": {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi, "m": 1.0, "mm": 1e-3},
    "gauge": {
        "1/m": 1.0, "strain": 1.0, "microstrain": 1e-6, "rad": 1.0, "deg": math.pi / 180.0,
        "mrad": 1e-3,
    },
}  # fmt: skip
SLIDING = {"command": ("N",), "encoder": ("m", "mm")}  # units of joints that slide; others turn


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Names of a file's columns, or of a MAT file's variables, and their units.

    A name is a title or, where the file has no such title, a column's number from 1. A unit is a
    name in UNITS or a factor to SI, such as the radians of one count; the first one of a kind's
    UNITS is that of a kind without one.
    """

    time: str
    command: tuple[str, ...] = ()  # per driven joint; each value holds until the next
    encoder: tuple[str, ...] = ()  # per joint
    gauge: tuple[str, ...] = ()  # strain, curvature, or the angle of a bent link
    units: Mapping[str, str] = field(default_factory=dict)  # by column, or by kind: time, ...
    titles: tuple[str, ...] = ()  # of all columns of a text file without a header

    def __post_init__(self) -> None:
        clean(self, time=_column(self.time, "time"))
        for kind in ("command", "encoder", "gauge", "titles"):
            given = getattr(self, kind)
            if isinstance(given, str) or not isinstance(given, Iterable):
                raise ValueError(
                    f"Columns.{kind} must be a tuple of columns, got {shown(given)}; write "
                    f"({shown(given)},) for one."
                )
            clean(self, **{kind: tuple(_column(name, kind) for name in given)})

    @property
    def names(self) -> list[str]:
        """All columns, in the order of the kinds in UNITS."""
        return [self.time, *self.command, *self.encoder, *self.gauge]

    @property
    def kinds(self) -> list[str]:
        """Kinds of all columns, in their order."""
        parts = ((self.time,), self.command, self.encoder, self.gauge)
        return [kind for kind, part in zip(UNITS, parts, strict=True) for _ in part]

    def factors(self) -> list[float]:
        """Factors from the units of all columns to SI."""
        unknown = sorted(set(self.units) - set(UNITS) - set(self.names))
        if unknown:
            raise ValueError(
                f"Unknown kinds of units {unknown}. Known: {list(UNITS)}, and the columns named."
            )
        for kind in UNITS:  # also those of kinds without a column
            self._factor(kind, kind)
        return [self._factor(*pair) for pair in zip(self.names, self.kinds, strict=True)]

    def unit(self, name: str, kind: str) -> str:
        """Unit of a column of a kind."""
        return self.units.get(name, self.units.get(kind, next(iter(UNITS[kind]))))

    def _factor(self, name: str, kind: str) -> float:
        unit = self.unit(name, kind)
        try:
            result = UNITS[kind][unit] if unit in UNITS[kind] else float(unit)
        except ValueError:
            result = 0.0
        if not (math.isfinite(result) and result):
            raise ValueError(
                f"The unit of {name} must be one of {list(UNITS[kind])} or a factor to SI, "
                f"got {shown(unit)}."
            )
        return result


def _column(name: object, kind: str) -> str:
    """Title or number of a column as text."""
    if isinstance(name, bool) or not isinstance(name, str | Integral):
        raise ValueError(
            f"Columns.{kind} must hold titles, or numbers of columns from 1, got {shown(name)}."
        )
    return str(name)


def require(names: Sequence[str], present: Iterable[str]) -> None:
    """Refuse columns that a file does not hold, and those that are there or named twice."""
    held = list(present)
    missing = [name for name in names if name not in held]
    if missing:
        raise ValueError(f"holds no column {missing[0]!r}; it holds {shown(held)}.")
    alike = [name for name in names if held.count(name) > 1]
    if alike:
        raise ValueError(
            f"column {alike[0]!r} is there {held.count(alike[0])} times, in one file or in several "
            "of one run; name it by its number, or rename the others."
        )
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise ValueError(f"column {repeated[0]!r} is named twice.")
