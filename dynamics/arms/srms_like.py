"""An arm like the Shuttle's: public geometry and mass, everything elastic tuned.

Shoulder yaw and pitch, elbow pitch, wrist pitch, yaw and roll; stretched along x at zero angles.
Joint stations are public (Orbiter coordinates of a flight simulator's add-on), so are the arm's
mass and its diameter of 15 in (NASA shuttle reference). Boom rigidities, joint stiffness and the
split of the mass are not. Here the mass is spread evenly; EI of both booms is tuned, per plane, so
that the straight, unloaded arm with its joints locked has 0.35 and 0.46 Hz. The tuned EI stand for
booms and joints together, because the joints have no springs of their own here. GJ follows the
tuned EI as a thin tube's would. The roll joint sits at the tip; its link is a millimetre.
"""

from dynamics.arm import Arm, Joint, Link, Mode
from dynamics.checks import Matrix
from dynamics.published import Check, mass, mode_of_arm

_STATIONS = "joint stations in Orbiter coordinates, public flight-simulator source"
_NASA = "NASA shuttle reference: 905 lb"
_BAND = "Smithsonian NASM.2014.0025-bx011-fd006, table 4, row S, rounded"
_POST, _ELBOW_OFFSET = 0.3048, 0.1524  # [m] public: yaw to pitch, elbow
_UPPER, _FORE, _WRIST, _HAND = 6.3767, 7.0599, 0.4572, 1.4224  # [m] public
_STUB = 1e-3  # [m] chosen: a link needs a length
_RADIUS = 7.5 * 0.0254  # [m] public: 15 in diameter
_RHO_A = 410.5 / (_UPPER + _FORE + _WRIST + _HAND + 2.0 * _STUB)  # [kg/m] spread evenly: chosen
_TUNED_EIZ = 5.7693e5  # [N m^2] tuned to 0.35 Hz, pitch plane: benchmarks/tune_presets.py
_TUNED_EIY = 9.9674e5  # [N m^2] tuned to 0.46 Hz, yaw plane
_GJ = (_TUNED_EIY + _TUNED_EIZ) / 2.0 / 1.3  # [N m^2] follows the tuned EI: thin tube, nu 0.3
_RHO_IP = _RHO_A * _RADIUS**2  # [kg m]

_YAW_TO_PITCH: Matrix = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))  # +90 degrees about x
_PITCH_TO_YAW: Matrix = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))  # -90 degrees about x
_YAW_TO_ROLL: Matrix = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))  # z along the arm
_MODES = (
    *(Mode(kind="poly", index=k, direction=direction) for direction in "yz" for k in (1, 2)),
    Mode(kind="torsion-poly", index=1, direction="x"),
)


def _boom(length: float, joint: Joint) -> Link:
    """A flexible tube behind a pitch joint: y lies in the pitch plane, z in the yaw plane."""
    return Link(
        length=length,
        rho_A=_RHO_A,
        EIz=_TUNED_EIZ,
        EIy=_TUNED_EIY,
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
        "EI tuned to 0.35 and 0.46 Hz (straight, locked, unloaded), GJ after it; no joint springs."
    ),
    links=(
        Link(length=_STUB, rho_A=_RHO_A),
        _boom(_UPPER, Joint(rotation=_YAW_TO_PITCH, offset=(-_STUB, 0.0, _POST))),
        _boom(_FORE, Joint(offset=(0.0, -_ELBOW_OFFSET, 0.0))),  # its side is chosen
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
            quantity=f"straight, locked, unloaded, bending in the {plane} plane (EI tuned to it)",
            unit="Hz", expected=expected, tolerance=1e-3, source=_BAND,
            measure=mode_of_arm(k),
        )
        for k, (plane, expected) in enumerate((("pitch", 0.35), ("yaw", 0.46)), 1)
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
