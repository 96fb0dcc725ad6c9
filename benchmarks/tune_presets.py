"""Rigidities of the presets whose EI no source gives, tuned to a frequency that one does.

    python benchmarks/tune_presets.py

Prints what stands in `dynamics/arms`, to five digits. A frequency grows with the root of EI, so
that a few corrections settle it, also where two planes are coupled.
"""

from dataclasses import replace
from math import pi

from dynamics import ARMS, Arm
from dynamics.published import alone, hertz

CORRECTIONS = 12


def tuned_ruler() -> float:
    """[N m^2] EI of the rotary flexible link: 3.0 Hz clamped."""
    (link,) = ARMS["quanser-rotary-flexible-link"].links
    return (link.EIz or 0.0) * (3.0 / hertz(alone(Arm(links=(link,)), 0, 6))[0]) ** 2


def tuned_forearm() -> float:
    """[N m^2] EI of the flexible forearm: 4.716 Hz on its free joint."""
    arm = ARMS["sapienza-forearm"]
    found = hertz(alone(arm, 1, 8, "pinned-free"), "free")[0]
    return (arm.links[1].EIz or 0.0) * (4.716 / found) ** 2


def tuned_large_arm() -> float:
    """[N m^2] EI of both links of the arm like RALF: 6.37 Hz held, elbow at 90 degrees."""
    arm = ARMS["ralf-like"]
    found = hertz(arm, angles=(0.0, 0.5 * pi))[0]
    return (arm.links[0].EIz or 0.0) * (6.37 / found) ** 2


def tuned_booms() -> tuple[float, float]:
    """[N m^2] EIz, EIy of both booms of the arm like the Shuttle's: 0.35 and 0.46 Hz, straight."""
    arm = ARMS["srms-like"]
    boom = arm.links[1]
    EIz, EIy = boom.EIz or 0.0, boom.EIy or 0.0
    for _ in range(CORRECTIONS):
        GJ = (EIz + EIy) / 2.6
        links = tuple(
            replace(link, EIz=EIz, EIy=EIy, GJ=GJ) if link.modes else link for link in arm.links
        )
        pitch, yaw = hertz(replace(arm, links=links))[:2]
        EIz, EIy = EIz * (0.35 / pitch) ** 2, EIy * (0.46 / yaw) ** 2
    return EIz, EIy


if __name__ == "__main__":
    print(f"quanser-rotary-flexible-link  EI tuned {tuned_ruler():.5g} N m^2")
    print(f"sapienza-forearm              EI tuned {tuned_forearm():.5g} N m^2")
    print(f"ralf-like                     EI tuned {tuned_large_arm():.5g} N m^2")
    EIz, EIy = tuned_booms()
    print(f"srms-like                     EIz, EIy tuned {EIz:.5g}, {EIy:.5g} N m^2")
