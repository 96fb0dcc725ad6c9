"""Logs of a rig that is known, and what a fit finds in them.

    python -m benchmarks.measured_data

The rig is simulated, since no log of a real one may be shipped: another arm than the fitted one,
moved by another integrator, read with noise and offsets. The command writes one log, fits it as
`flexarm fit` does, and counts how often the intervals of many such logs hold the truth: of a rig
that differs in the fitted parameters alone, and of one with dry friction that the arm lacks. Log,
picture and data go to docs/results/measured_data.*, the table is that of docs/measured_data.md.
"""

import csv
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from agents.fit import main as fit_command
from benchmarks.output import RESULTS, argument_parser, provenance, table
from dynamics import Arm, compile_arm, load_arm, simulate
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
LOGS = 100  # of each rig
COMMAND = [
    "--arm", PRESET, "--time", "t", "--command", "torque", "--encoder", "angle",
    "--gauge", "strain", "--gauge-at", f"1:{GAUGE.x}:{GAUGE.distance}",
    "--units", "time=ms", "command=mN m", "encoder=deg", "gauge=microstrain",
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
    strain = [GAUGE.distance * model.strain(q, GAUGE.link, GAUGE.x)[2] for q in motion.q]
    return Log(t, torque[:, None], motion.q[:, :1], np.array(strain)[:, None])


def noisy(log: Log, seed: int) -> Log:
    """The log as the rig's sensors give it."""
    rng = np.random.default_rng(seed)
    encoder = log.encoder + NOISE["encoder"] * rng.standard_normal(log.encoder.shape)
    spread = NOISE["gauge"] * log.gauge.std() * rng.standard_normal(log.gauge.shape)
    return replace(log, encoder=encoder, gauge=log.gauge + spread + GAUGE_OFFSET)


def write_log(path: Path, log: Log) -> None:
    """Write a log in the units of a rig: ms, mN m, degrees, microstrain."""
    columns = (1e3 * log.time, 1e3 * log.command[:, 0], np.degrees(log.encoder[:, 0]))
    rows = zip(*columns, 1e6 * log.gauge[:, 0], strict=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["t", "torque", "angle", "strain"])
        writer.writerows([f"{x:.7g}" for x in row] for row in rows)


def coverage(friction: float, logs: int) -> dict[str, Any]:
    """Shares of intervals that hold the truth, and means and deviations of the estimates."""
    log = clean_log(rig(friction))
    fits = [fit(PRESET, noisy(log, seed), [GAUGE]) for seed in range(logs)]
    values = np.array([one.values for one in fits])
    held = np.array([holds(one) for one in fits])
    return {
        "friction": friction,
        "logs": logs,
        "truth": truth().tolist(),
        "held": held.mean(axis=0).tolist(),
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
                f"{1e3 * case['friction']:g} mN m", name, f"{case['truth'][k]:.4g}",
                f"{case['mean'][k]:.4g}", f"{case['deviation'][k]:.2g}",
                f"{case['half_width'][k]:.2g}", f"{100 * case['held'][k]:.0f} %",
                f"{max(map(abs, case['correlation'])):.2f}",
            ))  # fmt: skip
    header = ("rig's friction", "parameter", "truth", "mean", "deviation", "mean half width",
              "hold the truth", "correlation")  # fmt: skip
    return table(header, rows, "llrrrrrr")


def main() -> None:
    """Write log, picture and data; put the table into the page."""
    argument_parser("measured_data", __doc__).parse_args()
    cases = [coverage(friction, LOGS) for friction in FRICTION]
    write_log(RESULTS / "measured_data.csv", noisy(clean_log(rig()), 0))
    with TemporaryDirectory() as out:
        given = [str(RESULTS / "measured_data.csv"), *COMMAND, "--out", out]
        if fit_command(given):
            raise SystemExit("The fit refuses its own log.")
        (RESULTS / "measured_data.png").write_bytes((Path(out) / "overlay.png").read_bytes())
        found = json.loads((Path(out) / "fit.json").read_text(encoding="utf-8"))
    data = provenance("numpy", "scipy", "numba") | {"fit": found, "cases": cases}
    text = json.dumps(data, indent=1) + "\n"
    (RESULTS / "measured_data.json").write_text(text, encoding="utf-8")
    print(page_table(cases))


if __name__ == "__main__":
    main()
