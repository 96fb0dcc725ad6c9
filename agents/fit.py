"""`flexarm fit LOG --arm ARM`: parameters of an arm from a log of its rig, and both motions."""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from agents.figures import COLOURS, new_figure, save_figure, tidy
from agents.files import FolderError, check_folder
from agents.metrics import write_json
from agents.sentences import one_line, speaker
from dynamics.load import load_arm
from dynamics.measured.fit import BOUNDS, CONFIDENCE, Fit, Gauge, fit
from dynamics.measured.log_file import UNITS, Columns, Log, read_log
from dynamics.model import compile_arm

WHITE = 0.2  # largest correlation of a residual's neighbours that counts as white
EXAMPLE = (
    "flexarm fit run.csv --arm slim --time t --command torque --encoder angle --gauge strain "
    "--gauge-at 1:0.05:0.0008 --units time=ms encoder=deg gauge=microstrain"
)


def main(arguments: list[str] | None = None, prog: str = "python -m agents.fit") -> int:
    """Run the command line; returns the exit status (2 and one sentence for unusable input)."""
    a = _parser(prog).parse_args(arguments)
    try:
        check_folder(a.out)
        bounds = BOUNDS if a.fit is None else dict(map(_range, a.fit))
        units = dict(_pair(text, "--units") for text in a.units)
        columns = Columns(
            time=a.time, command=tuple(a.command), encoder=tuple(a.encoder),
            gauge=tuple(a.gauge), units=units,
        )  # fmt: skip
        gauges = [_gauge(text, units.get("gauge", "1/m")) for text in a.gauge_at]
        log, arm = read_log(a.log, columns), load_arm(a.arm)
        found = fit(arm, log, gauges, bounds)
    except (ValueError, FolderError) as error:
        print(f"{speaker(prog)}: {one_line(error)}", file=sys.stderr)
        return 2
    a.out.mkdir(parents=True, exist_ok=True)
    title = f"{a.log.name} and {arm.name or a.arm}"
    kinds = ["encoder [rad]"] * log.encoder.shape[1] + [_unit(gauge) for gauge in gauges]
    draw(a.out / "overlay.png", log, found, kinds, title)
    write_json(a.out / "fit.json", {"log": a.log.name, "arm": a.arm} | found.to_dict())
    print(table(found))
    if "stiffness" in bounds and "payload_mass" not in bounds:
        print(frequencies(arm, found))
    for sentence in doubts(found):
        print(sentence)
    print(f"Everything is in {a.out}/")
    return 0


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Fit stiffness and damping of an arm to a log of its rig.",
        epilog=f"example: {EXAMPLE}",
    )
    add = parser.add_argument
    add("log", type=Path, metavar="LOG", help=".csv or .txt with a header line, or .mat")
    add("--arm", required=True, help="a preset's name or an arm file")
    add("--time", required=True, metavar="COLUMN")
    add("--command", nargs="+", required=True, metavar="COLUMN", help="torque of every joint")
    add("--encoder", nargs="+", required=True, metavar="COLUMN", help="of every joint")
    add("--gauge", nargs="+", default=[], metavar="COLUMN", help="strain or curvature")
    add("--gauge-at", nargs="+", default=[], metavar="LINK:X[:DISTANCE]",
        help="of every gauge: link from 1, metres from the joint, and of strain metres from the "
        "neutral axis")  # fmt: skip
    add("--units", nargs="+", default=[], metavar="KIND=UNIT",
        help="; ".join(f"{kind}: {', '.join(known)}" for kind, known in UNITS.items())
        + "; or a factor to SI (default: the first of each)")  # fmt: skip
    default = " ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in BOUNDS.items())
    add("--fit", nargs="+", metavar="NAME=LOW:HIGH",
        help=f"parameters and their bounds, times the arm's own (default: {default})")  # fmt: skip
    add("--out", type=Path, default=Path("fit"), metavar="DIR")
    return parser


def _pair(text: str, option: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"{option} takes NAME=VALUE, got {text!r}.")
    return name, value


def _numbers(text: str, option: str, form: str, counts: tuple[int, ...]) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise ValueError(f"{option} takes {form}, got {text!r}.")
    return numbers


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, value = _pair(text, "--fit")
    low, high = _numbers(value, "--fit", "NAME=LOW:HIGH", (2,))
    return name, (low, high)


