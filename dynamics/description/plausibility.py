"""Arms whose numbers are those of no arm, as after a mistake of units: a warning where one is read.

A length in mm makes a link a thousand times longer and its first frequency a millionth. Thresholds
lie beyond space cranes (15 m, 0.1 Hz) and micro arms (a few mm, a few kHz).
"""

import math
import warnings
from collections.abc import Iterator

from dynamics.description.arm import Arm
from dynamics.description.link import Link

LENGTHS = (1e-3, 100.0)  # [m] of a link, or of a joint's offset
HEAVIEST = 1e5  # [kg] link with its tip and body
FREQUENCIES = (0.01, 1e5)  # [Hz] first bending mode of a clamped link with its tip
_told: set[tuple[float, ...]] = set()  # lengths of the links of arms that were warned of


class ImplausibleArmWarning(UserWarning):
    """Lengths, masses or frequencies of an arm are those of no arm: perhaps not in SI units."""


def warn_if_implausible(arm: Arm, stacklevel: int) -> None:
    """Warn once in a process of an arm with links of these lengths."""
    found = [(k, text) for k, link in enumerate(arm.links, 1) for text in _oddities(link)]
    lengths = tuple(link.length for link in arm.links)
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
