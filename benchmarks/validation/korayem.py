"""The two hanging links of Korayem and Shafei (2009): frequencies, and the motion after release.

The paper prints figures without tables. The numbers here are from an independent implementation of
its data: finite elements with tension stiffening, and assumed modes by another method with DOP853
at rtol 1e-9.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from math import pi
from pathlib import Path

import numpy as np
import scipy.linalg

from benchmarks.validation.entries import Number, Table, as_printed, mode_names, relatively
from dynamics import ARMS, Arm, Mode, Model, Payload, compile_arm, simulate
from dynamics.arms.measures import alone, hertz
from dynamics.formulations import gibbs_appell

CHAPTER = "Korayem and Shafei 2009: two hanging links"
NOTES = {
    CHAPTER: "The paper prints data and figures, no tables. *Theirs* is an independent "
    "implementation of its data: finite elements with tension stiffening, and assumed modes by "
    "another method."
}
DATA = ARMS["korayem-two-link"].links[0]
GRAVITY = 9.81  # [m/s^2]
SAMPLES = 20001  # of one second, for the extremes

FREQUENCIES = {  # name: modes, payload [kg], printed [Hz]
    "1 mode": (1, 0.0, "0.42655 1.1439 36.199 63.276"),
    "2 modes": (2, 0.0, "0.42654 1.1437 25.940 45.067 150.23 207.95"),
    "3 modes": (3, 0.0, "0.42654 1.1437 25.852 44.815 97.041 130.56 345.9 444.0"),
    "4 modes": (4, 0.0, "0.42654 1.1437 25.807 44.791 96.791 129.82 212.9 261.0 622.8 772.1"),
    "5 modes": (
        5, 0.0,
        "0.42654 1.1437 25.796 44.776 96.478 129.77 212.4 259.6 373.8 436.0 980.2 1192.6",
    ),
    "2 modes, 1 kg": (2, 1.0, "0.4101 1.1539 24.562 39.077 147.7 196.7"),
}  # fmt: skip
ELEMENTS = {  # name: payload [kg], printed [Hz]
    "finite elements": (0.0, "0.42654 1.14369 25.999 44.909 96.506 129.777 211.27 259.38"),
    "finite elements, 1 kg": (1.0, "0.41010 1.15393 24.611 38.801 92.321 117.08"),
}
RELEASED = {  # name: modes, payload [kg], rows of t [s], θ1, θ2 [deg], x, y [m], w1, w2 [mm]
    "rigid": (0, 0.0, """
        0.25 -88.578344 -0.483801
        0.5 -88.396032 -3.824226
        1.0 -92.161235 2.217203
        2.0 -88.852895 -0.537098"""),
    "1 mode": (1, 0.0, """
        0.1 -89.708992 3.894121 0.0784129 -1.9973019 0.107478 0.099757
        0.25 -88.577713 -0.480878 0.0411912 -1.9995581 -0.022966 -0.005190
        0.5 -88.394582 -3.827116 -0.0107467 -1.9988571 -0.018085 0.046408
        1.0 -92.160057 2.226159 -0.0367141 -1.9992870 -0.051271 -0.054851
        2.0 -88.85665 -0.51785 0.030723 -1.999743 -0.01214 -0.11865"""),
    "2 modes": (2, 0.0, """
        0.1 -89.712027 3.878018 0.0784376 -1.9973023 0.192151 0.216450
        0.25 -88.582255 -0.481421 0.0411844 -1.9995582 0.055073 -0.058306
        0.5 -88.392341 -3.824692 -0.0107341 -1.9988578 -0.059302 0.072568
        1.0 -92.159648 2.232737 -0.0366952 -1.9992859 -0.085856 -0.047243
        2.0 -88.85669 -0.50534 0.030776 -1.999743 -0.07910 -0.09234"""),
    "2 modes, 1 kg": (2, 1.0, """
        0.1 -89.657453 3.886709 0.0798844 -1.9972494 0.030001 0.042795
        0.25 -88.353962 -0.510336 0.0485759 -1.9993901 0.023667 -0.018215
        0.5 -88.139369 -3.708973 0.0003442 -1.9989532 0.053257 0.001079
        1.0 -92.271444 2.011175 -0.0444267 -1.9992004 -0.069549 -0.070813"""),
    "rigid, 1 kg": (0, 1.0, """
        0.25 -88.351085 -0.515829
        0.5 -88.137746 -3.704697
        1.0 -92.270427 1.992542"""),
}  # fmt: skip
EXTREMES = {  # name: modes, payload [kg], smallest and largest w1, w2 over one second [mm]
    "1 mode": (1, 0.0, "-0.133 0.171 -0.236 0.243"),
    "2 modes": (2, 0.0, "-0.184 0.212 -0.280 0.267"),
    "2 modes, 1 kg": (2, 1.0, "-0.214 0.247 -0.322 0.365"),
}


def hanging(modes: int, payload: float, kind: str = "clamped-free", segments: int = 1) -> Arm:
    """The arm with `modes` modes per link or segment; segments are foreshortened."""
    shapes = tuple(Mode(kind=kind, index=k, direction="y") for k in range(1, modes + 1))
    link = replace(DATA, modes=shapes, segments=segments)
    carried = Payload(mass=payload) if payload else None
    return Arm(
        links=(link, link), gravity=(0.0, -GRAVITY, 0.0), payload=carried,
        foreshortening=segments > 1,
    )  # fmt: skip


def swinging(arm: Arm) -> list[float]:
    """Frequencies of the hanging arm [Hz], from M and slopes of the bias, on plain floats."""
    chain = Model(arm).chain
    q, rest = np.zeros(arm.n), [0.0] * arm.n
    q[0] = -0.5 * pi
    step = 1e-4

    def bias(x: np.ndarray) -> np.ndarray:
        return np.array(gibbs_appell.bias(chain, x.tolist(), rest), dtype=float)

    def slope(e: np.ndarray) -> np.ndarray:
        far, near = (bias(q + s * step * e) - bias(q - s * step * e) for s in (2.0, 1.0))
        return (8.0 * near - far) / (12.0 * step)

    K = np.column_stack([slope(e) for e in np.eye(arm.n)])
    M = np.array(gibbs_appell.mass_matrix(chain, q.tolist()), dtype=float)
    squares = scipy.linalg.eigvalsh(0.5 * (K + K.T), M)
    return [float(w) for w in np.sqrt(squares) / (2.0 * pi)]


@cache
def released(modes: int, payload: float) -> tuple[np.ndarray, np.ndarray]:
    """Motion from rest: times (N,) [s]; angles [deg], tip [m], deflections [mm] (N, 6)."""
    arm = hanging(modes, payload)
    model = compile_arm(arm)
    q = np.zeros(model.n)
    joints = list(arm.joint_index)
    q[joints] = np.deg2rad([-90.0, 5.0])
    times = np.linspace(0.0, 2.0, 2 * (SAMPLES - 1) + 1)
    motion = simulate(model, q, 0.0 * q, None, times, rtol=1e-11)
    bent = [sum(x for x in delta) for _, delta in model.chain.split(list(motion.q.T))]
    columns = [*np.rad2deg(motion.q[:, joints]).T, *motion.tip[:, :2].T]
    columns += [1e3 * (np.zeros(times.size) + w) for w in bent]
    return times, np.column_stack(columns)


def _motion(name: str) -> list[float]:
    modes, payload, text = RELEASED[name]
    times, table = released(modes, payload)
    found: list[float] = []
    for line in text.strip().splitlines():
        t, *printed = line.split()
        row = table[round(float(t) / times[1])]
        found += row[: len(printed)].tolist()
    return found


def _motion_rows(name: str) -> tuple[Number, ...]:
    rows: list[Number] = []
    for line in RELEASED[name][2].strip().splitlines():
        t, *printed = line.split()
        for what, unit, digits in zip(
            ("θ1", "θ2", "tip x", "tip y", "w1", "w2"), ("°", "°", "m", "m", "mm", "mm"), printed,
            strict=False,
        ):  # fmt: skip
            rows += as_printed((f"{what} at {t} s",), digits, unit)
    return tuple(rows)


def _extremes(name: str) -> Sequence[float]:
    modes, payload, _ = EXTREMES[name]
    _, table = released(modes, payload)
    bent = table[:SAMPLES, 4:]
    return [x for w in bent.T for x in (float(w.min()), float(w.max()))]


def _sag() -> float:
    """Tip sag of one horizontal clamped link under its weight, by three polynomials [mm]."""
    shapes = tuple(Mode(kind="poly", index=k, direction="y") for k in (1, 2, 3))
    model = compile_arm(Arm(links=(replace(DATA, modes=shapes),), gravity=(0.0, -GRAVITY, 0.0)))
    rest = np.zeros(model.n)
    load = model.bias(rest, rest)[1:]
    return 1e3 * float(np.linalg.solve(model.stiffness[1:, 1:], load).sum())


def _cut(payload: float) -> list[float]:
    """Frequencies [Hz] of the arm with two foreshortened segments per link, stiff by tension."""
    return swinging(hanging(5, payload, "poly", 2))


def tables() -> Iterator[Table]:
    """All tables of this chapter."""
    yield Table(
        chapter=CHAPTER, title="One link", demand="within rounding of the printed digits",
        rows=(
            *as_printed(mode_names(4), "7.914 49.595 138.868 272.125", "Hz", remark="clamped"),
            *as_printed(("sag under 1 g",), "6.13", "mm", units=1.01),
            *as_printed(("side of a square section",), "15.65", "mm"),
            *as_printed(("its area",), "2.449e-4", "m²"),
            *relatively(
                ("its density",), "20400", "kg/m³", 2e-3,
                remark="far above steel: the printed data are no real bar",
            ),
        ),
        ours=lambda: [
            *hertz(alone(ARMS["korayem-two-link"], 0, 6, "clamped-free"))[:4], _sag(),
            *_square_section(),
        ],
    )  # fmt: skip
    for name, (modes, payload, digits) in FREQUENCIES.items():
        yield Table(
            chapter=CHAPTER, title=f"Hanging, joints free, {name} per link",
            demand="within rounding of the printed digits",
            rows=as_printed(mode_names(len(digits.split())), digits, "Hz"),
            ours=lambda m=modes, p=payload: swinging(hanging(m, p)),  # type: ignore[misc]
        )  # fmt: skip
    for name, (payload, digits) in ELEMENTS.items():
        yield Table(
            chapter=CHAPTER, title=f"Hanging, joints free, {name}", quick=False,
            demand="within 0.1 %; ours: two foreshortened segments of five polynomials",
            rows=relatively(mode_names(len(digits.split())), digits, "Hz", 1e-3),
            ours=lambda p=payload, d=digits: _cut(p)[: len(d.split())],  # type: ignore[misc]
        )  # fmt: skip
    for name in RELEASED:
        yield Table(
            chapter=CHAPTER, title=f"Released at -90° and +5°, {name}",
            demand="within rounding of the printed digits", rows=_motion_rows(name),
            quick=RELEASED[name][:2] != (2, 1.0),
            ours=partial(_motion, name),
        )  # fmt: skip
    for name, (_, _, digits) in EXTREMES.items():
        yield Table(
            chapter=CHAPTER, title=f"Extremes of the tip deflections over 1 s, {name}",
            quick=EXTREMES[name][:2] != (2, 1.0),
            demand="within rounding of the printed digits",
            rows=as_printed(
                ("smallest w1", "largest w1", "smallest w2", "largest w2"), digits, "mm",
            ),
            ours=partial(_extremes, name),
        )  # fmt: skip


def _square_section() -> tuple[float, float, float]:
    """Side [mm], area [m^2] and density [kg/m^3] of a square bar with the printed moment."""
    moment = 5.0e-9  # [m^4] printed
    side = (12.0 * moment) ** 0.25
    return 1e3 * side, side**2, DATA.rho_A / side**2


def draw(folder: Path) -> None:
    """Draw tip deflections of the released arm with one and two modes, and tabulated points."""
    from benchmarks import style
    from benchmarks.output import save_figure

    plt = style.pyplot()
    figure, axes = plt.subplots(2, 1, figsize=(8.5, 5.6), sharex=True, layout="constrained")
    for colour, name in (("C0", "1 mode"), ("C1", "2 modes")):
        modes, payload, text = RELEASED[name]
        times, table = released(modes, payload)
        shown = times <= 1.0
        points = np.array([line.split() for line in text.strip().splitlines()], dtype=float)
        points = points[points[:, 0] <= 1.0]
        for axis, column in zip(axes, (4, 5), strict=True):
            axis.plot(times[shown], table[shown, column], colour, linewidth=0.8, label=name)
            axis.plot(points[:, 0], points[:, column + 1], "o", color=colour, markeredgecolor="k")
    for axis, link in zip(axes, (1, 2), strict=True):
        axis.set_ylabel(f"tip of link {link} [mm]")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right")
    axes[0].set_title("Two links released at -90° and +5°: deflections, dots tabulated")
    axes[1].set_xlabel("time [s]")
    save_figure(figure, folder / "validation_release")
