"""Logs of a rig that is known, and what a fit finds in them.

    python -m benchmarks.accuracy.measured_data

The rig is simulated, since no log of a real one may be shipped: another arm than the fitted one,
moved by another integrator, read with noise and offsets. The command writes two logs, of a motor
that moves the arm and of a plucked arm whose joint is clamped, and fits them as `flexarm fit` does.
It counts how often the intervals of many such logs hold the truth: of a rig that differs in the
fitted parameters alone, of one with dry friction that the arm lacks, and of plucks. Logs, pictures
and data go to docs/results/measured_data*, the table is that of docs/measured_data.md.
"""

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from agents.fit import main as fit_command
from benchmarks.output import RESULTS, argument_parser, provenance, table, write_results
from dynamics import Arm, Model, compile_arm, load_arm, simulate
from dynamics.measured.fit import Fit, Gauge, fit
from dynamics.measured.log_file import Log
from dynamics.types import Array

PRESET = "quanser-rotary-flexible-link"
STIFFER, DAMPING_RATIO = 1.2, 0.02  # of the rig: times the preset's EI; the preset's ratio is 0.01
GAUGE = Gauge(link=0, x=0.02, distance=4.0e-4)  # [m] on a ruler of 0.8 mm
PERIOD, DURATION, TORQUE = 0.005, 3.0, 0.05  # [s], [s], [N m]
NOISE = {"encoder": 2e-3, "gauge": 0.05}  # [rad], [of the gauge's deviation]
GAUGE_OFFSET = 1e-4  # [-] strain
FRICTION = (0.0, 2e-3)  # [N m] Coulomb friction of the rigs; the arm has none
PLUCK, RELEASE = 0.02, 0.5  # [m] of the tip, [s] before it is let go
CLAMP = 1e6  # [kg m^2] of a rotor that does not move
LOGS = 100  # of each rig
_PLACE = ["--gauge", "strain", "--gauge-at", f"1:{GAUGE.x}:{GAUGE.distance}"]
COMMAND = [
    "--arm", PRESET, "--time", "t", "--command", "torque", "--encoder", "angle", *_PLACE,
    "--units", "time=ms", "command=mN m", "encoder=deg", "gauge=microstrain",
]  # fmt: skip
PLUCK_COMMAND = [
    "--arm", PRESET, "--time", "t", *_PLACE, "--units", "time=ms", "gauge=microstrain",
    "--held", "1", "--from", str(RELEASE),
]  # fmt: skip


def rig(friction: float = 0.0) -> Arm:
    """The arm that makes the logs: stiffer and more damped than the preset, friction [N m]."""
    preset = load_arm(PRESET)
    link = replace(
        preset.links[0],
        EIz=STIFFER * (preset.links[0].EIz or math.nan),
        damping_ratio=DAMPING_RATIO,
        joint=replace(preset.links[0].joint, coulomb=friction),
    )
    return replace(preset, links=(link,))


def truth() -> Array:
    """(2,) stiffness and damping of the rig, times the preset's; a ratio goes with the root."""
    ratio = DAMPING_RATIO / load_arm(PRESET).links[0].damping_ratio
    return np.array([STIFFER, ratio * math.sqrt(STIFFER)])


@dataclass(frozen=True)
class Held:
    """A torque that holds each of its values until the next time."""

    times: Array  # (N,) [s]
    values: Array  # (N,) [N m]

    @property
    def breakpoints(self) -> Array:
        """(N,) [s] times of the jumps."""
        return self.times

    def __call__(self, t: float) -> Array:
        k = int(np.searchsorted(self.times, t + 1e-9, side="right")) - 1
        return self.values[[k]]


def clean_log(arm: Arm) -> Log:
    """The arm's motion without noise under a square wave whose frequency rises and falls."""
    t: Array = PERIOD * np.arange(float(round(DURATION / PERIOD)))
    frequency = 4.0 - 4.0 * np.abs(t / DURATION - 0.5)  # [Hz]
    torque = TORQUE * np.sign(np.sin(2.0 * np.pi * np.cumsum(frequency) * PERIOD))
    model = compile_arm(arm)
    motion = simulate(model, np.zeros(model.n), np.zeros(model.n), Held(t, torque), t)
    return Log(t, torque[:, None], motion.q[:, :1], _strain(model, motion.q))


def pluck_log(arm: Arm) -> Log:
    """Strain without noise of the clamped arm, whose tip is held aside and let go at RELEASE."""
    joint = replace(arm.links[0].joint, rotor_inertia=CLAMP)
    model = compile_arm(replace(arm, links=(replace(arm.links[0], joint=joint),)))
    tip = np.array(model.chain.links[0].tip_phi)[:, 1]
    bent = np.linalg.solve(model.stiffness[1:, 1:], tip)  # by a force at the tip
    q = np.append(0.0, PLUCK * bent / (tip @ bent))
    t: Array = PERIOD * np.arange(float(round((RELEASE + DURATION) / PERIOD)))
    start = int(np.searchsorted(t, RELEASE))
    motion = simulate(model, q, np.zeros(model.n), None, t[start:])
    strain = np.vstack([np.tile(_strain(model, q[None]), (start, 1)), _strain(model, motion.q)])
    none = np.zeros((t.size, 0))
    return Log(t, none, none, strain)


