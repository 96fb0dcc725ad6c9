"""Fidelity of a model: modes per link and direction, segments, foreshortening, lumped masses.

A damping ratio means the same at every fidelity: see formulations/damping.py.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.description.arm import FOURTH_ORDER, Arm
from dynamics.description.link import Link, about_origin
from dynamics.description.mode_shapes import Mode
from dynamics.formulations.damping import yields

DIRECTIONS = ("y", "z", "x", "axial")  # bending, bending, torsion, stretching
MOST_MODES = 4  # per link and direction, in models that `choose_model` tries
MOST_SEGMENTS = 8
TORSION_WAVE = 3000.0  # [m/s] in a round bar of metal
THINNEST = 0.02  # [-] radius over length of the thinnest rod that twists without a stated inertia
_NATURAL = {"x": "torsion-fixed-free", "y": "clamped-tip-mass", "z": "clamped-tip-mass",
            "axial": "axial-fixed-free"}  # fmt: skip
_POLYNOMIAL = {"x": "torsion-poly", "y": "hierarchical", "z": "hierarchical", "axial": "axial-poly"}


Counts = tuple[int, ...]  # modes along y, z, x, and axial ones where the arm's own modes have some
Change = tuple[int, str]  # link, direction or "segments"


@dataclass(frozen=True, kw_only=True)
class Fidelity:
    """Modes and segments of every link, whether bending foreshortens it, and how mass is spread."""

    counts: tuple[Counts, ...]  # per link
    segments: tuple[int, ...]  # per link
    foreshortening: bool = False
    polynomial: bool = False  # polynomial shapes, else the arm's own family or beam modes
    lumped: bool = False  # every flexible link's mass

    @property
    def rigid(self) -> bool:
        """True if no link has modes."""
        return not any(map(any, self.counts))

    def arm(self, arm: Arm) -> Arm:
        """The arm reduced to this fidelity."""
        links = tuple(
            replace(
                link,
                modes=tuple(self._modes(link, counts)),
                segments=segments,
                lumped=self.lumped and any(counts),
                **_polar_inertia(link, counts),
            )
            for link, counts, segments in zip(arm.links, self.counts, self.segments, strict=True)
        )
        return replace(arm, links=links, foreshortening=self.foreshortening and FOURTH_ORDER)

    def _modes(self, link: Link, counts: Counts) -> Iterator[Mode]:
        for direction, count in zip(DIRECTIONS, counts, strict=False):
            own = link.in_direction(direction)
            kind = own[0].kind if own else _NATURAL[direction]
            kind = _POLYNOMIAL[direction] if self.polynomial else kind
            for index in range(1, count + 1):
                yield Mode(kind=kind, index=index, direction=direction)

    def refinements(
        self, most: tuple[Counts, ...], most_segments: tuple[int, ...]
    ) -> dict[Change, "Fidelity"]:
        """All fidelities with one more mode, or with the segments of one link doubled."""
        result = {}
        for i, counts in enumerate(self.counts):
            for d, count in enumerate(counts):
                if count < most[i][d]:
                    result[i, DIRECTIONS[d]] = self._with_modes(i, d, count + 1)
            if any(counts) and 2 * self.segments[i] <= most_segments[i]:
                result[i, "segments"] = self._with_segments(i, 2 * self.segments[i])
        return result

    def one_mode_more(self, most: tuple[Counts, ...]) -> "Fidelity":
        """One more mode in every link and direction at once, up to `most`."""
        counts = tuple(
            tuple(min(count + 1, limit) for count, limit in zip(*link, strict=True))
            for link in zip(self.counts, most, strict=True)
        )
        return replace(self, counts=counts)

    def without_highest(self) -> "Fidelity":
        """One mode less in every link and direction that has most modes."""
        most = max((n for counts in self.counts for n in counts), default=0)
        result = self
        for i, counts in enumerate(self.counts):
            for d, count in enumerate(counts):
                if 0 < count == most:
                    result = result._with_modes(i, d, count - 1)
        return result

    def reductions(self) -> dict[Change, "Fidelity"]:
        """All fidelities with one mode less, or with the segments of one link halved."""
        result = {}
        for i, counts in enumerate(self.counts):
            for d, count in enumerate(counts):
                if count:
                    result[i, DIRECTIONS[d]] = self._with_modes(i, d, count - 1)
            if self.segments[i] > 1:
                result[i, "segments"] = self._with_segments(i, self.segments[i] // 2)
        return result

    def _with_modes(self, link: int, direction: int, count: int) -> "Fidelity":
        row = (*self.counts[link][:direction], count, *self.counts[link][direction + 1 :])
        counts = (*self.counts[:link], row, *self.counts[link + 1 :])
        segments = self.segments if any(row) else _replaced(self.segments, link, 1)
        return replace(self, counts=counts, segments=segments)

    def _with_segments(self, link: int, segments: int) -> "Fidelity":
        return replace(self, segments=_replaced(self.segments, link, segments))

    def __str__(self) -> str:
        if self.rigid:
            return "rigid links"
        alike: dict[str, list[int]] = {}
        for i, kept in enumerate(zip(self.counts, self.segments, strict=True), 1):
            alike.setdefault(_link_text(*kept), []).append(i)
        texts = [f"{_link_list(links)}: {text}" for text, links in alike.items()]
        shapes = ", polynomial" if self.polynomial else ""
        lumped = ", lumped" if self.lumped else ""
        return "; ".join(texts) + shapes + lumped + ", foreshortened" * self.foreshortening


def rigid(arm: Arm, foreshortening: bool = False, polynomial: bool = False) -> Fidelity:
    """Fidelity without modes."""
    return Fidelity(
        counts=everything(arm, 0, 0),
        segments=(1,) * len(arm.links),
        foreshortening=foreshortening,
        polynomial=polynomial,
    )


def everything(arm: Arm, bending: int, torsion: int) -> tuple[Counts, ...]:
    """Mode counts per link: `bending` and `torsion`, in the directions with a stiffness.

    Torsion also needs an inertia to twist. A link without rho_Ip gets one torsion mode at most. A
    link whose own modes stretch it gets as many axial modes as torsion modes; others are too stiff
    along their axis for stretching to move the tip. A link before a parallel drive bends along y.
    """
    return tuple(_possible(arm, i, bending, torsion) for i in range(len(arm.links)))


def _possible(arm: Arm, i: int, bending: int, torsion: int) -> Counts:
    link = arm.links[i]
    y, z, x = (yields(link, d) for d in "yzx")
    payload = float(about_origin(arm.payload)[0, 0]) if arm.payload else 0.0
    inertia = link.mean("rho_Ip") + link.tip_inertia[0][0] + payload
    twists = x and (i < len(arm.links) - 1 or inertia > 0.0)
    stretches = (torsion,) if link.in_direction("axial") else ()
    if not divisible(arm)[i]:
        return bending * y, 0, 0, *stretches
    twisting = (torsion if link.mean("rho_Ip") else min(torsion, 1)) * twists
    return bending * y, bending * z, twisting, *stretches


def lumped(arm: Arm, counts: tuple[Counts, ...]) -> tuple[Counts, ...]:
    """Mode counts per link as far as lumped links can have them.

    A tip without inertia about the axis of bending has one mode there, under a tip force. A damping
    ratio is that of the link without its payload.
    """
    result = []
    for row, link, payload in zip(counts, arm.links, arm.carried, strict=True):
        inertia = np.diag(link.tip_inertia)
        if payload and not link.damping_ratio:
            inertia = inertia + np.diag(about_origin(payload))
        most = (1 + (inertia[2] > 0.0), 1 + (inertia[1] > 0.0), 1, 1)
        result.append(tuple(map(min, row, most)))
    return tuple(result)


def divisible(arm: Arm) -> tuple[bool, ...]:
    """Per link, whether it may be cut into segments: not before a parallel drive."""
    return tuple(not link.joint.parallel for link in (*arm.links[1:], Link(length=1.0, rho_A=1.0)))


def _polar_inertia(link: Link, counts: Counts) -> dict[str, Any]:
    """Field with the rho_Ip [kg m] of a link that twists and states none.

    It is that of a round bar of metal, or of the thinnest rod where that is more. With less, the
    twist is almost massless where the links beyond are in line, and the mass matrix of a bent link
    with many modes is not positive.
    """
    if link.mean("rho_Ip") or not counts[DIRECTIONS.index("x")]:
        return {}
    square = 0.5 * (THINNEST * link.length) ** 2  # [m^2]

    def inertia(GJ: float, rho_A: float) -> float:
        return max(GJ / TORSION_WAVE**2, rho_A * square)

    if not link.sections:
        return {"rho_Ip": inertia(link.GJ or 0.0, link.rho_A)}
    result = []
    for section in link.sections:
        inner, outer = map(inertia, section.ends("GJ"), section.ends("rho_A"))
        result.append(replace(section, rho_Ip=(inner, outer)))
    return {"sections": tuple(result)}


def _link_text(counts: Counts, segments: int) -> str:
    if not any(counts):
        return "rigid"
    modes = " + ".join(f"{n} {d}" for n, d in zip(counts, DIRECTIONS, strict=False) if n)
    return f"{segments} x ({modes})" if segments > 1 else modes


def _link_list(links: list[int]) -> str:
    """Link numbers as "link 2", "links 1, 2" or "links 1 to 4, 6"."""
    starts = [i for i in links if i - 1 not in links]
    ends = [i for i in links if i + 1 not in links]
    runs = zip(starts, ends, strict=True)
    texts = [f"{a} to {b}" if b > a + 1 else ", ".join(map(str, range(a, b + 1))) for a, b in runs]
    return f"link{'s' * (len(links) > 1)} {', '.join(texts)}"


def _replaced(values: tuple[int, ...], place: int, value: int) -> tuple[int, ...]:
    return (*values[:place], value, *values[place + 1 :])


def fidelity_of(arm: Arm) -> Fidelity:
    """Fidelity of an arm as described, in the terms of `choose_model`."""
    counts = tuple(
        tuple(len(link.in_direction(d)) for d in DIRECTIONS[: len(possible)])
        for link, possible in zip(arm.links, everything(arm, 1, 1), strict=True)
    )
    segments = tuple(link.segments for link in arm.links)
    bending = [link for link in arm.links if link.modes]
    return Fidelity(
        counts=counts,
        segments=segments,
        foreshortening=bool(arm.foreshortening),
        lumped=bool(bending) and all(link.lumped for link in bending),
    )
