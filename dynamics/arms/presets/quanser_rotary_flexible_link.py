"""Quanser rotary flexible link: a steel ruler on a geared servo, a teaching rig.

The published model is a rigid ruler on a torsion spring that gives the measured 3.0 Hz. Here the
ruler is a uniform beam with EI tuned to 3.0 Hz; its higher frequencies are predictions. The servo's
voltage, gear and limits are not part of the arm.
"""

from dynamics.arms.checks import Check
from dynamics.arms.measures import carried_inertia, mode_of_link
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_LENGTH = 0.381  # [m] 15 in, published
_MASS = 0.065  # [kg] published
_SERVO = 2.08e-3 + 2e-4  # [kg m^2] published: servo in high gear, and the clamp
_SOURCE = "Quanser set-up scripts config_flexgage_exp, config_servo_exp"

ARM = Arm(
    name="quanser-rotary-flexible-link",
    description=(
        "A steel ruler on a servo: Quanser Rotary Flexible Link, data of its set-up scripts; "
        "uniform, EI tuned to the measured 3.0 Hz."
    ),
    links=(
        Link(
            length=_LENGTH,
            rho_A=_MASS / _LENGTH,
            EIz=0.10332,  # tuned to 3.0 Hz: benchmarks.accuracy.tune_presets
            modes=tuple(Mode(kind="clamped-free", index=index, direction="y") for index in (1, 2)),
            damping_ratio=0.01,  # chosen: none is published
            joint=Joint(rotor_inertia=_SERVO, viscous=4e-3),  # published
        ),
    ),
)

CHECKS = (
    Check(
        quantity="ruler clamped, first (EI tuned to it)", unit="Hz", expected=3.0, tolerance=1e-3,
        source=_SOURCE, measure=mode_of_link(0, 1),
    ),
    Check(
        quantity="ruler about its root", unit="kg m^2", expected=3.145e-3, tolerance=1e-3,
        source=_SOURCE + ": m L^2 / 3",
        measure=lambda arm: carried_inertia(arm, 0) - arm.links[0].joint.rotor_inertia,
    ),
    Check(
        quantity="ruler clamped, second", unit="Hz", expected=18.8, tolerance=3e-3,
        source="40 finite beam elements", measure=mode_of_link(0, 2),
    ),
)  # fmt: skip
