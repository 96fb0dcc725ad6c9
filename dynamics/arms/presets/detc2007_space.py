"""Space manipulator's boom on a free hinge: MacLean, Huynh and Quiocho, DETC2007-35511.

The paper compares boundary conditions for the shapes of a boom with a heavy load; hinged shapes
that include the load suit it. Three clamped shapes that include it give the first two hinged
frequencies within 0.3 %; the checks use twelve. The paper's fourth wave number does not match its
fourth frequency, which is right.
"""

from collections.abc import Callable
from math import pi

from dynamics.arms.checks import Check
from dynamics.arms.measures import mode_of_link
from dynamics.description.arm import Arm
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_LENGTH, _RHO_A = 3.372, 2.82  # [m], [kg/m] published
_SOURCE = "DETC2007-35511, table 2, through a public MBDyn test by Masarati"
_RAD_S = (5.28, 20.9, 46.7, 83.4)  # [rad/s] published

ARM = Arm(
    name="detc2007-space",
    description=(
        "A boom with five times its mass at the tip on a free hinge in weightlessness: MacLean, "
        "Huynh and Quiocho, DETC2007-35511."
    ),
    links=(
        Link(
            length=_LENGTH,
            rho_A=_RHO_A,
            EIz=5.974**2 * _RHO_A,  # published as 5.974 m^2/s, root of EI over mass per length
            tip_mass=5.18 * _RHO_A * _LENGTH,  # published
            modes=tuple(
                Mode(kind="clamped-tip-mass", index=index, direction="y") for index in (1, 2, 3)
            ),
            damping_ratio=0.005,  # chosen: none is published
        ),
    ),
)


def _rate(mode: int) -> Callable[[Arm], float]:
    """Frequency [rad/s] of the boom on its free hinge."""
    measure = mode_of_link(0, mode, 12, joints="free")
    return lambda arm: 2.0 * pi * measure(arm)


CHECKS = (
    *(
        Check(
            quantity=f"hinged, mode {k}", unit="rad/s", expected=printed, tolerance=5e-3,
            source=_SOURCE, measure=_rate(k),
        )
        for k, printed in enumerate(_RAD_S, 1)
    ),
    *(
        Check(
            quantity=f"clamped, mode {k}", unit="Hz", expected=expected, tolerance=1e-3,
            source="frequency equation of a beam with a tip mass", measure=mode_of_link(0, k),
        )
        for k, expected in enumerate((0.0622, 1.304, 4.194, 8.733), 1)
    ),
)  # fmt: skip
