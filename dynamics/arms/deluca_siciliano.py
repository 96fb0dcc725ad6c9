"""The planar two-link arm of De Luca and Siciliano (IEEE Trans. SMC 21(4), 1991).

Clamped, with the elbow, the second link and the payload as a body at its tip (1.2 kg, 0.1338
kg m^2), the first link has 0.4797 and 1.7966 Hz, the second with the payload 2.1783 and 15.9145 Hz:
the published 0.48, 1.80, 2.18, 15.91 Hz. The payload is the last link's tip body, so that the
second link's shapes know it; with shapes that do not, the third joint-free frequency is 18 % high.
The four joint-free frequencies of the stretched arm are within 0.01 % of those of eight modes per
link.
"""

from dynamics.arm import Arm, Joint, Link, Mode

_MODES = tuple(Mode(kind="clamped-tip-mass", index=index, direction="y") for index in (1, 2))
_PAYLOAD_INERTIA = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 5e-4))  # [kg m^2] published
_HUB = Joint(hub_inertia=0.1)  # [kg m^2] published, both hubs

ARM = Arm(
    name="deluca-siciliano",
    description=(
        "Two soft links in a horizontal plane with a payload: De Luca and Siciliano, 'Closed-form "
        "dynamic model of planar multilink lightweight robots', IEEE Trans. SMC 21(4), 1991."
    ),
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
            tip_inertia=_PAYLOAD_INERTIA,
            modes=_MODES,
            damping_ratio=0.005,  # chosen
            joint=_HUB,
        ),
    ),
)
