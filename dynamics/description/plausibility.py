"""Warnings where an arm is read: numbers of no arm, as after a mistake of units, inertias of no
body, thick links, and shapes that are too stiff for what is welded to them.

A length in mm makes a link a thousand times longer and its first frequency a millionth. Thresholds
lie beyond space cranes (15 m, 0.1 Hz) and micro arms (a few mm, a few kHz).

A body's principal moment of inertia is at most the sum of the other two, about its centre of mass
and about any other point. An arm in a plane may state the moment about one axis alone.

Euler and Bernoulli's beam neglects shear and rotary inertia, which lower the frequencies of short,
thick links: Timoshenko, "On the correction for shear" (1921). By Rayleigh's quotient of a mode's
shape they divide its squared frequency by

    1 + E/kG int r^2 (EI s_xx)_x^2 / EI / int EI s_xx^2 + int rho_A r^2 s_x^2 / modal mass

with the radius of gyration r of the section, r^2 = EI / EA.
"""

import math
import warnings
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from dynamics.description.arm import Arm
from dynamics.description.beams.piecewise import PieceShape
from dynamics.description.beams.sections import rate
from dynamics.description.beams.uniform import BeamShape
from dynamics.description.carried import Carried, carried
from dynamics.description.link import Link
from dynamics.description.mode_rule import LADEN, TWISTED, ModesByRule
from dynamics.description.mode_shapes import BENDING, STIFFNESS, Mode, points, shape
from dynamics.description.welds import StiffSegmentsWarning, stiff_end
from dynamics.types import Array, Matrix3

LENGTHS = (1e-3, 100.0)  # [m] of a link, or of a joint's offset
STRONGEST = 1000.0  # [m/s^2] gravity: a hundred times that of the earth
HEAVIEST = 1e5  # [kg] link with its tip and body
FREQUENCIES = (0.01, 1e5)  # [Hz] first bending mode of a clamped link with its tip
ROUNDED = 0.01  # [-] of a sum of two moments, which rounded entries may miss
NEGLECTED = 0.01  # [-] share of a frequency, from which a link is thick
SHEAR = 2.6 / 0.85  # [-] E / kG of a rectangle, Poisson's ratio 0.3
SOUND = 5000.0  # [m/s] in a bar of steel or aluminium: EA of a link that states none
_told: set[tuple[float, ...]] = set()  # lengths of the links of arms that were warned of


class ImplausibleArmWarning(UserWarning):
    """Lengths, masses, inertias or frequencies of an arm are those of no arm."""


class ThickLinkWarning(UserWarning):
    """Shear and rotary inertia, which the beams neglect, matter in a link's first frequencies."""


def warn_if_implausible(arm: Arm, stacklevel: int) -> None:
    """Warn of an arm; of the same lengths of links once in a process, but for welds."""
    _warn_of_welds(arm, stacklevel + 1)
    _warn_of_inertias(arm, stacklevel + 1)
    found = [
        (k, f"link {k} has {text}")
        for k, link in enumerate(arm.links, 1)
        for text in _oddities(link)
    ]
    gravity = math.hypot(*arm.gravity)
    if gravity > STRONGEST:
        found.insert(0, (0, f"gravity is {gravity:g} m/s^2"))
    lengths = tuple(link.length for link in arm.links)
    if not found:
        _warn_if_thick(arm, stacklevel + 1)
    if not found or lengths in _told:
        return
    _told.add(lengths)
    text = found[0][1]
    name = f"The arm {arm.name!r}" if arm.name else "The arm"
    count = len({link for link, _ in found if link})
    also = f", and {count} links are implausible" if count > 1 else ""
    warnings.warn(
        f"{name} may not be in SI units: {text}{also}. Give lengths in m, masses in kg, mass per "
        "length in kg/m, EI in N m^2 and gravity in m/s^2; if they are, ignore this warning.",
        ImplausibleArmWarning,
        stacklevel=stacklevel + 1,
    )


def _warn_of_welds(arm: Arm, stacklevel: int) -> None:
    """Warn of listed shapes that are too stiff for what is welded to their tip."""
    beyond = carried(arm.links, arm.payload)
    for i, (link, bodies) in enumerate(zip(arm.links, beyond, strict=True), 1):
        if link.segments == 1 and not isinstance(link.modes, ModesByRule):
            stiff = stiff_end(f"Link {i}", link.modes, link.beam, _laden(link, bodies))
            if stiff:
                warnings.warn(stiff, StiffSegmentsWarning, stacklevel=stacklevel + 1)


def _laden(link: Link, beyond: Carried) -> set[str]:
    """Directions along which the inertia welded to a link's tip is not small beside its own."""
    own, turned = link.beam.line_mass, beyond.welded_inertia()
    polar = TWISTED * link.mean("rho_Ip") * link.length
    least = {"x": polar, "axial": LADEN * own.mass} | dict.fromkeys(BENDING, LADEN * own.second)
    return {direction for direction, most in least.items() if turned[direction] > most}


def _warn_of_inertias(arm: Arm, stacklevel: int) -> None:
    """Warn of inertias that no body has, of the same moments once in a process."""
    for name, inertia in _inertias(arm):
        least, middle, most = (float(x) for x in np.linalg.eigvalsh(np.array(inertia)))
        key, others = (math.inf, least, middle, most), least + middle
        several = np.count_nonzero(np.diag(inertia)) > 1
        if several and most > (1.0 + ROUNDED) * others and key not in _told:
            _told.add(key)
            warnings.warn(
                f"{name} is that of no body: its principal moment {most:g} kg m^2 is more than the "
                f"sum of the others, {least:g} and {middle:g}. Check its entries; an arm in a "
                "plane may give the moment about one axis alone.",
                ImplausibleArmWarning,
                stacklevel=stacklevel + 1,
            )


