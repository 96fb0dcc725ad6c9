"""PUMA-600 arm: six revolute joints, rigid links.

The data are from the table of Cyril's FLEXLINK thesis, read from a scan; all digits are legible.
Frames and signs follow `dynamics.description.denavit_hartenberg`, with joint 1 vertical. In those
frames the mass centres of links 3 and 5 lie opposite to the next joint (y = -0.191 m, with joint 4
at +0.432 m): their signs, or those of d, may belong to another convention. They are used as
printed.
"""

from math import pi

from dynamics.arms.checks import Check
from dynamics.arms.inertia import about_axes
from dynamics.arms.measures import holding_load, mass
from dynamics.description import denavit_hartenberg
from dynamics.description.denavit_hartenberg import Row

_TABLE = (  # printed
    Row(
        alpha=-pi / 2, mass=10.521, com=(0.0, -0.054, 0.0),
        inertia=about_axes(1.612, 0.5091, 1.612),
    ),
    Row(
        a=0.432, d=-0.149, mass=15.781, com=(0.14, 0.0, 0.0),
        inertia=about_axes(0.4898, 8.0783, 8.2672),
    ),
    Row(
        a=0.02, alpha=pi / 2, mass=8.767, com=(0.0, -0.191, 0.0),
        inertia=about_axes(3.3768, 0.3009, 3.3768),
    ),
    Row(
        d=-0.432, alpha=-pi / 2, mass=1.052, com=(0.0, 0.0, -0.051),
        inertia=about_axes(0.181, 0.181, 0.1273),
    ),
    Row(
        alpha=pi / 2, mass=1.052, com=(0.0, -0.007, 0.0),
        inertia=about_axes(0.0735, 0.0735, 0.1273),
    ),
    Row(
        d=-0.056, mass=0.351, com=(0.0, 0.0, -0.019),
        inertia=about_axes(0.0071, 0.0071, 0.0141),
    ),
)  # fmt: skip

ARM = denavit_hartenberg.arm(
    _TABLE,
    name="puma-600",
    description=(
        "The rigid PUMA-600 arm as tabulated in Cyril's FLEXLINK thesis; the signs of two mass "
        "centres are doubtful."
    ),
    gravity=(0.0, 0.0, -9.81),  # chosen
)

CHECKS = (
    Check(
        quantity="mass", unit="kg", expected=37.524, tolerance=1e-12, source="sum of the table",
        measure=mass,
    ),
    Check(  # 15.781 0.14 + 8.767 0.432 + (1.052 + 1.052 + 0.351) (0.432 + 0.02) = 7.106344 kg m
        quantity="joint 2 holds the stretched arm", unit="N m", expected=69.71323464,
        tolerance=1e-9, source="by hand from the table: masses times places, times 9.81 m/s^2",
        measure=lambda arm: holding_load(arm, 1, (0.0,) * 6),
    ),
)  # fmt: skip
