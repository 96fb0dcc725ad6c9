"""What the validation page is made of: numbers of a source beside ours, and verdicts on them."""

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
    """One number as a source prints it, and what it takes to reproduce it."""

    quantity: str
    printed: str  # the source's digits; "" where none are left
    unit: str = ""
    within: float = nan  # [unit] the farthest ours may be; nan where nothing is claimed
    correct: float | None = None  # what the source should print, where it errs
    remark: str = ""
    claim: str = REPRODUCED  # what a comparison can show at best

    @property
    def theirs(self) -> float:
        """The printed number."""
        return float(self.printed.replace(" ", "")) if self.printed else nan

    def verdict(self, ours: float) -> str:
        """By comparison where one is claimed; an error in print must show itself as one."""
        if self.claim != REPRODUCED:
            return self.claim
        if self.correct is None:
            return REPRODUCED if abs(ours - self.theirs) <= self.within else MISSED
        found = abs(ours - self.correct) <= self.within < abs(ours - self.theirs)
        return ERROR if found else MISSED


@dataclass(frozen=True, kw_only=True)
class Table:
    """Numbers that one run gives together."""

    chapter: str
    title: str
    rows: tuple[Number, ...]
    ours: Callable[[], Sequence[float]]  # one per row; nan where there is nothing of ours
    demand: str  # what "reproduced" means here
    quick: bool = True  # part of the short form

    def results(self) -> list[dict[str, object]]:
        """One entry per row, as JSON holds it."""
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
    """Numbers to be met within `units` of each last printed digit (half of one: rounding)."""
    return tuple(
        Number(
            quantity=name, printed=text, unit=unit, within=units * last_digit(text), remark=remark
        )
        for name, text in zip(names, digits.split(), strict=True)
    )


def relatively(
    names: Sequence[str], digits: str, unit: str, share: float, remark: str = ""
) -> tuple[Number, ...]:
    """Numbers to be met within a share of themselves."""
    return tuple(
        Number(
            quantity=name, printed=text, unit=unit, within=share * abs(float(text)), remark=remark
        )
        for name, text in zip(names, digits.split(), strict=True)
    )


def last_digit(text: str) -> float:
    """What one unit of the last digit of a printed number is worth."""
    mantissa, _, exponent = text.lower().partition("e")
    return float(10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])))
