"""Example of Korayem and Shafei (2009), after Usoro et al. (1986): two links under gravity.

Released from -90 and +5 degrees, the arm swings almost rigidly. It has two clamped-free shapes per
link, the paper one. The first joint-free bending frequencies are 36.2 and 63.3 Hz with one shape,
25.9 and 45.1 Hz with two, 26.0 and 44.9 Hz with finite elements. The upper two remain 55 % high.
"""

from dynamics.arms.checks import Check
from dynamics.arms.measures import mode_of_link
from dynamics.description.arm import Arm
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_LINK = Link(
    length=1.0,  # printed
    rho_A=5.0,  # printed
    EIz=1000.0,  # printed: 2.0e11 N/m^2 times 5.0e-9 m^4
    modes=tuple(Mode(kind="clamped-free", index=index, direction="y") for index in (1, 2)),
)

ARM = Arm(
    name="korayem-two-link",
    description=(
        "Two flexible links hanging in a vertical plane: the example of Korayem and Shafei, "
        "recursive Gibbs-Appell formulation, 2009."
    ),
    gravity=(0.0, -9.81, 0.0),  # printed as 1 g; value chosen
    links=(_LINK, _LINK),
)

CHECKS = tuple(
    Check(
        quantity=f"one link clamped, mode {k}", unit="Hz", expected=expected, tolerance=1e-4,
        source="beam theory with the printed EI and mass per length",
        measure=mode_of_link(0, k, 6, "clamped-free"),
    )
    for k, expected in enumerate((7.914, 49.595, 138.868, 272.125), 1)
)  # fmt: skip
