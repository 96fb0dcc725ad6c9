"""Arm like RALF, the large two-link arm of Yuan, Book and Huggins (1993), from printed data.

Printed are two hollow cylindrical links of 10 ft and about 70 lb in total, and a parallel drive of
the second joint: neither the rotation nor the bending of link 1 turns link 2. Their cross-section
is not known. The mass is therefore spread evenly, the drive link is massless, and EI is tuned so
that the first frequency is the measured 6.37 Hz at the chosen posture, elbow at 90 degrees and
joints locked. The second frequency is then 14.4 Hz, not the measured 12.0 Hz. The hydraulic springs
and their lag belong to the actuators and are not included.
"""

from dataclasses import replace
from math import pi

from dynamics.arms.checks import Check
from dynamics.arms.measures import mass, mode_of_arm
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_SOURCE = "Yuan, Book and Huggins, 'Dynamics of flexible manipulator arms', 1993"
_LENGTH = 3.048  # [m] 10 ft, printed
_MASS = 31.75  # [kg] printed: about 70 lb
_ELBOW = 0.5 * pi  # [rad] chosen posture
_LINK = Link(
    length=_LENGTH,
    rho_A=_MASS / (2.0 * _LENGTH),
    EIz=2.9683e5,  # tuned to 6.37 Hz: benchmarks.accuracy.tune_presets
    modes=tuple(Mode(kind="poly", index=index, direction="y") for index in (1, 2)),
    damping_ratio=0.02,  # printed as about 0.2 or 0.02, illegible; motions of 2 s need 0.02
)

ARM = Arm(
    name="ralf-like",
    description=(
        "Two 10 ft links with the mass of RALF, the arm of Yuan, Book and Huggins, 1993, and its "
        "parallel drive of joint 2; EI tuned to its first frequency; without hydraulic springs."
    ),
    gravity=(0.0, -9.81, 0.0),
    links=(_LINK, replace(_LINK, joint=Joint(parallel=True))),
)

CHECKS = (
    Check(
        quantity="first frequency, elbow at 90 degrees, joints held (EI tuned to it)", unit="Hz",
        expected=6.37, tolerance=1e-3, source=_SOURCE + ", table 7.1, measured without actuators",
        measure=mode_of_arm(1, angles=(0.0, _ELBOW)),
    ),
    Check(
        quantity="mass of the structure", unit="kg", expected=31.75, tolerance=1e-3,
        source=_SOURCE, measure=mass,
    ),
)  # fmt: skip