def _strain(model: Model, q: Array) -> Array:
    """(N, 1) strain that the gauge reads at states q (N, n)."""
    return np.array([GAUGE.distance * model.strain(x, GAUGE.link, GAUGE.x)[2:] for x in q])


def noisy(log: Log, seed: int) -> Log:
    """The log as the rig's sensors give it."""
    rng = np.random.default_rng(seed)
    encoder = log.encoder + NOISE["encoder"] * rng.standard_normal(log.encoder.shape)
    spread = NOISE["gauge"] * log.gauge.std() * rng.standard_normal(log.gauge.shape)
    return replace(log, encoder=encoder, gauge=log.gauge + spread + GAUGE_OFFSET)


def columns(log: Log) -> dict[str, Array]:
    """Columns of a log in the units of a rig: ms, mN m, degrees, microstrain."""
    result = {"t": 1e3 * log.time}
    if log.command.size:
        result |= {"torque": 1e3 * log.command[:, 0], "angle": np.degrees(log.encoder[:, 0])}
    return result | {"strain": 1e6 * log.gauge[:, 0]}


def write_log(path: Path, named: Mapping[str, Array]) -> None:
    """Write columns to a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(named)
        rows = zip(*named.values(), strict=True)
        writer.writerows([f"{x:.7g}" for x in row] for row in rows)


def coverage(name: str, log: Log, logs: int, held: Mapping[int, float | None]) -> dict[str, Any]:
    """Shares of intervals that hold the truth, and means and deviations of the estimates."""
    fits = [fit(PRESET, noisy(log, seed), [GAUGE], held=held) for seed in range(logs)]
    values = np.array([one.values for one in fits])
    held_truth = np.array([holds(one) for one in fits])
    return {
        "rig": name,
        "logs": logs,
        "truth": truth().tolist(),
        "held": held_truth.mean(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "deviation": values.std(axis=0).tolist(),
        "half_width": np.mean([np.ptp(one.intervals, axis=1) / 2 for one in fits], axis=0).tolist(),
        "correlation": np.mean([one.correlation for one in fits], axis=0).tolist(),
    }


def holds(found: Fit) -> Array:
    """(2,) True for the intervals that hold the truth."""
    low, high = found.intervals.T
    result: Array = (low <= truth()) & (truth() <= high)
    return result


def page_table(cases: list[dict[str, Any]]) -> str:
    """Markdown table of the coverages."""
    rows = []
    for case in cases:
        for k, name in enumerate(("stiffness", "damping")):
            rows.append((
                case["rig"], name, f"{case['truth'][k]:.4g}",
                f"{case['mean'][k]:.4g}", f"{case['deviation'][k]:.2g}",
                f"{case['half_width'][k]:.2g}", f"{100 * case['held'][k]:.0f} %",
                f"{max(map(abs, case['correlation'])):.2f}",
            ))  # fmt: skip
    header = ("rig", "parameter", "truth", "mean", "deviation", "mean half width",
              "hold the truth", "correlation")  # fmt: skip
    return table(header, rows, "llrrrrrr")


def fitted(name: str, command: list[str]) -> dict[str, Any]:
    """Fit a log of docs/results by the command, keep its picture; returns what it writes."""
    with TemporaryDirectory() as out:
        if fit_command([str(RESULTS / f"{name}.csv"), *command, "--out", out]):
            raise SystemExit("The fit refuses its own log.")
        (RESULTS / f"{name}.png").write_bytes((Path(out) / "overlay.png").read_bytes())
        found: dict[str, Any] = json.loads((Path(out) / "fit.json").read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Write logs, pictures and data; put the table into the page."""
    argument_parser("accuracy.measured_data", __doc__).parse_args()
    cases = [
        coverage(f"motor, friction of {1e3 * friction:g} mN m", clean_log(rig(friction)), LOGS, {})
        for friction in FRICTION
    ]
    decay = pluck_log(rig())
    cases.append(coverage("clamped, plucked", decay.since(RELEASE), LOGS, {0: None}))
    write_log(RESULTS / "measured_data.csv", columns(noisy(clean_log(rig()), 0)))
    write_log(RESULTS / "measured_data_pluck.csv", columns(noisy(decay, 0)))
    data = provenance("numpy", "scipy", "numba") | {
        "fit": fitted("measured_data", COMMAND),
        "pluck": fitted("measured_data_pluck", PLUCK_COMMAND),
        "cases": cases,
    }
    write_results(RESULTS / "measured_data.json", data)
    print(page_table(cases))


if __name__ == "__main__":
    main()
