"""Warnings where an arm is read: numbers of no arm, as after a mistake of units, and thick links.

A length in mm makes a link a thousand times longer and its first frequency a millionth. Thresholds
lie beyond space cranes (15 m, 0.1 Hz) and micro arms (a few mm, a few kHz).

Euler and Bernoulli's beam neglects shear and rotary inertia, which lower the frequencies of short,
thick links: Timoshenko, "On the correction for shear" (1921). To first order the share of a mode is

    1/2 r^2 (E/kG int s_xxx^2 / int s_xx^2 + rho_A int s_x^2 / modal mass)

with the radius of gyration r of the section, r^2 = EI / EA.
"""

import math
import warnings
from collections.abc import Iterator
from functools import lru_cache

from dynamics.description.arm import Arm
from dynamics.description.beams.uniform import BeamShape
from dynamics.description.link import Link
from dynamics.description.mode_shapes import STIFFNESS, Beam, Mode, quadrature, shape

LENGTHS = (1e-3, 100.0)  # [m] of a link, or of a joint's offset
HEAVIEST = 1e5  # [kg] link with its tip and body
FREQUENCIES = (0.01, 1e5)  # [Hz] first bending mode of a clamped link with its tip
NEGLECTED = 0.01  # [-] share of a frequency, from which a link is thick
SHEAR = 2.6 / 0.85  # [-] E / kG of a rectangle, Poisson's ratio 0.3
SOUND = 5000.0  # [m/s] in a bar of steel or aluminium: EA of a link that states none
_told: set[tuple[float, ...]] = set()  # lengths of the links of arms that were warned of


class ImplausibleArmWarning(UserWarning):
    """Lengths, masses or frequencies of an arm are those of no arm: perhaps not in SI units."""


class ThickLinkWarning(UserWarning):
    """Shear and rotary inertia, which the beams neglect, matter in a link's first frequencies."""


def warn_if_implausible(arm: Arm, stacklevel: int) -> None:
    """Warn once in a process of an arm with links of these lengths."""
    found = [(k, text) for k, link in enumerate(arm.links, 1) for text in _oddities(link)]
    lengths = tuple(link.length for link in arm.links)
    if not found:
        _warn_if_thick(arm, stacklevel + 1)
    if not found or lengths in _told:
        return
    _told.add(lengths)
    k, text = found[0]
    name = f"The arm {arm.name!r}" if arm.name else "The arm"
    count = len({link for link, _ in found})
    also = f", and {count} links are implausible" if count > 1 else ""
    warnings.warn(
        f"{name} may not be in SI units: link {k} has {text}{also}. Give lengths in m, masses in "
        "kg, mass per length in kg/m and EI in N m^2; if they are, ignore this warning.",
        ImplausibleArmWarning,
        stacklevel=stacklevel + 1,
    )


def _warn_if_thick(arm: Arm, stacklevel: int) -> None:
    """Warn once in a process of an arm with links of these lengths."""
    key = (math.nan, *(link.length for link in arm.links))
    for k, link in enumerate(arm.links, 1):
        for direction, stated in (("y", link.EIz), ("z", link.EIy)):
            share = neglected(link, direction) if stated and link.in_direction(direction) else ()
            if max(share, default=0.0) > NEGLECTED and key not in _told:
                _told.add(key)
                warnings.warn(
                    f"Link {k} is thick: shear and rotary inertia, which are neglected, lower its "
                    f"first two bending frequencies along {direction} by {share[0]:.1%} and "
                    f"{share[1]:.1%}, with {_section(link, direction)[1]}; the model's are too "
                    "high by as much.",
                    ThickLinkWarning,
                    stacklevel=stacklevel + 1,
                )


def neglected(link: Link, direction: str) -> tuple[float, ...]:
    """(2,) shares of the first two bending frequencies of a clamped link with its tip body."""
    gyration = _section(link, direction)[0]
    try:
        return tuple(0.5 * gyration**2 * x for x in _softening(link.beam, direction))
    except ValueError:  # a tip too heavy for its mode shapes
        return ()


def _section(link: Link, direction: str) -> tuple[float, str]:
    """Radius of gyration [m] of a section about the axis of bending, and its source in words."""
    EI = getattr(link, STIFFNESS[direction])
    if link.EA:
        return math.sqrt(EI / link.EA), "Link.EA"
    if link.rho_Ip and link.EIz and link.EIy:
        own = EI / (link.EIz + link.EIy)
        return math.sqrt(own * link.rho_Ip / link.rho_A), "Link.rho_Ip"
    return math.sqrt(EI / link.rho_A) / SOUND, "the speed of sound of a metal (EA is not stated)"


@lru_cache(maxsize=256)
def _softening(beam: Beam, direction: str) -> tuple[float, float]:
    """[1/m^2] twice the neglected shares over the square of the radius of gyration."""
    axis = {"y": 2, "z": 1}[direction]
    result = []
    for index in (1, 2):
        mode = Mode(kind="clamped-tip-mass", index=index, direction=direction)
        s = shape(mode, beam)
        assert isinstance(s, BeamShape)
        x, weights = quadrature(beam.length, (mode,))
        value, slope, bend, shear = (
            float(weights @ f(x) ** 2) for f in (s.value, s.slope, s.curvature, s.third)
        )
        mass = beam.rho_A * value + beam.tip_mass * float(s.value(beam.length)) ** 2
        mass += beam.tip_inertia[axis][axis] * float(s.slope(beam.length)) ** 2
        result.append(SHEAR * shear / bend + beam.rho_A * slope / mass)
    return result[0], result[1]


def _oddities(link: Link) -> Iterator[str]:
    """Quantities of a link that no arm has."""
    least, most = LENGTHS
    offset = max(math.hypot(*link.joint.offset), math.hypot(*link.joint.root))
    if link.length > most or 0.0 < link.length < least:
        yield f"a length of {link.length:g} m"
    elif offset > most:
        yield f"a joint offset of {offset:g} m"
    mass = link.rho_A * link.length + link.tip_mass + (link.body.mass if link.body else 0.0)
    if mass > HEAVIEST:
        yield f"a mass of {mass:g} kg"
    for direction, EI in (("y", link.EIz), ("z", link.EIy)):
        if EI and link.in_direction(direction):
            frequency = clamped_frequency(link, EI)
            if not FREQUENCIES[0] <= frequency <= FREQUENCIES[1]:
                yield f"a first bending frequency of {frequency:.3g} Hz along {direction}"


def clamped_frequency(link: Link, EI: float) -> float:
    """First bending frequency [Hz] of a clamped link with its tip mass; 2 % high without one."""
    moving = 33.0 / 140.0 * link.rho_A * link.length + link.tip_mass  # Rayleigh's quotient
    return math.sqrt(3.0 * EI / (moving * link.length**3)) / (2.0 * math.pi)
