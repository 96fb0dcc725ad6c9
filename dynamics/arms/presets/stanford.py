"""Stanford arm: five revolute joints and a prismatic one, rigid links.

The data are from the table of Cyril's FLEXLINK thesis, after Kane and Levinson (1983), read from a
scan. Doubtful digits: the mass of link 1 (9.0 or 9.6 kg), its centre of mass and its three moments
of inertia. Link 1 only turns about its own axis, so of these only its moment about z affects
motion, and gravity along the axis has no effect on it. Frames and signs follow
`dynamics.description.denavit_hartenberg`, with joint 1 vertical. The coordinate of joint 3 is the
thesis's d3.
"""

from math import pi

from dynamics.arms.checks import Check
from dynamics.arms.inertia import about_axes
from dynamics.arms.measures import holding_load, mass
from dynamics.description import denavit_hartenberg
from dynamics.description.denavit_hartenberg import Row

_TABLE = (
    Row(
        alpha=-pi / 2,  # printed
        mass=9.0,  # doubtful: the scan could say 9.6
        com=(0.0, 0.0, -0.1),  # doubtful
        inertia=about_axes(0.01, 0.01, 0.02),  # all three doubtful
    ),
    Row(d=0.1, alpha=pi / 2, mass=6.0, inertia=about_axes(0.05, 0.01, 0.06)),  # printed
    Row(type="prismatic", mass=4.0, inertia=about_axes(0.4, 0.4, 0.01)),  # printed
    Row(
        d=0.7, alpha=-pi / 2, mass=1.0, com=(0.0, 0.0, -0.1),
        inertia=about_axes(0.001, 0.0005, 0.001),
    ),  # printed
    Row(
        alpha=pi / 2, mass=0.6, com=(0.0, -0.06, 0.0),
        inertia=about_axes(0.0005, 0.0002, 0.0005),
    ),  # printed
    Row(mass=0.5, com=(0.0, 0.0, 0.02), inertia=about_axes(0.003, 0.001, 0.002)),  # printed
)  # fmt: skip

ARM = denavit_hartenberg.arm(
    _TABLE,
    name="stanford",
    description=(
        "The rigid Stanford arm, its third joint prismatic: Kane and Levinson (1983) as tabulated "
        "in Cyril's FLEXLINK thesis; some digits are doubtful."
    ),
    gravity=(0.0, 0.0, -9.81),  # chosen
)

_HAND = "by hand from the table: masses times places along the boom, times 9.81 m/s^2"

CHECKS = (
    Check(
        quantity="mass, with the 9.0 kg of link 1", unit="kg", expected=21.1, tolerance=1e-12,
        source="sum of the table", measure=mass,
    ),
    Check(  # 1.0 (0.7 - 0.1) + 0.6 (0.7 + 0.06) + 0.5 (0.7 + 0.02) = 1.416 kg m
        quantity="joint 2 holds the horizontal boom", unit="N m", expected=13.89096,
        tolerance=1e-9, source=_HAND,
        measure=lambda arm: holding_load(arm, 1, (0.0, pi / 2, 0.0, 0.0, 0.0, 0.0)),
    ),
    Check(  # 4.0 + 1.0 + 0.6 + 0.5 = 6.1 kg
        quantity="joint 3 holds the upright boom", unit="N", expected=59.841, tolerance=1e-9,
        source=_HAND, measure=lambda arm: holding_load(arm, 2, (0.0,) * 6),
    ),
)  # fmt: skip
