"""SLIM, the one-link laboratory arm of Yuan, Book and Huggins (1993)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.validation.entries import Table, as_printed, mode_names, relatively
from dynamics import ARMS, Joint, compile_arm
from dynamics.arms.measures import alone, carried_inertia, hertz
from dynamics.description.validate import ZEROS

CHAPTER = "Yuan, Book and Huggins 1993: SLIM"
NOTES = {
    CHAPTER: "Printed are the data and three columns of frequencies. The other numbers, among them "
    "which shapes suit which hub (mapped in [stability](stability.md)), are those of the "
    "frequency equation, solved independently, for a beam with the handbook's density and a point "
    "mass fitted to mode 1. Three numbers of the preset, density, tip mass and tip "
    "inertia, are fitted to the four analytical modes 1, 2, 4, 5."
}
SLIM = ARMS["slim"]
BEAM = SLIM.links[0]
POINT: dict[str, Any] = {  # handbook density; fitted to mode 1
    "rho_A": 0.24610,
    "tip_mass": 0.0408,
    "tip_inertia": ZEROS,
}
INCH, POUND = 0.0254, 0.45359237  # [m], [kg]
FORCE = 4.4482216152605  # [N] of a pound
HALF = 0.5 * 4.7625e-3  # [m] half the thickness: distance of a gauge from the neutral axis
NO_HUB = 1e-10  # [kg m^2] rotor inertia in place of none
HUBS = {  # [kg m^2]: printed [Hz] exact 1, 2; one clamped-mass; two of them; two clamped-free
    0.0: ("9.664 32.58", "12.78", "9.674 48.0", "9.685 51.3"),
    1e-3: ("9.409 29.19", "11.80", "9.418 33.33", "9.428 34.44"),
    1e-2: ("7.442 17.66", "7.850", "7.445 17.72", "7.449 17.92"),
    0.1: ("3.583 14.33", "3.587", "3.583 14.33", "3.584 14.44"),
}
VARIANTS: dict[str, tuple[dict[str, Any], str]] = {  # changes, independent values [Hz]
    "clamped-free, no tip mass": ({"tip_mass": 0.0}, "2.609 16.353 45.788 89.727 148.324"),
    "clamped-mass, tip fitted to mode 1": ({}, "2.0960 13.9887 40.5289 81.2694 136.499"),
    "2700 kg/m³, tip 0.0411 kg": (
        {"rho_A": 2700 * 19.05e-3 * 4.7625e-3, "tip_mass": 0.0411},
        "2.096 14.005 40.596 81.42 136.78",
    ),
    "tip 0.10 lb": ({"tip_mass": 0.10 * POUND}, "2.055 13.86 40.31 80.98 136.17"),
}


def locked(**changes: Any) -> list[float]:
    """Five frequencies of the clamped beam [Hz], by seven shapes that include its tip body."""
    return hertz(alone(SLIM, 0, 7, **changes))[:5]


def on_hub(
    inertia: float, count: int, kind: str = "clamped-tip-mass", **changes: Any
) -> list[float]:
    """Frequencies with the joint free [Hz], for a hub inertia and `count` shapes of a kind."""
    joint = Joint(rotor_inertia=inertia or NO_HUB)
    return hertz(alone(SLIM, 0, count, kind, joint=joint, **changes), "free")


def strain_per_tip_deflection() -> float:
    """Root strain per tip deflection under a static tip load, exact with two polynomials [1/m]."""
    model = compile_arm(alone(SLIM, 0, 2, "poly"))
    delta = np.linalg.solve(model.stiffness[1:, 1:], np.ones(2))  # both shapes are 1 at the tip
    q = np.array([0.0, *(delta / delta.sum())])
    return HALF * float(model.strain(q, 0, 0.0)[2])


def _frequencies() -> Iterator[Table]:
    own = locked()
    printed = (
        ("analytical", "2.096 13.989 41.524 81.225 136.352", 40.524, 1e-3),
        ("finite elements", "2.088 13.955 41.452 81.203 136.345", 40.452, 5e-3),
        ("measured", "2.08 13.92 41.38 81.18", 40.38, 1e-2),
    )
    for column, digits, third, share in printed:
        rows = list(relatively(mode_names(len(digits.split())), digits, "Hz", share))
        rows[2] = replace(
            rows[2], correct=third,
            remark=f"a digit error: {third} agrees with the equation that gives the others",
        )  # fmt: skip
        yield Table(
            chapter=CHAPTER, title=f"Joint held, beside the {column} column",
            demand=f"within {share:.1%}",
            rows=tuple(rows), ours=lambda r=tuple(rows): own[: len(r)],  # type: ignore[misc]
        )  # fmt: skip


def _data() -> list[float]:
    width, thickness = 0.75 * INCH, 0.1875 * INCH
    moment = width * thickness**3 / 12.0
    stiffness = 4120.0 * FORCE * INCH**2
    bare = {**POINT, "tip_mass": 0.0}
    return [
        moment / INCH**4, stiffness, stiffness / moment / 1e9,
        0.098 * POUND / INCH**3 * width * thickness,
        carried_inertia(alone(SLIM, 0, 2, **POINT), 0) - BEAM.joint.rotor_inertia,
        carried_inertia(alone(SLIM, 0, 2, **bare), 0) - BEAM.joint.rotor_inertia,
        1e3 * strain_per_tip_deflection(),
    ]  # fmt: skip


def tables() -> Iterator[Table]:
    """Tables of the beam's data, and of frequencies with locked and free joint."""
    names = ("I", "EI", "E", "mass per length", "inertia of beam and tip about the joint",
             "of the beam alone", "root strain per tip deflection")  # fmt: skip
    units = ("in⁴", "N m²", "GPa", "kg/m", "kg m²", "kg m²", "10⁻³/m")
    digits = ("4.12e-4", "11.8236", "68.95", "0.24610", "0.20932", "0.14867", "4.81")
    remarks = ("from the printed section", "4120 lbf in², printed as lbf in⁴", "from EI and I",
               "0.098 lb/in³, not printed", "", "", "static tip load")  # fmt: skip
    shares = (5e-4, 1e-5, 2e-4, 5e-4, 1e-4, 1e-4, 1e-3)
    yield Table(
        chapter=CHAPTER, title="Data of the beam", demand="within rounding of the print",
        rows=tuple(
            row
            for n, u, d, r, s in zip(names, units, digits, remarks, shares, strict=True)
            for row in relatively((n,), d, u, s, r)
        ),
        ours=_data,
    )  # fmt: skip
    yield from _frequencies()
    yield Table(
        chapter=CHAPTER, title="Joint held, as the fit of density and tip body has it",
        demand="within 0.002 %",
        rows=relatively(mode_names(5), "2.09600 13.98909 40.5217 81.2242 136.3527", "Hz", 2e-5),
        ours=locked,
    )  # fmt: skip
    for name, (changes, printed) in VARIANTS.items():
        yield Table(
            chapter=CHAPTER, title=f"Joint held, {name}",
            demand="within 0.02 %: data rounded to four digits",
            rows=relatively(mode_names(5), printed, "Hz", 2e-4),
            ours=partial(locked, **{**POINT, **changes}),
        )  # fmt: skip
    for inertia, (exact, one, two, free) in HUBS.items():
        yield Table(
            chapter=CHAPTER,
            title=f"Joint free, hub of {inertia:g} kg m²: which shapes suit it",
            demand="exact: within 0.05 % by 12 shapes; others within a unit of the last digit",
            rows=(
                *relatively(("exact, mode 1", "exact, mode 2"), exact, "Hz", 5e-4),
                *as_printed(("1 clamped-mass shape",), one, "Hz", 1.01),
                *as_printed(("2 of them, mode 1", "mode 2"), two, "Hz", 1.01),
                *as_printed(("2 clamped-free, mode 1", "mode 2"), free, "Hz", 1.01),
            ),
            ours=partial(_hub_row, inertia),
        )  # fmt: skip


def _hub_row(inertia: float) -> Sequence[float]:
    exact = min(
        (on_hub(inertia, 12, kind, **POINT) for kind in ("clamped-tip-mass", "pinned-free")),
        key=lambda f: f[1],
    )
    few = ((1, "clamped-tip-mass"), (2, "clamped-tip-mass"), (2, "clamped-free"))
    return [*exact[:2], *(f for shapes in few for f in on_hub(inertia, *shapes, **POINT))]
