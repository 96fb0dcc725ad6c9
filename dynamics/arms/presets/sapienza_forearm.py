"""Rigid upper arm with a flexible forearm: De Luca, Lanari, Lucibello, Panzieri, Ulivi, CDC 1990.

Published are inertias, the forearm's first two frequencies on its free joint and their identified
damping. Here the forearm is a uniform beam: its mass follows from the inertia about the elbow, and
its EI is tuned to the first frequency. The second frequency is then 3 % above the identified one.
The published static moment, and the shapes at elbow and tip, are met to 0.3 %, 4 % and 4 %.
"""

from dynamics.arms.checks import Check
from dynamics.arms.measures import carried_inertia, mode_of_link
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_SOURCE = (
    "De Luca et al., 'Control experiments on a two-link robot with a flexible forearm', CDC 1990, "
    "through a public transcription"
)
_UPPER, _FOREARM = 0.3, 0.7  # [m] published
_ABOUT_SHOULDER, _ABOUT_ELBOW, _HUB = 0.447, 0.303, 6.35e-4  # [kg m^2] published
_RHO_A = 3.0 * (_ABOUT_ELBOW - _HUB) / _FOREARM**3  # [kg/m]
_UPPER_RHO_A = 1.0  # [kg/m] chosen: in the plane only the inertia about the shoulder counts
_UPPER_HUB = _ABOUT_SHOULDER - _RHO_A * _FOREARM * _UPPER**2 - _UPPER_RHO_A * _UPPER**3 / 3.0

ARM = Arm(
    name="sapienza-forearm",
    description=(
        "A rigid upper arm and a flexible forearm in a horizontal plane: De Luca et al., CDC "
        "1990; uniform forearm, EI tuned to its first frequency."
    ),
    links=(
        Link(length=_UPPER, rho_A=_UPPER_RHO_A, joint=Joint(hub_inertia=_UPPER_HUB)),
        Link(
            length=_FOREARM,
            rho_A=_RHO_A,
            EIz=2.3938,  # tuned to 4.716 Hz: benchmarks.accuracy.tune_presets
            modes=tuple(Mode(kind="pinned-free", index=index, direction="y") for index in (1, 2)),
            damping_ratio=0.07,  # published of the first mode; 0.03 of the second
            joint=Joint(hub_inertia=_HUB),
        ),
    ),
)

CHECKS = (
    Check(
        quantity="forearm on its free joint, first (EI tuned to it)", unit="Hz", expected=4.716,
        tolerance=1e-3, source=_SOURCE,
        measure=mode_of_link(1, 1, 8, "pinned-free", "free"),
    ),
    Check(
        quantity="the same, second, identified on the real, not uniform forearm", unit="Hz",
        expected=14.395, tolerance=0.05, source=_SOURCE,
        measure=mode_of_link(1, 2, 8, "pinned-free", "free"),
    ),
    Check(
        quantity="coupling of the joints, upper length times static moment", unit="kg m^2",
        expected=0.195, tolerance=5e-3, source=_SOURCE,
        measure=lambda arm: (
            0.5 * (carried_inertia(arm, 0) - carried_inertia(arm, 0, (0.0, 1.5707963267948966)))
        ),
    ),
)  # fmt: skip
