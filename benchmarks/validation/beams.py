"""Beam theory: spinning and heavily loaded beams, limit equations, and two nonlinear motions.

Spinning and loaded beams are classical problems; the digits are from a converged shooting solution
of the exact beam. S1 and S3 are motions of geometrically nonlinear beams, stored with their data in
tests/reference/; our numbers are from assumed-mode models.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np
import scipy.linalg
from scipy.optimize import fsolve

from benchmarks.validation.entries import Number, Table, relatively
from benchmarks.work_precision.scenes import SETTINGS, Level
from dynamics import Arm, Joint, Link, Mode, compile_arm, simulate
from dynamics.arms.measures import hertz
from dynamics.types import Array

CHAPTER = "Beam theory and long links"
NOTES = {
    CHAPTER: "Classical problems; *theirs* are converged solutions of the exact beam, or closed "
    "forms."
}
ROTATING = {  # Omega sqrt(rho_A L^4 / EI): first flap and lag frequency times the same root
    0.0: "3.516015 3.516015",
    1.0: "3.681647 3.543236",
    2.0: "4.137320 3.621797",
    3.0: "4.797279 3.743512",
    4.0: "5.585001 3.897723",
}
DEAD_LOAD = {  # P L^2 / EI: drop / L and x / L of the tip
    0.5: "0.16214358 0.98408104",
    1.0: "0.30172077 0.94356676",
    2.0: "0.49345748 0.83935828",
}
END_MOMENT = (0.5, 1.0)  # M L / EI
SPEED = 3.0  # Omega sqrt(rho_A L^4 / EI) at which the linear beam softens falsely


def _unit(modes: int, direction: str, kind: str = "clamped-free", **changes: Any) -> Arm:
    """Cantilever of unit length, mass per length and stiffness, by default foreshortened."""
    short = bool(changes.pop("foreshortening", True))
    gravity = changes.pop("gravity", (0.0, 0.0, 0.0))
    shapes = tuple(Mode(kind=kind, index=k + 1, direction=direction) for k in range(modes))
    data: dict[str, Any] = {"length": 1.0, "rho_A": 1.0, "EIz": 1.0, "EIy": 1.0} | changes
    link = Link(modes=shapes, joint=Joint(rotor_inertia=1.0), **data)
    return Arm(links=(link,), gravity=gravity, foreshortening=short)


def spinning(arm: Arm, rate: float) -> float:
    """Lowest frequency at a constant joint rate, from slopes of the bias [rad/s]."""
    model = compile_arm(arm)
    v = np.zeros(model.n)
    v[0] = rate
    step = 1e-6
    bias = [
        [model.bias(np.array([0.0, *(s * step * e)]), v)[1:] for s in (1.0, -1.0)]
        for e in np.eye(model.n - 1)
    ]
    K = np.column_stack([(plus - minus) / (2.0 * step) for plus, minus in bias])
    M = model.mass_matrix(np.zeros(model.n))[1:, 1:]
    return sqrt(abs(scipy.linalg.eigvalsh(0.5 * (K + K.T), M)[0]))


def loaded(arm: Arm, generalized: Array | None = None) -> Array:
    """(3,) [m] tip of a cantilever in equilibrium with its gravity and modal forces [N]."""
    model = compile_arm(arm)
    rest = np.zeros(model.n)
    push = np.zeros(model.n - 1) if generalized is None else generalized

    def force(delta: Array) -> Array:
        return np.asarray(model.bias(np.array([0.0, *delta]), rest)[1:]) - push

    delta, _, solved, message = fsolve(force, np.zeros(model.n - 1), full_output=True, xtol=1e-12)
    if solved != 1:
        raise RuntimeError(f"No equilibrium found: {message}")
    return model.tip(np.array([0.0, *delta]))


def bent_by_moment(moment: float) -> tuple[float, float]:
    """Tip x and y of the unit cantilever under an end moment.

    The tip turns by the sum of its segments' slopes, so the moment does work on every slope.
    """
    arm = _unit(2, "y", "poly", segments=4)
    model = compile_arm(arm)
    slopes = np.array([theta[2] for body in model.chain.links for theta in body.tip_theta])
    x, y, _ = loaded(arm, moment * slopes)
    return float(x), float(y)


@cache
def scene(name: str, level: Level) -> Array:
    """(N, 3) [m] tip of a scene's arm at a fidelity level, by DOP853 at 1e-9."""
    setting = SETTINGS[name]
    model = compile_arm(level.arm(setting.arm))
    q, v = setting.start(model)
    motion = simulate(
        model, q, v, setting.motion.torque, setting.times, integrator="dop853", rtol=1e-9
    )
    return motion.tip


