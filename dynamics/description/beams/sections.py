"""Sections of a link that is not uniform, such as a stepped tube or a fishing rod.

A quantity is constant in a section, or linear between two numbers: those at its two ends. At a step
the outer section's number holds.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.description import validate
from dynamics.types import Array

Along = float | tuple[float, float]  # constant in a section, or at its inner and outer end
UNITS = {
    "rho_A": "kg/m", "EIz": "N m^2", "EIy": "N m^2", "GJ": "N m^2", "EA": "N", "rho_Ip": "kg m",
}  # fmt: skip
MOST_SECTIONS = 60
STEEPEST = 16.0  # [-] largest ratio of a quantity's numbers at the ends of a section
_GENTLE = 2.0  # [-] the same over a piece, in which shapes are polynomials
_SLIVER = 1e-9  # [-] share of a section, below which a cut leaves nothing of it


@dataclass(frozen=True, kw_only=True)
class Section:
    """Part of a link; each quantity is a number, or a pair of numbers at its inner and outer end.

    Raises ValueError for numbers that are not positive, and pairs of a ratio above STEEPEST.
    """

    length: float  # [m]
    rho_A: Along  # [kg/m] mass per unit length
    EIz: Along | None = None  # [N m^2] flexural rigidity for deflection along y
    EIy: Along | None = None  # [N m^2] flexural rigidity for deflection along z
    GJ: Along | None = None  # [N m^2] torsional rigidity
    EA: Along | None = None  # [N] axial rigidity
    rho_Ip: Along | None = None  # [kg m] polar rotary inertia per unit length

    def __post_init__(self) -> None:
        validate.clean(self, length=validate.positive(self.length, "Section.length", "m"))
        for name in UNITS:
            if name == "rho_A" or getattr(self, name) is not None:
                validate.clean(self, **{name: _along(getattr(self, name), name)})

    def ends(self, name: str) -> tuple[float, float]:
        """Numbers of a stated quantity at the inner and the outer end."""
        value = getattr(self, name)
        return value if isinstance(value, tuple) else (value, value)


Sections = tuple[Section, ...]


def _along(value: object, name: str) -> Along:
    field, unit = f"Section.{name}", UNITS[name]
    if not isinstance(value, list | tuple | np.ndarray):
        return validate.positive(value, field, unit)
    inner, outer = (
        validate.positive(x, f"{field}[{k}]", unit)
        for k, x in enumerate(validate.numbers(value, field, 2, unit))
    )
    if max(inner, outer) > STEEPEST * min(inner, outer):
        raise ValueError(
            f"{field} must change by a factor of at most {STEEPEST:g} in one section, got "
            f"{validate.shown(value)}; divide the section."
        )
    return (inner, outer)


def checked(value: object) -> Sections:
    """Sections of a link, which all state the same quantities; raises ValueError otherwise."""
    entries = validate.sequence(value, "Link.sections", MOST_SECTIONS)
    sections = tuple(
        validate.instance(entry, f"Link.sections[{k}]", Section) for k, entry in enumerate(entries)
    )
    for name in UNITS:
        stated = [getattr(section, name) is not None for section in sections]
        if any(stated) and not all(stated):
            raise ValueError(
                f"Link.sections[{stated.index(False)}].{name} is missing, but "
                f"Link.sections[{stated.index(True)}] has it; give {name} in every section or in "
                "none."
            )
    return sections


def total_length(sections: Sections) -> float:
    """[m]."""
    return math.fsum(section.length for section in sections)


def mean(sections: Sections, name: str) -> float:
    """Mean of a quantity over the length; 0 if it is not stated."""
    if getattr(sections[0], name) is None:
        return 0.0
    area = math.fsum(section.length * sum(section.ends(name)) / 2.0 for section in sections)
    return area / total_length(sections)


def at(sections: Sections, name: str, x: Array | float) -> Array:
    """A stated quantity at positions x [m], of the shape of x."""
    place, share = _place(sections, x)
    inner, outer = np.array([section.ends(name) for section in sections]).T
    return np.asarray(inner[place] + share * (outer - inner)[place])


def rate(sections: Sections, name: str, x: Array | float) -> Array:
    """Derivative of a stated quantity by x, steps left out, of the shape of x."""
    place, _ = _place(sections, x)
    rates = [(b - a) / s.length for s in sections for a, b in [s.ends(name)]]
    return np.asarray(np.array(rates)[place])


def relative(sections: Sections, name: str, x: Array) -> Array:
    """A quantity at positions x over its mean; 1 on a link without sections."""
    if not sections or getattr(sections[0], name) is None:
        return np.ones(np.shape(x))
    return at(sections, name, x) / mean(sections, name)


def cut(sections: Sections, start: float, stop: float) -> Sections:
    """Sections of the part of a link between two positions [m]."""
    result, begin = [], 0.0
    for section in sections:
        a, b = ((x - begin) / section.length for x in (start, stop))
        a, b = max(a, 0.0), min(b, 1.0)
        if b - a > _SLIVER:
            result.append(_part(section, a, b))
        begin += section.length
    return tuple(result)


def edges(sections: Sections) -> tuple[float, ...]:
    """Ends [m] of the pieces in which no rigidity changes by more than a factor of _GENTLE."""
    result, begin = [0.0], 0.0
    for section in sections:
        pairs = [section.ends(name) for name in UNITS if getattr(section, name) is not None]
        a, b = max(pairs, key=lambda pair: abs(math.log(pair[1] / pair[0])))
        count = max(1, math.ceil(abs(math.log(b / a, _GENTLE)) - _SLIVER))
        for k in range(1, count):
            result.append(begin + section.length * (a * (b / a) ** (k / count) - a) / (b - a))
        begin += section.length
        result.append(begin)
    return tuple(result)


def _place(sections: Sections, x: Array | float) -> tuple[Any, Array]:
    """Index of the section at each position, and the share of it that is passed there."""
    ends = np.concatenate([[0.0], np.cumsum([section.length for section in sections])])
    place = np.clip(np.searchsorted(ends, x, side="right") - 1, 0, len(sections) - 1)
    return place, (np.asarray(x) - ends[place]) / np.diff(ends)[place]


def _part(section: Section, a: float, b: float) -> Section:
    """Part of a section between two shares of its length."""
    if (a, b) == (0.0, 1.0):
        return section
    values: dict[str, Any] = {}
    for name in UNITS:
        if isinstance(getattr(section, name), tuple):
            inner, outer = section.ends(name)
            values[name] = tuple(inner + share * (outer - inner) for share in (a, b))
    return replace(section, length=(b - a) * section.length, **values)
