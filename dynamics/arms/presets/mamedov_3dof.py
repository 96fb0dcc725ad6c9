"""Arm of a learning-control study: Mamedov et al., 'Safe Imitation Learning of NMPC', 2022.

A rigid post turns about the vertical; two steel strips move in a plane that turns with it. Their
Kelvin-Voigt damping, beta = 4.5 ms, is the study's normal viscosity. The post turns about its own
axis, so only its inertia matters: the first link is 1 mm long and has the post's inertia as hub.
"""

from dynamics.arms.checks import Check
from dynamics.arms.measures import mode_of_link
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode
from dynamics.description.validate import IDENTITY
from dynamics.types import Matrix3

_SOURCE = "parameter files of the public code, shamilmamedov/flexible_arm"
_LENGTH, _WIDTH, _THICKNESS = 0.5, 0.05, 0.002  # [m] published
_YOUNG, _VISCOSITY = 190e9, 8.511e8  # [N/m^2], [N s/m^2] published
_HEIGHT, _STUB = 0.15, 1e-3  # [m] published height of the post; the stub is chosen
_UP: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))  # +90 degrees about x


def _strip(joint: Joint) -> Link:
    return Link(
        length=_LENGTH,
        rho_A=7870.0 * _WIDTH * _THICKNESS,  # published
        EIz=_YOUNG * _WIDTH * _THICKNESS**3 / 12.0,
        modes=tuple(Mode(kind="clamped-free", index=index, direction="y") for index in (1, 2)),
        damping_beta=_VISCOSITY / _YOUNG,
        joint=joint,
    )


ARM = Arm(
    name="mamedov-3dof",
    description=(
        "A turning post and two steel strips under gravity: Mamedov et al., 'Safe Imitation "
        "Learning of Nonlinear Model Predictive Control for Flexible Robots', 2022."
    ),
    gravity=(0.0, 0.0, -9.81),  # value chosen
    links=(
        Link(length=_STUB, rho_A=1e-3, joint=Joint(hub_inertia=0.01125)),  # published: izz
        _strip(Joint(rotation=_UP, offset=(-_STUB, 0.0, _HEIGHT))),
        _strip(Joint(rotation=IDENTITY)),
    ),
)

CHECKS = (
    Check(
        quantity="EI over length: spring of the one-segment model", unit="N m/rad",
        expected=12.67, tolerance=1e-3, source=_SOURCE,
        measure=lambda arm: (arm.links[1].EIz or 0.0) / arm.links[1].length,
    ),
    Check(
        quantity="its damper", unit="N m s/rad", expected=0.0567, tolerance=2e-3, source=_SOURCE,
        measure=lambda arm: arm.links[1].damping_beta * (arm.links[1].EIz or 0.0) / _LENGTH,
    ),
    Check(
        quantity="mass of a strip", unit="kg", expected=2 * 0.19675, tolerance=1e-6,
        source=_SOURCE, measure=lambda arm: arm.links[2].rho_A * arm.links[2].length,
    ),
    *(
        Check(
            quantity=f"strip clamped, mode {k}", unit="Hz", expected=expected, tolerance=5e-3,
            source="40 finite beam elements",
            measure=mode_of_link(1, k, 6, "clamped-free"),
        )
        for k, expected in enumerate((6.35, 39.8, 111.0), 1)
    ),
)  # fmt: skip