def _gauge(text: str, unit: str) -> Gauge:
    link, *rest = _numbers(text, "--gauge-at", "LINK:X[:DISTANCE]", (2, 3))
    if link != int(link) or link < 1:
        raise ValueError(f"--gauge-at counts links from 1, got {text!r}.")
    if "strain" in unit and len(rest) < 2:
        raise ValueError(f"--gauge-at needs LINK:X:DISTANCE for {unit}, got {text!r}.")
    if unit == "1/m" and len(rest) > 1:
        raise ValueError(
            f"--gauge-at takes LINK:X for curvatures, got {text!r}; of strain, give the unit: "
            "--units gauge=strain."
        )
    return Gauge(link=int(link) - 1, x=rest[0], distance=rest[1] if len(rest) > 1 else 1.0)


def _unit(gauge: Gauge) -> str:
    return "curvature [1/m]" if gauge.distance == 1.0 else "strain [-]"


def table(found: Fit) -> str:
    """Parameters with intervals and bounds, then the residual of every signal."""
    lines = [f"{'parameter':14}{'fitted':>10}  {f'{CONFIDENCE:.0%} interval':^21}  bounds"]
    for (name, (low, high)), x, (least, most) in zip(
        found.bounds.items(), found.values, found.intervals, strict=True
    ):
        span = f"{least:.4g} to {most:.4g}"
        lines.append(f"{name:14}{x:10.4g}  {span:^21}  {low:g} to {high:g}")
    lines.append(f"\n{'residual':14}{'as described':>14}{'fitted':>12}  correlation of neighbours")
    for name, before, after, rho in zip(
        found.signals, found.rms(found.nominal), found.rms(found.fitted), found.correlation,
        strict=True,
    ):  # fmt: skip
        lines.append(f"{name:14}{before:14.4g}{after:12.4g}  {rho:.2f}")
    return "\n".join(lines)


def frequencies(arm: Any, found: Fit) -> str:
    """Sentence about the first frequency; all frequencies grow with the root of the stiffness."""
    first = float(compile_arm(arm).frequencies()[0]) / (2.0 * np.pi)
    values = dict(zip(found.bounds, found.values.tolist(), strict=True))
    root = values["stiffness"] ** 0.5
    sentence = f"First frequency, joints locked: {first:.4g} Hz as described, {first * root:.4g} Hz"
    if "damping" in values:
        sentence += f"; damping ratios: {values['damping'] / root:.4g} times those described"
    return sentence + "."


def doubts(found: Fit) -> list[str]:
    """Sentences about intervals that mean less than they say."""
    result = [
        f"{name} stopped at its bound; its interval means nothing." for name in found.at_bound
    ]
    coloured = [
        name for name, rho in zip(found.signals, found.correlation, strict=True) if abs(rho) > WHITE
    ]
    if coloured:
        result.append(
            f"The residual of {', '.join(coloured)} is not white: the arm lacks something that the "
            "rig has, and the intervals are too narrow."
        )
    return result


def draw(path: Path, log: Log, found: Fit, labels: list[str], title: str) -> None:
    """Draw the command, and every measured signal beside those of the arm before and after."""
    figure = new_figure(8.0, 1.6 + 2.0 * len(labels))
    top, *rest = figure.subplots(
        1 + len(labels), 1, sharex=True, height_ratios=[1, *[2] * len(labels)]
    )
    for k, command in enumerate(log.command.T):
        top.step(log.time, command, where="post", color=COLOURS[k], linewidth=1.0)
    top.set_ylabel("command\n[N m]")
    top.set_title(title, loc="left", fontsize=10)
    for k, (axes, label) in enumerate(zip(rest, labels, strict=True)):
        axes.plot(log.time, found.measured[:, k], ".", color=COLOURS[2], markersize=2.5)
        axes.plot(log.time, found.nominal[:, k], "--", color=COLOURS[1], linewidth=1.0)
        axes.plot(log.time, found.fitted[:, k], color=COLOURS[0], linewidth=1.2)
        axes.set_ylabel(f"{found.signals[k]}\n{label.partition(' ')[2]}")
    rest[-1].set_xlabel("time [s]")
    rest[-1].set_xlim(log.time[0], log.time[-1])
    figure.legend(
        rest[0].lines, ("measured", "as described", "fitted"), frameon=False, ncols=3,
        loc="outside upper right", markerscale=3,
    )  # fmt: skip
    for axes in (top, *rest):
        tidy(axes)
    save_figure(figure, path)


if __name__ == "__main__":
    sys.exit(main())
