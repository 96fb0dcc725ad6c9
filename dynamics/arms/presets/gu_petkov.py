"""Flexible-link example of a robust-control book: Gu, Petkov and Konstantinov (2005).

An aluminium strip with a payload on a hub. In the book the strip's root is 0.04 m off the axis;
here it is at the axis. The tip body is the book's nominal payload, which varies by 40 % there.
"""

from dynamics.arms.checks import Check
from dynamics.arms.measures import mode_of_link
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_WIDTH, _THICKNESS = 0.05, 0.004  # [m] published
_SOURCE = "Gu, Petkov and Konstantinov, 'Robust Control Design with MATLAB', files of chapter FLM"

ARM = Arm(
    name="gu-petkov",
    description=(
        "One aluminium strip with a payload on a hub: Gu, Petkov and Konstantinov, 'Robust "
        "Control Design with MATLAB', 2005; the root's 0.04 m from the axis are left out."
    ),
    links=(
        Link(
            length=1.0,  # published
            rho_A=2700.0 * _WIDTH * _THICKNESS,  # published
            EIz=69e9 * _WIDTH * _THICKNESS**3 / 12.0,  # published
            tip_mass=0.25,  # published: nominal payload
            modes=tuple(
                Mode(kind="clamped-tip-mass", index=index, direction="y") for index in (1, 2)
            ),
            damping_ratio=0.01,  # chosen: the book's damping factors belong to its own shapes
            joint=Joint(hub_inertia=0.1, viscous=0.15),  # published
        ),
    ),
)

CHECKS = (
    Check(
        quantity="strip and payload clamped, first", unit="Hz", expected=1.92, tolerance=3e-3,
        source="40 finite beam elements", measure=mode_of_link(0, 1),
    ),
    Check(
        quantity="strip and payload clamped, second", unit="Hz", expected=15.8, tolerance=3e-3,
        source="40 finite beam elements", measure=mode_of_link(0, 2),
    ),
)  # fmt: skip