def _inertias(arm: Arm) -> Iterator[tuple[str, Matrix3]]:
    """Names and inertias (3, 3) [kg m^2] of links and payload; a base refuses its own."""
    for k, link in enumerate(arm.links, 1):
        yield f"Link.tip_inertia of link {k}", link.tip_inertia
        if link.body is not None:
            yield f"Body.inertia of link {k}", link.body.inertia
    if arm.payload is not None:
        yield "Payload.inertia", arm.payload.inertia


def _warn_if_thick(arm: Arm, stacklevel: int) -> None:
    """Warn once in a process of an arm with links of these lengths."""
    key = (math.nan, *(link.length for link in arm.links))
    for k, link in enumerate(arm.links, 1):
        for direction in BENDING:
            share = neglected(link, direction) if link.in_direction(direction) else ()
            if max(share, default=0.0) > NEGLECTED and key not in _told:
                _told.add(key)
                warnings.warn(
                    f"Link {k} is thick: shear and rotary inertia, which are neglected, lower its "
                    f"first two bending frequencies along {direction} by {share[0]:.1%} and "
                    f"{share[1]:.1%}, with {_source(link)}; the model's are too "
                    "high by as much.",
                    ThickLinkWarning,
                    stacklevel=stacklevel + 1,
                )


def neglected(link: Link, direction: str) -> tuple[float, ...]:
    """(2,) shares of the first two bending frequencies of a clamped link with its tip body."""
    try:
        return _softening(link, direction)
    except ValueError:  # a tip too heavy for its mode shapes
        return ()


def _source(link: Link) -> str:
    """Source of the radius of gyration, in words."""
    if link.mean("EA"):
        return "Link.EA"
    if link.mean("rho_Ip") and link.mean("EIz") and link.mean("EIy"):
        return "Link.rho_Ip"
    return "the speed of sound of a metal (EA is not stated)"


def _gyration(link: Link, direction: str, x: Array) -> Array:
    """(n,) [m^2] square of the radius of gyration about the axis of bending, at x."""
    EI, rho_A = link.at(STIFFNESS[direction], x), link.at("rho_A", x)
    source = _source(link)
    if source == "Link.EA":
        return EI / link.at("EA", x)
    if source == "Link.rho_Ip":
        own = EI / (link.at("EIz", x) + link.at("EIy", x))
        return own * link.at("rho_Ip", x) / rho_A
    return EI / rho_A / SOUND**2


@lru_cache(maxsize=256)
def _softening(link: Link, direction: str) -> tuple[float, float]:
    """Neglected shares."""
    axis, result, beam = {"y": 2, "z": 1}[direction], [], link.beam
    for index in (1, 2):
        mode = Mode(kind="clamped-tip-mass", index=index, direction=direction)
        s = shape(mode, beam)
        assert isinstance(s, BeamShape | PieceShape)
        x, weights = points(beam, (mode,))
        gyration, rho_A = _gyration(link, direction, x), link.at("rho_A", x)
        EI, change = link.at(STIFFNESS[direction], x), np.zeros(x.size)
        if link.sections:
            change = rate(link.sections, STIFFNESS[direction], x)
        force = EI * s.third(x) + change * s.curvature(x)
        shear = weights @ (gyration * force**2 / EI) / (weights @ (EI * s.curvature(x) ** 2))
        mass = weights @ (rho_A * s.value(x) ** 2) + beam.tip_mass * s.value(beam.length) ** 2
        mass += beam.tip_inertia[axis][axis] * s.slope(beam.length) ** 2
        turning = weights @ (rho_A * gyration * s.slope(x) ** 2) / mass
        result.append(float(1.0 - 1.0 / np.sqrt(1.0 + SHEAR * shear + turning)))
    return result[0], result[1]


def _oddities(link: Link) -> Iterator[str]:
    """Quantities of a link that no arm has."""
    least, most = LENGTHS
    offset = max(math.hypot(*link.joint.offset), math.hypot(*link.joint.root))
    if link.length > most or 0.0 < link.length < least:
        yield f"a length of {link.length:g} m"
    elif offset > most:
        yield f"a joint offset of {offset:g} m"
    mass = link.beam.line_mass.mass + link.tip_mass + (link.body.mass if link.body else 0.0)
    if mass > HEAVIEST:
        yield f"a mass of {mass:g} kg"
    if link.damping_ratio > 1.0:
        yield f"a damping_ratio of {link.damping_ratio:g}, more than critical"
    for direction in BENDING:
        if link.in_direction(direction):
            frequency = clamped_frequency(link, link.tip_rigidity(direction))
            if not FREQUENCIES[0] <= frequency <= FREQUENCIES[1]:
                yield f"a first bending frequency of {frequency:.3g} Hz along {direction}"


def clamped_frequency(link: Link, EI: float) -> float:
    """First bending frequency [Hz] of a clamped link with its tip mass; 2 % high without one."""
    moving = 33.0 / 140.0 * link.beam.line_mass.mass + link.tip_mass  # Rayleigh's quotient
    return math.sqrt(3.0 * EI / (moving * link.length**3)) / (2.0 * math.pi)
