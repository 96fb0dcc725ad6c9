"""Quanser 2-DOF serial flexible link: two steel strips behind harmonic drives.

Published are the strips, the drives and the lumped inertias of each stage. Here the strips are
uniform beams, and the body at the tip of the first strip is chosen so that, with the second stage
stretched, the inertia about the first axis is the published one. The published model lumps each
stage on a torsion spring, so its resonances differ from those of beams: with the joints locked the
first is 1.69 Hz here. Current limits and encoders are not part of the arm.
"""

from dynamics.arms.checks import Check
from dynamics.arms.inertia import about_axes
from dynamics.arms.measures import carried_inertia, tip_spring
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_SOURCE = "Quanser set-up script config_2dslf and reference manual 763"
_INCH = 0.0254  # [m]
_YOUNG = 30e6 * 6894.757  # [N/m^2] published: steel, 30e6 psi
_DENSITY = 7850.0  # [kg/m^3] steel; not published
_LENGTHS = (0.202, 0.20185)  # [m] published
_FIRST_INERTIA = 0.18028257 - 1.578 * 0.079**2  # [kg m^2] published: all that strip 1 carries
_END = (0.157, 0.157 * (0.0445**2 + 0.0224**2) / 12.0)  # [kg], [kg m^2] published: end-effector
_DRIVES = (  # published: drive inertia, fixture, friction at the output
    Joint(rotor_inertia=100**2 * 6.28e-6, hub_inertia=7.3616e-4, viscous=4.0),
    Joint(rotor_inertia=50**2 * 1.03e-6, hub_inertia=4.4455e-4, viscous=1.5),
)
_MODES = tuple(Mode(kind="clamped-tip-mass", index=index, direction="y") for index in (1, 2))


def _strip(width: float, thickness: float) -> tuple[float, float]:
    """rho_A [kg/m] and EI [N m^2] of a steel strip; width and thickness in inches."""
    b, h = width * _INCH, thickness * _INCH
    return _DENSITY * b * h, _YOUNG * b * h**3 / 12.0


def _elbow(rho_A: float) -> tuple[float, float]:
    """Mass [kg] and inertia [kg m^2] of the tip body of strip 1: published less second stage."""
    first, second = _LENGTHS
    mass = 1.578 - rho_A * second - _END[0]  # published: 1.578 kg with the second stage
    outer = rho_A * ((first + second) ** 3 - first**3) / 3.0
    outer += _END[0] * (first + second) ** 2 + _END[1] + _DRIVES[1].hub_inertia
    return mass, _FIRST_INERTIA - outer - mass * first**2


_FIRST, _SECOND = _strip(3.0, 0.050), _strip(1.5, 0.035)  # published
_ELBOW = _elbow(_SECOND[0])

ARM = Arm(
    name="quanser-2dsfl",
    description=(
        "Two steel strips in series behind harmonic drives: Quanser 2-DOF Serial Flexible Link, "
        "data of its set-up script and manual; the elbow's inertia is what they leave for it."
    ),
    links=(
        Link(
            length=_LENGTHS[0],
            rho_A=_FIRST[0],
            EIz=_FIRST[1],
            tip_mass=_ELBOW[0],
            tip_inertia=about_axes(z=_ELBOW[1]),
            modes=_MODES,
            damping_ratio=0.005,  # chosen; published as neglected
            joint=_DRIVES[0],
        ),
        Link(
            length=_LENGTHS[1],
            rho_A=_SECOND[0],
            EIz=_SECOND[1],
            tip_mass=_END[0],
            tip_inertia=about_axes(z=_END[1]),
            modes=_MODES,
            damping_ratio=0.005,  # chosen
            joint=_DRIVES[1],
        ),
    ),
)


def _carried(arm: Arm) -> float:
    """Inertia [kg m^2] about the first axis without the first drive and the first strip."""
    link = arm.links[0]
    own = link.joint.rotor_inertia + link.joint.hub_inertia + link.rho_A * link.length**3 / 3.0
    return carried_inertia(arm, 0) - own


CHECKS = (
    Check(
        quantity="first strip, tip spring", unit="N m/rad", expected=39.96, tolerance=1e-3,
        source=_SOURCE, measure=lambda arm: tip_spring(arm, 0),
    ),
    Check(
        quantity="second strip, tip spring", unit="N m/rad", expected=6.858, tolerance=1e-3,
        source=_SOURCE, measure=lambda arm: tip_spring(arm, 1),
    ),
    Check(
        quantity="carried by the first strip, stretched", unit="kg m^2", expected=0.17043,
        tolerance=1e-3, source=_SOURCE, measure=_carried,
    ),
    Check(
        quantity="end-effector about the second axis", unit="kg m^2", expected=0.0064,
        tolerance=0.01, source=_SOURCE,
        measure=lambda arm: arm.links[1].tip_mass * arm.links[1].length ** 2 + _END[1],
    ),
    Check(
        quantity="first drive at its output", unit="kg m^2", expected=0.0635, tolerance=5e-3,
        source=_SOURCE + ": 100^2 times 6.28e-6 and the fixture; its comment, 0.0109, is stale",
        measure=lambda arm: arm.links[0].joint.rotor_inertia + arm.links[0].joint.hub_inertia,
    ),
)  # fmt: skip
