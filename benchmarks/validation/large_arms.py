"""The large arms: RALF of Yuan, Book and Huggins (1993), and the Shuttle's arm, Cyril's subject.

Neither source has all the data of a model, so the presets `ralf-like` and `srms-like` are tuned.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from math import nan, pi, sqrt

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq

from benchmarks.validation.entries import (
    INCOMPARABLE,
    LOST,
    REPLACED,
    Number,
    Table,
    as_printed,
    relatively,
)
from benchmarks.validation.slim import FORCE, INCH, POUND
from dynamics import ARMS, Arm, Mode, Model, Payload
from dynamics.arms.measures import hertz
from dynamics.formulations.linearized import inertia
from dynamics.types import Array

RALF = "Yuan, Book and Huggins 1993: RALF"
SHUTTLE = "The Shuttle's arm, Cyril's subject: public data, none of them his"
NOTES = {
    RALF: "Tables are printed, their geometry is not. `ralf-like` has the parallel drive and mass "
    "spread evenly; elbow at 90 degrees, joints held, its EI is tuned to 6.37 Hz. With actuators "
    "their printed springs, times a lever arm squared, hold its joints; the arm is lost too: 0.5 m "
    "chosen beside table 7.2, tuned to 5.70 Hz beside table 7.3. At a right elbow actuator 1 "
    "alone moves the first frequency, actuator 2 the second. All else of ours is predicted.",
    SHUTTLE: "Frequencies of a finite-element model (Smithsonian NASM.2014.0025-bx011-fd006, table "
    "4), transcribed without the payload's label, beside `srms-like`, tuned to the light load's "
    "first four.",
}
ELBOW = (0.0, 0.5 * pi)  # [rad] the posture that the preset is tuned at

RALF_TABLES: dict[str, tuple[tuple[str | None, str | None], ...]] = {  # experiment, model [Hz]
    "7.1, without actuators, experiment and finite elements": (
        ("6.37", "5.95"), ("12.00", "12.78"), ("37.87", "30.19"), ("57.37", "60.60"),
        ("94.?", "95.05"),
    ),
    "7.2, with actuators, experiment and finite elements": (
        ("5.70", "6.08"), ("9.12", "9.12"), ("30.00", "29.70"), ("49.50", None),
    ),
    "7.3, with actuators, experiment and simplified model": (
        ("5.70", "5.82"), ("9.12", "9.18"), ("30.00", None), ("55.70", None),
    ),
}  # fmt: skip


SPRINGS = (1.54e3 * FORCE / INCH, 6.03e3 * FORCE / INCH)  # [N/m] of the two actuators, printed
LEVER = 0.5  # [m] chosen for the actuators `ralf-1` and `ralf-2`


def finer() -> Arm:
    """The preset `ralf-like` with five shapes per link."""
    like = ARMS["ralf-like"]
    modes = tuple(Mode(kind="poly", index=k, direction="y") for k in range(1, 6))
    return replace(like, links=tuple(replace(link, modes=modes) for link in like.links))


def on_springs(lever: float) -> list[float]:
    """Frequencies [Hz] of `finer`, its joints on the printed springs with one lever arm [m]."""
    M, K, joints = _matrices()
    springs = np.zeros(len(K))
    springs[joints] = np.array(SPRINGS) * lever**2
    squares = eigh(K + np.diag(springs), M, eigvals_only=True)
    return [float(x) for x in np.sqrt(squares) / (2.0 * pi)]


@cache
def _matrices() -> tuple[Array, Array, list[int]]:
    """M and K of `finer` at the posture ELBOW, and the indices of its joints."""
    arm = finer()
    model, q, joints = Model(arm), np.zeros(arm.n), list(arm.joint_index)
    q[joints] = ELBOW
    return inertia(model.chain, q), model.stiffness, joints


def tuned_lever() -> float:
    """Lever arm of both springs that gives 5.70 Hz [m]."""
    return float(brentq(lambda lever: on_springs(lever)[0] - 5.70, 0.1, 10.0))


def locked() -> list[float]:
    """Frequencies with joints locked [Hz]: the first by the tuned preset, others by `finer`."""
    return [hertz(ARMS["ralf-like"], angles=ELBOW)[0], *hertz(finer(), angles=ELBOW)[1:]]


TUNED = "ours: on springs, one lever arm of both tuned to this"
CHOSEN = "ours: on springs, lever arms of 0.5 m, chosen"
RALF_OURS: tuple[tuple[Callable[[], list[float]], str, str], ...] = (  # for each experiment
    (locked, "ours: ralf-like, EI tuned to this", "ours: ralf-like, five shapes per link"),
    (lambda: on_springs(LEVER), CHOSEN, CHOSEN),
    (lambda: on_springs(tuned_lever()), TUNED, "ours: on springs, with that lever arm"),
)


def ralf_tables() -> Iterator[Table]:
    """RALF: arithmetic of the printed actuators, and tables whose geometry is lost."""
    yield Table(
        chapter=RALF, title="Printed data", demand="within rounding of the print",
        rows=(
            *as_printed(("length of a link, 10 ft",), "3.048", "m"),
            *as_printed(("structure, 70 lb",), "31.75", "kg"),
            *relatively(("hydraulic spring 1, 1.54e3 lb/in",), "2.697e5", "N/m", 5e-4),
            *relatively(("hydraulic spring 2, 6.03e3 lb/in",), "1.056e6", "N/m", 5e-4),
            *as_printed(("hydraulic frequency 1 of (7.1a)",), "43.6", "Hz", 1.01),
            *as_printed(("hydraulic frequency 2 of (7.1b)",), "50.0", "Hz"),
            *as_printed(("damping ratio of (7.1b)",), "0.770", "", 1.01),
            Number(
                quantity="damping ratio of (7.1a)", printed="", claim=LOST,
                remark="3.8?6e2: the unreadable digit is 3 or 8, ζ = 0.700 or 0.709",
            ),
            Number(
                quantity="lever arm of both springs", printed="", unit="m", claim=LOST,
                remark="tuned to 5.70 Hz for table 7.3; longer than likely: 0.5 m in table 7.2",
            ),
        ),
        ours=lambda: [
            120 * INCH, 70 * POUND, *SPRINGS, sqrt(7.509e4) / (2 * pi),
            sqrt(9.869e4) / (2 * pi), 4.838e2 / (2 * sqrt(9.869e4)), nan,
            tuned_lever(),
        ],
    )  # fmt: skip
    for (title, pairs), ours in zip(RALF_TABLES.items(), RALF_OURS, strict=True):
        yield _ralf_table(title, pairs, *ours)


def _ralf_table(
    title: str,
    pairs: Sequence[tuple[str | None, str | None]],
    frequencies: Callable[[], list[float]],
    first: str,
    others: str,
) -> Table:
    """One RALF table: our frequencies for the experiment, none for the printed models.

    `first` is the remark on the first experimental number, `others` on the others.
    """
    rows: list[Number] = []
    places: list[int | None] = []  # index of our frequency for each row
    for k, pair in enumerate(pairs):
        for column, digits in zip(("experiment", "model"), pair, strict=True):
            if digits is None:
                continue
            shown = column == "experiment"
            remark = first if k == 0 else others
            if not shown:
                remark = "needs the printed arm's geometry"
            if "?" in digits:
                remark = f"{digits}: a digit is unreadable"
            rows.append(
                Number(
                    quantity=f"mode {k + 1}, {column}", unit="Hz",
                    printed="" if "?" in digits else digits, remark=remark,
                    claim=REPLACED if shown and "tuned to this" in remark else LOST,
                )
            )  # fmt: skip
            places.append(k if shown else None)

    def ours() -> list[float]:
        found = frequencies()
        return [nan if k is None else found[k] for k in places]

    return Table(
        chapter=RALF, title=f"Table {title}", rows=tuple(rows), ours=ours,
        demand="shown only: section, joints and lever arms are not printed",
    )  # fmt: skip


CONFIGURATION_S = {  # configuration S, presumably straight: printed [Hz], light and heavy payload
    "light": ("0.346", "0.461", "3.554", "4.228", "14.98", "15.14"),
    "heavy": ("0.0274", "0.0329", "0.0578", "0.140", "0.438", "2.976"),
}


def shuttle_tables() -> list[Table]:
    """The Shuttle's arm: public frequencies of another model, and those of the tuned preset."""
    like = ARMS["srms-like"]
    loaded = replace(like, payload=Payload(mass=32_000 * POUND))
    own = {"light": hertz(like), "heavy": hertz(loaded)}
    return [
        Table(
            chapter=SHUTTLE,
            title=f"Lowest frequencies, configuration S, {load} payload",
            demand="shown only: EI and springs tuned, payload and posture of the source unknown",
            rows=tuple(
                Number(
                    quantity=f"mode {k}", printed=digits, unit="Hz",
                    claim=REPLACED if load == "light" and k < 3 else INCOMPARABLE,
                    remark=_load_remark(load, k),
                )
                for k, digits in enumerate(printed, 1)
            ),
            ours=lambda f=own[load]: f[:6],  # type: ignore[misc]
        )
        for load, printed in CONFIGURATION_S.items()
    ]  # fmt: skip


def _load_remark(load: str, mode: int) -> str:
    if load == "heavy":
        return "ours: srms-like, tuned unloaded, point mass of 32 000 lb" * (mode == 1)
    return (
        "srms-like is tuned to it, rounded" if mode < 3 else "srms-like is tuned to it" * (mode < 5)
    )


def tables() -> list[Table]:
    """All tables of RALF and the Shuttle's arm."""
    return [*ralf_tables(), *shuttle_tables()]
