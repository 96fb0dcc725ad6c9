"""Planar two-link arm of De Luca and Siciliano (IEEE Trans. SMC 21(4), 1991).

The first link, clamped, with elbow, second link and payload as a body at its tip (1.2 kg, 0.1338
kg m^2), has 0.4797 and 1.7966 Hz. The second link, clamped, with the payload, has 2.1783 and
15.9145 Hz. Published are 0.48, 1.80, 2.18 and 15.91 Hz.

Each link bends as under a tip force, and bending foreshortens it: `choose_model` takes this one
shape for a tip error of 1e-3 of the reach at full torque. The paper has two clamped shapes without
foreshortening, which err by seven times as much.
"""

from collections.abc import Callable

from dynamics.arms.checks import Check
from dynamics.arms.inertia import about_axes
from dynamics.arms.measures import alone, hertz, mode_of_link
from dynamics.description.arm import FOURTH_ORDER, Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode

_MODES = (Mode(kind="hierarchical", index=1, direction="y"),)
_HUB = Joint(hub_inertia=0.1)  # [kg m^2] published, both hubs


ARM = Arm(
    name="deluca-siciliano",
    description=(
        "Two soft links in a horizontal plane with a payload: De Luca and Siciliano, 'Closed-form "
        "dynamic model of planar multilink lightweight robots', IEEE Trans. SMC 21(4), 1991."
    ),
    foreshortening=FOURTH_ORDER,
    links=(
        Link(
            length=0.5,  # published
            rho_A=0.2,  # published
            EIz=1.0,  # published
            tip_mass=1.0,  # published: the elbow
            modes=_MODES,
            damping_ratio=0.005,  # chosen
            joint=_HUB,
        ),
        Link(
            length=0.5,  # published
            rho_A=0.2,  # published
            EIz=1.0,  # published
            tip_mass=0.1,  # published: the payload
            tip_inertia=about_axes(z=5e-4),  # published
            modes=_MODES,
            damping_ratio=0.005,  # chosen
            joint=_HUB,
        ),
    ),
)

_SOURCE = "De Luca and Siciliano 1991, printed to two decimals"


def _first(mode: int) -> Callable[[Arm], float]:
    """Frequency [Hz] of link 1 alone, with everything beyond it as its tip body."""
    beyond = about_axes(z=0.1338)  # [kg m^2] of 1.2 kg: published data, link 2 stretched
    return lambda arm: hertz(alone(arm, 0, 6, tip_mass=1.2, tip_inertia=beyond))[mode - 1]


CHECKS = (
    *(
        Check(
            quantity=f"link 1 clamped, with all beyond it, mode {k}", unit="Hz",
            expected=printed, tolerance=0.0051 / printed, source=_SOURCE,
            measure=_first(k),
        )
        for k, printed in enumerate((0.48, 1.80), 1)
    ),
    *(
        Check(
            quantity=f"link 2 clamped, with the payload, mode {k}", unit="Hz", expected=printed,
            tolerance=0.0051 / printed, source=_SOURCE,
            measure=mode_of_link(1, k),
        )
        for k, printed in enumerate((2.18, 15.91), 1)
    ),
)  # fmt: skip
