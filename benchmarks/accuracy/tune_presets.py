"""Tune the presets' unpublished parameters to published frequencies, and print them.

    python -m benchmarks.accuracy.tune_presets

Prints the tuned values of `dynamics/arms/presets`, with the digits given there. A frequency grows
with the square root of EI, so one correction of EI is exact; several parameters are tuned by least
squares.
"""

from dataclasses import replace
from math import pi

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.output import argument_parser
from dynamics import ARMS, Arm
from dynamics.arms.inertia import about_axes
from dynamics.arms.measures import alone, hertz
from dynamics.arms.presets.slim import PRINTED

SHUTTLE = (0.35, 0.46, 3.554, 4.228)  # [Hz] straight, joints locked, unloaded


def tuned_slim() -> tuple[float, float, float]:
    """rho_A [kg/m], tip mass [kg], tip inertia [kg m^2] of SLIM, from four locked frequencies."""
    (link,) = ARMS["slim"].links
    first = np.array([link.rho_A, link.tip_mass, link.tip_inertia[2][2]])

    def error(factors: NDArray[np.float64]) -> NDArray[np.float64]:
        rho_A, mass, inertia = (first * factors).tolist()
        body = {"tip_mass": mass, "tip_inertia": about_axes(z=inertia)}
        found = hertz(alone(ARMS["slim"], 0, 7, rho_A=rho_A, **body))
        return np.array([1e6 * (found[k - 1] / printed - 1.0) for k, printed in PRINTED.items()])

    found = least_squares(error, np.ones(3), diff_step=1e-5).x
    rho_A, mass, inertia = (first * found).tolist()
    return rho_A, mass, inertia


def tuned_ruler() -> float:
    """EI [N m^2] of the rotary flexible link, from 3.0 Hz clamped."""
    (link,) = ARMS["quanser-rotary-flexible-link"].links
    return (link.EIz or 0.0) * (3.0 / hertz(alone(Arm(links=(link,)), 0, 6))[0]) ** 2


def tuned_forearm() -> float:
    """EI [N m^2] of the flexible forearm, from 4.716 Hz with its joint free."""
    arm = ARMS["sapienza-forearm"]
    found = hertz(alone(arm, 1, 8, "pinned-free"), "free")[0]
    return (arm.links[1].EIz or 0.0) * (4.716 / found) ** 2


def tuned_large_arm() -> float:
    """EI [N m^2] of both links of `ralf-like`, from 6.37 Hz, joints locked, elbow at 90 degrees."""
    arm = ARMS["ralf-like"]
    found = hertz(arm, angles=(0.0, 0.5 * pi))[0]
    return (arm.links[0].EIz or 0.0) * (6.37 / found) ** 2


def tuned_shuttle() -> tuple[float, ...]:
    """EI [N m^2] of both booms and springs [N m/rad] of yaw, pitch, elbow of `srms-like`.

    Tuned to four frequencies of the straight, unloaded arm with locked joints.
    """
    arm = ARMS["srms-like"]
    EI = arm.links[1].EIz or 0.0
    first = [EI, *(link.joint.stiffness or 0.0 for link in arm.links[:3])]

    def error(logarithms: NDArray[np.float64]) -> NDArray[np.float64]:
        found = hertz(_shuttle(arm, *np.exp(logarithms).tolist()))
        return np.log(np.array(found[:4]) / SHUTTLE)

    return tuple(np.exp(least_squares(error, np.log(first)).x).tolist())


def _shuttle(arm: Arm, EI: float, *springs: float) -> Arm:
    links = [
        replace(link, EIz=EI, EIy=EI, GJ=EI / 1.3) if link.modes else link for link in arm.links
    ]
    for k, stiffness in enumerate(springs):
        links[k] = replace(links[k], joint=replace(links[k].joint, stiffness=stiffness))
    return replace(arm, links=tuple(links))


def main() -> None:
    """Tune all presets and print the values."""
    argument_parser("accuracy.tune_presets", __doc__).parse_args()
    rho_A, mass, inertia = tuned_slim()
    print(f"slim                          rho_A {rho_A:.5f} kg/m, tip {mass:.5f} kg, "
          f"{inertia:.3g} kg m^2")  # fmt: skip
    print(f"quanser-rotary-flexible-link  EI tuned {tuned_ruler():.5g} N m^2")
    print(f"sapienza-forearm              EI tuned {tuned_forearm():.5g} N m^2")
    print(f"ralf-like                     EI tuned {tuned_large_arm():.5g} N m^2")
    EI, *springs = tuned_shuttle()
    print(f"srms-like                     EI tuned {EI:.5g} N m^2")
    print(f"  springs of yaw, pitch, elbow {', '.join(f'{k:.5g}' for k in springs)} N m/rad")


if __name__ == "__main__":
    main()
