"""Entries of the validation page: printed numbers, our numbers, and verdicts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isnan, nan

REPRODUCED = "reproduced"
REPLACED = "replaced"
LOST = "lost in source"
ERROR = "error in print"
INCOMPARABLE = "not comparable"
MISSED = "not reproduced"
VERDICTS = (REPRODUCED, ERROR, REPLACED, LOST, INCOMPARABLE, MISSED)


@dataclass(frozen=True, kw_only=True)
class Number:
    """A printed number and the condition for reproducing it."""

    quantity: str
    printed: str  # the source's digits; "" if none are legible
    unit: str = ""
    within: float = nan  # [unit] largest deviation of ours; nan if nothing is claimed
    correct: float | None = None  # the correct number, if the print is wrong
    remark: str = ""
    claim: str = REPRODUCED  # best possible verdict

    @property
    def theirs(self) -> float:
        """The printed number."""
        return float(self.printed.replace(" ", "")) if self.printed else nan

    def verdict(self, ours: float) -> str:
        """Verdict on our number; "error in print" needs ours at `correct` and not at the print."""
        if self.claim != REPRODUCED:
            return self.claim
        if self.correct is None:
            return REPRODUCED if abs(ours - self.theirs) <= self.within else MISSED
        found = abs(ours - self.correct) <= self.within < abs(ours - self.theirs)
        return ERROR if found else MISSED


@dataclass(frozen=True, kw_only=True)
class Table:
    """Numbers that are computed together."""

    chapter: str
    title: str
    rows: tuple[Number, ...]
    ours: Callable[[], Sequence[float]]  # one per row; nan if we have none
    demand: str  # condition for "reproduced"
    quick: bool = True  # part of the short form

    def results(self) -> list[dict[str, object]]:
        """One entry per row, for JSON."""
        found = list(self.ours())
        if len(found) != len(self.rows):
            raise ValueError(f"{self.title}: {len(self.rows)} numbers but {len(found)} results.")
        return [_entry(row, float(x)) for row, x in zip(self.rows, found, strict=True)]


def _entry(row: Number, ours: float) -> dict[str, object]:
    known = not isnan(ours) and not isnan(row.theirs)
    return {
        "quantity": row.quantity,
        "unit": row.unit,
        "theirs": row.printed,
        "ours": None if isnan(ours) else ours,
        "deviation": ours - row.theirs if known else None,
        "verdict": row.verdict(ours),
        "remark": row.remark,
    }


def as_printed(
    names: Sequence[str], digits: str, unit: str = "", units: float = 0.51, remark: str = ""
) -> tuple[Number, ...]:
    """Numbers to reproduce within `units` of the last printed digit (0.5 is rounding)."""
    return _numbers(names, digits, unit, lambda text: units * last_digit(text), remark)


def relatively(
    names: Sequence[str], digits: str, unit: str, share: float, remark: str = ""
) -> tuple[Number, ...]:
    """Numbers to reproduce within the relative deviation `share`."""
    return _numbers(names, digits, unit, lambda text: share * abs(float(text)), remark)


def _numbers(
    names: Sequence[str], digits: str, unit: str, within: Callable[[str], float], remark: str
) -> tuple[Number, ...]:
    return tuple(
        Number(quantity=name, printed=text, unit=unit, within=within(text), remark=remark)
        for name, text in zip(names, digits.split(), strict=True)
    )


def mode_names(count: int) -> list[str]:
    """Names of the first modes."""
    return [f"mode {k}" for k in range(1, count + 1)]


def last_digit(text: str) -> float:
    """Value of one unit in the last digit of a printed number."""
    mantissa, _, exponent = text.lower().partition("e")
    return float(10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])))
