"""Two flexible links on a satellite that floats in a plane, as on an air table; synthetic.

The satellite is a solid cube of 1 m and 40 kg. The stretched arm has almost one and a half times
its inertia, so that the satellite turns visibly when the arm moves. The links are aluminium strips
of 1 m that bend in the plane of the motion, with a motor at the elbow and a gripper at the tip.
Strain wave gears of 160 turn the rotors of frameless motors, without which the elbow would have no
inertia on the side of the first link (see two_link.py).

Both links bend to fourth order, with both shapes of a beam without mass: the tip stays within a
thousandth of the reach in whole episodes at full torque.
"""

from dynamics.arms.checks import Check
from dynamics.arms.inertia import about_axes
from dynamics.arms.measures import mode_of_link
from dynamics.description.arm import FOURTH_ORDER, Arm, Base
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_SIDE, _MASS = 1.0, 40.0  # [m], [kg] chosen: a small satellite
_INERTIA = _MASS * _SIDE**2 / 6.0  # [kg m^2] of a solid cube about each axis
_E, _DENSITY = 70e9, 2700.0  # [N/m^2], [kg/m^3] aluminium
_WIDE, _THICK = 0.1, 0.003  # [m] chosen: first free frequencies of a few Hz
_ROTOR, _GEAR = 1e-5, 160.0  # [kg m^2], [-] chosen: a frameless motor of 70 mm, a strain wave gear
_ELBOW, _GRIPPER = 1.0, 0.5  # [kg] chosen: a motor with its gear, a small gripper


def _strip(offset: float, tip_mass: float, damping_beta: float) -> Link:
    """Strip of 1 m with a mass [kg] at its tip, `offset` [m] behind the tip of what carries it."""
    return Link(
        length=1.0,
        rho_A=_DENSITY * _WIDE * _THICK,
        EIz=_E * _WIDE * _THICK**3 / 12.0,
        tip_mass=tip_mass,
        modes=tuple(Mode(kind="hierarchical", index=k, direction="y") for k in (1, 2)),
        damping_beta=damping_beta,
        joint=Joint(offset=(offset, 0.0, 0.0), rotor_inertia=_ROTOR * _GEAR**2),
    )


ARM = Arm(
    name="free-flyer",
    description=(
        "A satellite that floats in a plane without friction and carries two soft aluminium "
        "links. All numbers are chosen, none is measured."
    ),
    base=Base(
        type="planar",
        mass=_MASS,
        inertia=about_axes(_INERTIA, _INERTIA, _INERTIA),
    ),
    foreshortening=FOURTH_ORDER,
    # [s] damping_beta chosen: 1 % of critical in the first mode of each link, clamped, alone
    links=(_strip(0.5 * _SIDE, _ELBOW, 3.18e-3), _strip(0.0, _GRIPPER, 2.42e-3)),
)

CHECKS = tuple(
    Check(
        quantity=f"first link alone, clamped, with the motor at its tip, mode {k}", unit="Hz",
        expected=expected, tolerance=1e-3,
        source="frequency equation of a uniform beam with a tip mass", measure=mode_of_link(0, k),
    )
    for k, expected in enumerate((1.00211, 11.3046), 1)
)  # fmt: skip
