"""Arm like the Space Shuttle's: public geometry and mass, tuned elasticity.

The joints are shoulder yaw and pitch, elbow pitch, wrist pitch, yaw and roll; at zero angles the
arm is stretched along x. Public are the joint stations (Orbiter coordinates of a flight simulator's
add-on), the arm's mass and its diameter of 15 in (NASA shuttle reference). Boom rigidities, joint
stiffness and the mass distribution are not public. Here the mass is spread evenly.

Four numbers are tuned: one EI for both booms and both planes, and the springs of shoulder yaw,
shoulder pitch and elbow. With them the straight, unloaded arm with locked rotors and flexing joint
springs has 0.35, 0.46, 3.554 and 4.228 Hz. GJ follows from EI as for a thin tube. The published
fifth and sixth frequencies, 14.98 and 15.14 Hz, were not used for tuning; here they are 13.86 and
14.13 Hz. The wrist has no springs, and the rotor inertia is chosen. The roll joint is at the tip;
its link is 1 mm long.
"""

from dataclasses import replace

from dynamics.arms.checks import Check
from dynamics.arms.measures import mass, mode_of_arm
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode
from dynamics.types import Matrix3

_STATIONS = "joint stations in Orbiter coordinates, public flight-simulator source"
_NASA = "NASA shuttle reference: 905 lb"
_BAND = "Smithsonian NASM.2014.0025-bx011-fd006, table 4, row S"
_POST, _ELBOW_OFFSET = 0.3048, 0.1524  # [m] public: yaw to pitch, elbow
_UPPER, _FORE, _WRIST, _HAND = 6.3767, 7.0599, 0.4572, 1.4224  # [m] public
_STUB = 1e-3  # [m] chosen: a link needs a length
_RADIUS = 7.5 * 0.0254  # [m] public: 15 in diameter
_RHO_A = 410.5 / (_UPPER + _FORE + _WRIST + _HAND + 2.0 * _STUB)  # [kg/m] spread evenly: chosen
_TUNED_EI = 3.7568e6  # [N m^2] this and the springs: benchmarks.accuracy.tune_presets
_TUNED_SPRINGS = (3.6219e5, 1.8627e5, 1.6209e6)  # [N m/rad] shoulder yaw, shoulder pitch, elbow
_GJ = _TUNED_EI / 1.3  # [N m^2] follows the tuned EI: thin tube, nu 0.3
_ROTOR = 500.0  # [kg m^2] of these three joints, reflected through their gears: chosen
_RHO_IP = _RHO_A * _RADIUS**2  # [kg m]

_YAW_TO_PITCH: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))  # +90 degrees about x
_PITCH_TO_YAW: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))  # -90 degrees about x
_YAW_TO_ROLL: Matrix3 = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))  # z along the arm
_MODES = (
    *(Mode(kind="poly", index=k, direction=direction) for direction in "yz" for k in (1, 2)),
    Mode(kind="torsion-poly", index=1, direction="x"),
)


_YAW, _PITCH, _ELBOW = (Joint(stiffness=k, rotor_inertia=_ROTOR) for k in _TUNED_SPRINGS)


def _boom(length: float, joint: Joint) -> Link:
    """Flexible tube behind a pitch joint: y is in the pitch plane, z in the yaw plane."""
    return Link(
        length=length,
        rho_A=_RHO_A,
        EIz=_TUNED_EI,
        EIy=_TUNED_EI,
        GJ=_GJ,
        rho_Ip=_RHO_IP,
        modes=_MODES,
        damping_ratio=0.005,  # chosen
        joint=joint,
    )


ARM = Arm(
    name="srms-like",
    description=(
        "Six joints, two long booms in weightlessness: the Shuttle arm's public geometry and mass; "
        "EI and joint springs tuned to its lowest four frequencies (straight, held, unloaded)."
    ),
    links=(
        Link(length=_STUB, rho_A=_RHO_A, joint=_YAW),
        _boom(_UPPER, replace(_PITCH, rotation=_YAW_TO_PITCH, offset=(-_STUB, 0.0, _POST))),
        _boom(_FORE, replace(_ELBOW, offset=(0.0, -_ELBOW_OFFSET, 0.0))),  # its side is chosen
        Link(length=_WRIST, rho_A=_RHO_A, rho_Ip=_RHO_IP),
        Link(length=_HAND, rho_A=_RHO_A, joint=Joint(rotation=_PITCH_TO_YAW)),
        Link(
            length=_STUB,
            rho_A=_RHO_A,
            joint=Joint(rotation=_YAW_TO_ROLL, hub_inertia=_RHO_IP * _HAND),  # the hand rolls
        ),
    ),
)

CHECKS = (
    *(
        Check(
            quantity=f"straight, held, unloaded, mode {k} (EI and springs tuned to it)",
            unit="Hz", expected=expected, tolerance=1e-3, source=_BAND + rounded,
            measure=mode_of_arm(k),
        )
        for k, (expected, rounded) in enumerate(
            ((0.35, ", rounded"), (0.46, ", rounded"), (3.554, ""), (4.228, "")), 1
        )
    ),
    Check(
        quantity="mass", unit="kg", expected=410.5, tolerance=1e-3, source=_NASA, measure=mass
    ),
    Check(
        quantity="shoulder pitch to tip, 603 in", unit="m", expected=15.316, tolerance=1e-3,
        source=_STATIONS,
        measure=lambda arm: sum(link.length for link in arm.links),
    ),
)  # fmt: skip
