"""Spatial laboratory arm of six aluminium tubes without gravity; every number is chosen.

Stretched along x, it reaches 2.0 m; the joints are yaw, pitch, pitch, yaw, pitch, yaw. Each tube
bends in both planes with both shapes of a beam without mass, the last tube with that under a tip
force: 28 coordinates. The motors outweigh the tubes, whose masses are lumped. `choose_model` takes
this model for a tip error of 1e-3 of the reach at full torque. Stretched, the lowest frequency is
1.66 Hz with joints locked and 6.60 Hz with joints free, the highest is 422 Hz.
"""

from math import pi

from dynamics.arms.checks import Check
from dynamics.arms.inertia import about_axes
from dynamics.arms.measures import mode_of_link
from dynamics.description.arm import FOURTH_ORDER, Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode
from dynamics.description.validate import IDENTITY
from dynamics.types import Matrix3

_YOUNG = 69e9  # [N/m^2] aluminium
_DENSITY = 2700.0  # [kg/m^3] aluminium
_MODES = tuple(Mode(kind="hierarchical", index=k, direction=d) for d in "yz" for k in (1, 2))
_TIP_FORCE = tuple(mode for mode in _MODES if mode.index == 1)

_SAME: Matrix3 = IDENTITY
_YAW_TO_PITCH: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))  # +90 degrees about x
_PITCH_TO_YAW: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))  # -90 degrees about x


def _tube(
    length: float,  # [m]
    diameter: float,  # [m] outer
    wall: float,  # [m]
    tip_mass: float,  # [kg] the next joint's motor; for the last tube a tool
    tip_radius: float,  # [m] of the tip body, a solid sphere
    rotor_inertia: float,  # [kg m^2] of the motor at the root, reflected through its gear
    rotation: Matrix3,
    damping_beta: float,  # [s] 1 % of critical in the first mode of the tube alone, clamped
    modes: tuple[Mode, ...] = _MODES,
) -> Link:
    inner = diameter - 2.0 * wall
    EI = _YOUNG * pi / 64.0 * (diameter**4 - inner**4)
    ball = 0.4 * tip_mass * tip_radius**2
    return Link(
        length=length,
        rho_A=_DENSITY * pi / 4.0 * (diameter**2 - inner**2),
        EIz=EI,
        EIy=EI,
        tip_mass=tip_mass,
        tip_inertia=about_axes(ball, ball, ball),
        modes=modes,
        lumped=True,
        damping_beta=damping_beta,
        joint=Joint(rotation=rotation, rotor_inertia=rotor_inertia),
    )


ARM = Arm(
    name="six-link",
    description=(
        "A synthetic six-link spatial arm of laboratory size: aluminium tubes, motors at the "
        "joints, no gravity. All numbers are chosen, none is measured."
    ),
    foreshortening=FOURTH_ORDER,
    links=(
        _tube(0.30, 0.025, 0.0020, 2.0, 0.050, 0.50, _SAME, 1.06e-4),
        _tube(0.50, 0.022, 0.0020, 1.5, 0.050, 0.50, _YAW_TO_PITCH, 2.43e-4),
        _tube(0.45, 0.020, 0.0015, 1.0, 0.040, 0.30, _SAME, 2.20e-4),
        _tube(0.30, 0.016, 0.0015, 0.7, 0.035, 0.10, _PITCH_TO_YAW, 1.44e-4),
        _tube(0.25, 0.014, 0.0010, 0.5, 0.030, 0.05, _YAW_TO_PITCH, 1.34e-4),
        _tube(0.20, 0.012, 0.0010, 0.5, 0.030, 0.03, _PITCH_TO_YAW, 1.23e-4, _TIP_FORCE),
    ),
)

CHECKS = tuple(
    Check(
        quantity=f"first tube clamped, with the motor at its tip, mode {k}", unit="Hz",
        expected=expected, tolerance=1e-3, source="60 finite beam elements",
        measure=mode_of_link(0, k),
    )
    for k, expected in enumerate((29.997, 329.40), 1)
)  # fmt: skip
