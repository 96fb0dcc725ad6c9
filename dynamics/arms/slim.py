"""SLIM: the single-link laboratory arm of Yuan, Book and Huggins (1993), on a light hub.

Two clamped shapes that know the tip mass. Against eight of them the joint-free frequencies are
7.446 Hz (+0.05 %) and 17.72 Hz (+0.3 %); the joint-held ones are exact, 2.096 and 13.989 Hz
(measured 2.08 and 13.92 Hz). One shape alone would be 5 % high on this hub.
"""

from dynamics.arm import Arm, Joint, Link, Mode

ARM = Arm(
    name="slim",
    description=(
        "One horizontal aluminium beam with a tip mass on a torque-driven hub: SLIM of Yuan, "
        "Book and Huggins, 'Dynamics of flexible manipulator arms', 1993."
    ),
    links=(
        Link(
            length=1.2192,  # 48 in, printed
            rho_A=0.24610,  # 19.05 mm x 4.7625 mm, printed; 6061-T6, 2712.6 kg/m^3, not printed
            EIz=11.8236,  # 4120 lbf in^2, printed
            tip_mass=0.0408,  # 0.090 lb, derived from the printed first frequency, 2.096 Hz
            modes=tuple(
                Mode(kind="clamped-tip-mass", index=index, direction="y") for index in (1, 2)
            ),
            damping_ratio=0.005,  # chosen: bare metal in air; none is printed
            joint=Joint(rotor_inertia=0.01),  # chosen: the hub's inertia is not printed
        ),
    ),
)