def _apart(name: str, level: Level) -> float:
    """Largest tip distance from the truth over the reach [-]."""
    setting = SETTINGS[name]
    far = np.linalg.norm(scene(name, level) - setting.truth, axis=1).max()
    return float(far) / setting.arm.reach


def _across_hub(tip: Array) -> Array:
    """(N,) [m] tip of S3 perpendicular to the hub's prescribed direction."""
    t = SETTINGS["S3"].times
    psi = 0.4 * (t**2 / 2 + (15 / (2 * pi)) ** 2 * (np.cos(2 * pi * t / 15) - 1))
    psi = np.where(t < 15.0, psi, 6.0 * t - 45.0)
    return -np.sin(psi) * tip[:, 0] + np.cos(psi) * tip[:, 1]


def _peaks() -> Sequence[float]:
    truth, own = (
        _across_hub(tip)
        for tip in (SETTINGS["S3"].truth, scene("S3", Level(modes=3, foreshortening=True)))
    )
    t = SETTINGS["S3"].times
    return [truth.min(), t[truth.argmin()], own.min(), t[own.argmin()]]


def limits() -> list[float]:
    """Frequencies of Zohoor and Khorsandijou's limit equations over the closed forms.

    (35) torsion by its own shapes, (36) stretching by polynomials, (37), (38) bending in y and z.
    """
    torsion = tuple(Mode(kind="torsion-fixed-free", index=k, direction="x") for k in (1, 2, 3))
    axial = tuple(Mode(kind="axial-poly", index=k, direction="axial") for k in range(1, 7))
    bending = tuple(Mode(kind="poly", index=k, direction=d) for d in "yz" for k in range(1, 7))
    E, G, rho, J, A, L = 70e9, 26e9, 2700.0, 4e-10, 8e-5, 1.3
    link = Link(
        length=L, rho_A=rho * A, EIz=E * J, EIy=E * J, GJ=2 * G * J, rho_Ip=2 * rho * J,
        EA=E * A, modes=torsion,
    )  # fmt: skip
    inertia = ((1e-12, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    twist = hertz(Arm(links=(replace(link, tip_inertia=inertia),)))
    stretch = hertz(Arm(links=(replace(link, modes=axial),)))
    bend = hertz(Arm(links=(replace(link, modes=bending),)))
    roots = (1.8751040687, 4.6940911330)
    exact = [b**2 / (2 * pi * L**2) * sqrt(E * J / (rho * A)) for b in roots]
    return [
        *(twist[k] / ((2 * k + 1) / (4 * L) * sqrt(G / rho)) for k in range(3)),
        *(stretch[k] / ((2 * k + 1) / (4 * L) * sqrt(E / rho)) for k in range(2)),
        *(bend[2 * k + plane] / exact[k] for k in (0, 1) for plane in (0, 1)),
    ]


def _rotating() -> Iterator[Table]:
    for eta, digits in ROTATING.items():
        yield Table(
            chapter=CHAPTER, title=f"Cantilever spinning at η = {eta:g}, foreshortened",
            demand="within 0.2 %: three modes",
            rows=relatively(("first flap", "first lag"), digits, "√(EI/ρA L⁴)", 2e-3),
            ours=lambda r=eta: [spinning(_unit(3, d), r) for d in "zy"],  # type: ignore[misc]
        )  # fmt: skip
    yield Table(
        chapter=CHAPTER, title=f"The same without foreshortening, η = {SPEED:g}: falsely soft",
        demand="within 1e-4: ω² = 3.516² - Ω², which no beam obeys",
        rows=relatively(
            ("first lag",), f"{sqrt(3.5160152685**2 - SPEED**2):.6f}", "√(EI/ρA L⁴)", 1e-4,
            "the linear model's own error; the truth is 3.743512",
        ),
        ours=lambda: [spinning(_unit(1, "y", foreshortening=False), SPEED)],
    )  # fmt: skip


def _static() -> Iterator[Table]:
    for alpha, digits in DEAD_LOAD.items():
        yield Table(
            chapter=CHAPTER, title=f"Cantilever under a dead tip load, α = {alpha:g}",
            demand="within 0.5 %: four segments of two polynomials",
            rows=relatively(("drop", "x of the tip"), digits, "L", 5e-3),
            ours=partial(_dropped, alpha),
        )  # fmt: skip
    for k in END_MOMENT:
        exact = f"{sin(k) / k:.6f} {(1.0 - cos(k)) / k:.6f}"
        yield Table(
            chapter=CHAPTER, title=f"Cantilever under an end moment, M L / EI = {k:g}",
            demand="within 0.5 %: the same", rows=relatively(("x", "y"), exact, "L", 5e-3),
            ours=partial(bent_by_moment, k),
        )  # fmt: skip


def _dropped(alpha: float) -> tuple[float, float]:
    x, y, _ = loaded(
        _unit(2, "y", "poly", gravity=(0.0, -1.0, 0.0), rho_A=1e-9, tip_mass=alpha, segments=4)
    )
    return -float(y), float(x)


def _motions() -> Iterator[Table]:
    yield Table(
        chapter=CHAPTER, quick=False, title="S1 and S3: how far a rigid link is off",
        demand="within rounding of the print",
        rows=relatively(("S1", "S3"), "7.0e-3 5.7e-2", "L", 0.01),
        ours=lambda: [_apart(name, Level(modes=0)) for name in ("S1", "S3")],
    )  # fmt: skip
    yield Table(
        chapter=CHAPTER, quick=False, title="S3: largest deflection",
        demand="the stored motion: rounding; three foreshortened modes: 2 %, nearest sample",
        rows=(
            *relatively(("stored beam, peak",), "-0.5738", "m", 1e-4),
            *relatively(("stored beam, when",), "6.75", "s", 1e-6),
            *relatively(("our modes, peak",), "-0.5738", "m", 0.02),
            Number(quantity="our modes, when", printed="6.75", unit="s", within=0.0501),
        ),
        ours=_peaks,
    )  # fmt: skip
    both = Level(modes=2, foreshortening=True)
    yield Table(
        chapter=CHAPTER, quick=False, title="S1 and S3: two foreshortened modes, whole motion",
        demand="within 1e-3 of the length",
        rows=tuple(
            Number(quantity=f"{name}, farthest from the beam", printed="0", unit="L", within=1e-3)
            for name in ("S1", "S3")
        ),
        ours=lambda: [_apart(name, both) for name in ("S1", "S3")],
    )  # fmt: skip


def tables() -> Iterator[Table]:
    """All tables of this chapter."""
    names = ("(35) torsion, mode 1", "mode 2", "mode 3", "(36) stretching, mode 1",
             "mode 2", "(37) bending in y, mode 1", "(38) bending in z, mode 1",
             "in y, mode 2", "in z, mode 2")  # fmt: skip
    yield from _rotating()
    yield from _static()
    yield Table(
        chapter=CHAPTER, title="Limit equations of Zohoor and Khorsandijou, over closed forms",
        demand="within 1e-4",
        rows=relatively(names, " ".join("1" for _ in names), "", 1e-4),
        ours=limits,
    )  # fmt: skip
    yield from _motions()
