"""`flexarm fit LOG --arm ARM`: parameters of an arm from a log of its rig, and both motions."""

import argparse
import math
import shlex
import sys
from collections.abc import Collection
from pathlib import Path

import numpy as np

from agents.figures import COLOURS, new_figure, save_figure, tidy
from agents.files import FolderError, check_folder, write_json
from agents.sentences import refused
from dynamics.command import completed
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.description.data_file import user_path
from dynamics.load import load_arm
from dynamics.measured.columns import SLIDING, UNITS
from dynamics.measured.fit import BOUNDS, CONFIDENCE, Fit, fit
from dynamics.measured.log_file import Columns, Log, read_log
from dynamics.measured.motion import STARTS
from dynamics.measured.sensors import Gauge, LinkAngle, Sensor, TipSlope
from dynamics.model import compile_arm
from dynamics.types import Array

UNEXPLAINED = 0.9  # [of a signal's deviation] residual of a signal that the fit does not follow
WHITE = 0.2  # largest correlation of a residual's neighbours that counts as white
CHANCE = 3.0  # deviations of that correlation, 1 / root of the readings, that chance may give
FEW = 0.01  # [of a signal's readings] that hold half of the squared residual if they are spikes
RESULTS = "fit.json"
EXAMPLE = (
    "flexarm fit run.csv --arm slim --time t --command torque --encoder angle --gauge strain "
    "--gauge-at 1:0.05:0.0008 --units time=ms encoder=deg gauge=microstrain"
)
PLUCK_EXAMPLE = (
    "flexarm fit pluck.csv --arm slim --time t --gauge strain --gauge-at 1:0.05:0.0008 "
    "--units gauge=microstrain --held 1 --from 1.2"
)


def main(arguments: list[str] | None = None, prog: str = "python -m agents.fit") -> int:
    """Run the command line; returns the exit status (2 and one sentence for unusable input)."""
    a = _parser(prog).parse_args(arguments)
    try:
        check_folder(a.out)
        bounds = validate.unique([*map(_range, a.fit)], "--fit") if a.fit else BOUNDS
        units = validate.unique([*map(_unit_of, a.units)], "--units")
        columns = Columns(
            time=a.time, command=tuple(a.command), encoder=tuple(a.encoder),
            gauge=tuple(a.gauge), units=units, titles=tuple(a.titles),
        )  # fmt: skip
        log, arm = read_log(a.log, columns), load_arm(a.arm)
        begin = float(log.time[0])
        log = log.since(begin if a.since is None else a.since, a.to)
        if len(a.gauge_at) != len(a.gauge):
            raise ValueError(
                "--gauge-at needs a place LINK:X[:DISTANCE] for each column of --gauge, got "
                f"{len(a.gauge_at)} places for {len(a.gauge)} columns."
            )
        gauges = [
            _sensor(place, columns.unit(name, "gauge"), len(arm.links))
            for place, name in zip(a.gauge_at, a.gauge, strict=True)
        ]
        numbered = validate.unique([_held(text, arm.n_joint) for text in a.held], "--held")
        held = {joint - 1: angle for joint, angle in numbered.items()}
        _check_units(columns, arm, held)
        found = fit(arm, log, gauges, bounds, start=a.start, held=held, shooting=a.shooting)
    except (ValueError, FolderError) as error:
        return refused(prog, error)
    print(table(found))
    if "stiffness" in bounds and "payload_mass" not in bounds:
        print(frequencies(arm, found))
    if a.since is not None and a.since < begin:
        print(f"--from {a.since:g} leaves out nothing: the log begins at {begin:.6g} s.")
    for sentence in [*doubts(found, bool(log.command.any())), *spikes(found, log.time)]:
        print(sentence)
    name = ", ".join(path.name for path in a.log)
    title = f"{a.log[0].name} and {arm.name or a.arm}"
    turns = _joint_units(arm, "[rad]", "[m]")
    units_read = [turns[k] for k in range(arm.n_joint) if k not in held] + [*map(_unit, gauges)]
    former = (a.out / RESULTS).exists()
    try:
        a.out.mkdir(parents=True, exist_ok=True)
        write_json(a.out / RESULTS, {"log": name, "arm": a.arm} | found.to_dict())
        draw(a.out / "overlay.png", log, found, units_read, title)
    except OSError as error:
        return refused(prog, f"writing to {a.out} failed ({error.strerror or error}).", 1)
    print(f"Everything is in {a.out}/{', in place of a former fit' * former}")
    return 0


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Fit stiffness, damping and other parameters of an arm to a log of its rig.",
        epilog="examples:\n  a motor moves the arm:\n"
        f"    {EXAMPLE}\n  the joint is clamped, the tip plucked and let go after 1.2 s:\n"
        f"    {PLUCK_EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("log", type=user_path, nargs="+", metavar="LOG",
        help="text of a logger or a spreadsheet (.csv, .txt, .dat), or .mat files of one run; a "
        "COLUMN is its title, its number from 1, or as VARIABLE, VARIABLE:COLUMN, STRUCT.FIELD of "
        "a .mat file")  # fmt: skip
    add("--arm", required=True, help="a preset's name or an arm file")
    add("--time", required=True, metavar="COLUMN")
    add("--command", nargs="+", action="extend", default=[], metavar="COLUMN",
        help="torque of every joint; none: zero throughout, as in a free decay")  # fmt: skip
    add("--encoder", nargs="+", action="extend", default=[], metavar="COLUMN",
        help="of every joint; those of held joints may be left out")  # fmt: skip
    add("--gauge", nargs="+", action="extend", default=[], metavar="COLUMN",
        help="strain, curvature, or an angle of a bent link")  # fmt: skip
    add("--gauge-at", nargs="+", action="extend", default=[], metavar="LINK:X[:DISTANCE]",
        help="of every gauge: link from 1, metres from its root, and of strain metres from the "
        "neutral axis; of an angle LINK:angle (of the tip about the root) or LINK:slope (of the "
        "tip)")  # fmt: skip
    add("--titles", nargs="+", action="extend", default=[], metavar="TITLE",
        help="of all columns of a text file without a header line")  # fmt: skip
    add("--units", nargs="+", action="extend", default=[], metavar="KIND=UNIT",
        help="; ".join(f"{kind}: {', '.join(known)}" for kind, known in UNITS.items())
        + "; or a factor to SI (default: the first); or of one column: COLUMN=UNIT")  # fmt: skip
    add("--held", nargs="+", action="extend", default=[], metavar="JOINT[:ANGLE]",
        help="joints, from 1, that a clamp or a stiff drive holds, and their angles in rad "
        "(default: the mean of the encoder, or 0 without one)")  # fmt: skip
    add("--start", choices=STARTS, default=STARTS[0],
        help="of the log: deflections and rates are estimated with the parameters, or the arm is "
        "straight and at rest, or they are those of encoders and gauges "
        "(default: %(default)s)")  # fmt: skip
    add("--shooting", type=float, metavar="SECONDS",
        help="start the motion again from encoders and gauges after each such time, so that no "
        "drift grows; with --start measured")  # fmt: skip
    add("--from", dest="since", type=float, metavar="SECONDS",
        help="leave out the samples before this time, such as those before a plucked tip is let "
        "go")  # fmt: skip
    add("--to", type=float, default=math.inf, metavar="SECONDS",
        help="leave out the samples after this time")  # fmt: skip
    default = " ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in BOUNDS.items())
    add("--fit", nargs="+", action="extend", metavar="NAME=LOW:HIGH",
        help="parameters and their bounds: stiffness, damping, friction, times the arm's own; "
        "payload_mass [kg]; of joint 1 viscous_1 [N m s/rad], coulomb_1 [N m], and torque_1, times "
        "the logged one; of a signal gain_gauge_1, delay_gauge_1 [s] and lag_gauge_1 [s], the time "
        "constant of a low pass of second order, or of encoder_1, "
        f"link_angle_1, tip_slope_1 (default: {default})")  # fmt: skip
    add("--out", type=user_path, default=Path("fit"), metavar="DIR",
        help="folder, whose former fit is replaced (default: %(default)s)")  # fmt: skip
    return parser


def _pair(text: str, option: str, form: str) -> tuple[str, str]:
    name, equals, value = text.rpartition("=")
    if not equals:
        raise ValueError(f"{option} takes {form}, got {text!r}.")
    return name, value


def _unit_of(text: str) -> tuple[str, str]:
    return _pair(text, "--units", "KIND=UNIT")


def _numbers(text: str, option: str, form: str, counts: tuple[int, ...]) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        raise ValueError(f"{option} takes {form}, got {text!r}.")
    return numbers


def _range(text: str) -> tuple[str, tuple[float, float]]:
    form = "NAME=LOW:HIGH"
    name, value = _pair(text, "--fit", form)
    low, high = _numbers(value, "--fit", form, (2,))
    return name, (low, high)


def _sensor(text: str, unit: str, count: int) -> Sensor:
    number, _, kind = text.partition(":")
    if kind in ("angle", "slope"):
        (link,) = _numbers(number, "--gauge-at", "LINK:angle or LINK:slope", (1,))
        index = _counted(link, "link", count, "--gauge-at", text)
        if unit in ("1/m", "strain", "microstrain"):
            raise ValueError(
                f"--gauge-at {text} is an angle, but its unit is {unit}; give the unit: --units "
                "gauge=rad."
            )
        return LinkAngle(link=index) if kind == "angle" else TipSlope(link=index)
    if unit in ("rad", "deg", "mrad"):
        raise ValueError(
            f"--gauge-at needs LINK:angle or LINK:slope for a column in {unit}, got {text!r}."
        )
    link, *rest = _numbers(text, "--gauge-at", "LINK:X[:DISTANCE]", (2, 3))
    index = _counted(link, "link", count, "--gauge-at", text)
    if "strain" in unit and len(rest) < 2:
        raise ValueError(f"--gauge-at needs LINK:X:DISTANCE for {unit}, got {text!r}.")
    if unit == "1/m" and len(rest) > 1:
        raise ValueError(
            f"--gauge-at takes LINK:X for curvatures, got {text!r}; of strain, give the unit: "
            "--units gauge=strain."
        )
    return Gauge(link=index, x=rest[0], distance=rest[1] if len(rest) > 1 else 1.0)


def _held(text: str, count: int) -> tuple[int, float | None]:
    """Joint, counted from 1, and its angle, if one is given."""
    joint, *rest = _numbers(text, "--held", "JOINT[:ANGLE]", (1, 2))
    return 1 + _counted(joint, "joint", count, "--held", text), rest[0] if rest else None


def _counted(number: float, noun: str, count: int, option: str, text: str) -> int:
    """Index of a link or joint that is counted from 1."""
    if number not in range(1, count + 1):
        raise ValueError(
            f"{option} counts {noun}s from 1: {noun} must be between 1 and {count}, the arm's "
            f"{noun}s, got {text!r}."
        )
    return int(number) - 1


def _check_units(columns: Columns, arm: Arm, held: Collection[int]) -> None:
    """Refuse units of angles and torques for joints that slide, and the reverse."""
    free = [joint for joint in range(arm.n_joint) if joint not in held]
    slides = [arm.links[k].joint.type == "prismatic" for k in arm.joints]
    for kind, sliding in SLIDING.items():
        names = getattr(columns, kind)
        joints = free if len(names) == len(free) else range(arm.n_joint)
        for name, joint in zip(names, joints, strict=False):  # other counts are refused by the fit
            unit = columns.units.get(name, columns.units.get(kind))
            if unit in UNITS[kind] and (unit in sliding) != slides[joint]:
                fitting = [x for x in UNITS[kind] if (x in sliding) == slides[joint]]
                raise ValueError(
                    f"column {name!r} is in {unit}, but joint {joint + 1} "
                    f"{'slides' if slides[joint] else 'turns'}; give its own unit, one of "
                    f"{fitting}: --units {shlex.quote(f'{name}={fitting[0]}')}."
                )


def _unit(gauge: Sensor) -> str:
    if not isinstance(gauge, Gauge):
        return "[rad]"
    return "[1/m]" if gauge.distance == 1.0 else "[-]"


def _joint_units(arm: Arm, turning: str, sliding: str) -> list[str]:
    """Unit of a quantity of every joint."""
    types = [arm.links[k].joint.type for k in arm.joints]
    return [sliding if name == "prismatic" else turning for name in types]


def table(found: Fit) -> str:
    """Parameters with intervals and bounds, then the residual of every signal."""
    width = max(14, *(2 + len(name) for name in found.bounds))
    lines = [f"{'parameter':{width}}{'fitted':>10}  {f'{CONFIDENCE:.0%} interval':^21}  bounds"]
    for (name, (low, high)), x, (least, most) in zip(
        found.bounds.items(), found.values, found.intervals, strict=True
    ):
        half = max(0.5 * (most - least), sys.float_info.min)
        digits = min(max(1 - math.floor(math.log10(half)), 0), 9)  # two of the half width
        span = f"{least:.{digits}f} to {most:.{digits}f}"
        lines.append(f"{name:{width}}{x:10.{digits}f}  {span:^21}  {low:g} to {high:g}")
    lines.append(f"\n{'residual':14}{'as described':>14}{'fitted':>12}{'explained':>12}  "
                 "correlation of neighbours")  # fmt: skip
    for name, before, after, share, rho in zip(
        found.signals, found.rms(found.nominal), found.rms(found.fitted),
        found.explained(found.fitted), found.correlation, strict=True,
    ):  # fmt: skip
        lines.append(f"{name:14}{before:14.4g}{after:12.4g} {share:11.2%}  {rho:.2f}")
    return "\n".join(lines)


def frequencies(arm: Arm, found: Fit) -> str:
    """Sentence about the first frequency in the posture at the start of the log.

    All frequencies grow with the root of the stiffness.
    """
    model = compile_arm(arm)
    posture = np.array([found.start[name][0] for name in model.names])
    first = float(model.frequencies(posture)[0]) / (2.0 * np.pi)
    values = dict(zip(found.bounds, found.values.tolist(), strict=True))
    root = values["stiffness"] ** 0.5
    locked = "joints locked, without gravity" if any(arm.gravity) else "joints locked"
    sentence = f"First frequency, {locked}: {first:.4g} Hz as described, {first * root:.4g} Hz"
    if "damping" in values:
        sentence += f"; damping ratios: {values['damping'] / root:.4g} times those described"
    return sentence + "."


def doubts(found: Fit, driven: bool = True) -> list[str]:
    """Sentences about a fit that means less than it says, to a log with or without torque."""
    result = [
        f"{name} stopped at its bound, so its interval means nothing: widen --fit or look for a "
        "wrong unit, unless the bound is a physical one."
        for name in found.at_bound
        if name not in found.untold
    ]
    result += [
        f"The log does not tell {name}: its interval is wider than its bounds. Leave it out of "
        "--fit, or log a motion that depends on it."
        for name in found.untold
    ]
    chance = CHANCE / np.sqrt(np.isfinite(found.measured).sum(axis=0))
    arm = found.arm
    bends = "stiffness" in found.bounds and any(link.modes for link in arm.links)
    if bends and any(arm.gravity) and not arm.foreshortening:
        result.append(
            "Gravity along a link, which stiffens one that hangs and softens one that stands, acts "
            "in an arm with foreshortening: true; in this one the fitted stiffness has its part."
        )
    coloured = [
        name for name, rho, least in zip(found.signals, found.correlation, chance, strict=True)
        if abs(rho) > max(WHITE, least)
    ]  # fmt: skip
    if coloured:
        result.append(
            f"The residual of {', '.join(coloured)} is not white: the arm lacks something that the "
            "rig has, and the intervals are too narrow."
        )
    if coloured and not driven:
        result.append(
            "The torque is zero throughout: name --command if there was one, and begin a free "
            "decay at its release by --from."
        )
    unexplained = [
        name for name, rms, size in zip(
            found.signals, found.rms(found.fitted), np.nanstd(found.measured, axis=0), strict=True
        ) if rms > UNEXPLAINED * size
    ]  # fmt: skip
    if unexplained:
        result.append(
            f"The fit explains nothing of {', '.join(unexplained)}: check columns, units and signs."
        )
    turning = {f"encoder {k}" for k, x in enumerate(_joint_units(arm, "turns", ""), 1) if x}
    residuals = (found.measured - found.fitted).T
    wrapped = [
        name for name, residual in zip(found.signals, residuals, strict=True)
        if name in turning and np.abs(np.diff(residual[np.isfinite(residual)])).max() > np.pi
    ]  # fmt: skip
    if wrapped:
        result.append(
            f"A reading of {', '.join(wrapped)} is more than half a turn from its neighbour, where "
            "the arm is not: if the encoder begins anew after a turn, unwrap its column."
        )
    clamped = [name.removeprefix("encoder ") for name in unexplained if name.startswith("encoder")]
    if clamped:
        result.append(f"If a joint was clamped, say so: --held {' '.join(clamped)}.")
    return result


def spikes(found: Fit, time: Array) -> list[str]:
    """Sentences about signals of which FEW of the readings hold half of the squared residual."""
    result = []
    for name, residual in zip(found.signals, (found.measured - found.fitted).T, strict=True):
        there = np.flatnonzero(np.isfinite(residual))
        squares = residual[there] ** 2
        order = np.argsort(squares)[::-1]
        count = 1 + int(np.searchsorted(np.cumsum(squares[order]), 0.5 * squares.sum()))
        if count <= max(1.0, FEW * there.size):
            result.append(
                f"Half of the squared residual of {name} is of {count} of its {there.size} "
                f"readings, the largest at {time[there[order[0]]]:.6g} s: if they are spikes, or "
                "codes of a lost reading, empty their cells."
            )
    return result


def draw(path: Path, log: Log, found: Fit, units: list[str], title: str) -> None:
    """Draw the commands, and every measured signal beside those of the arm before and after."""
    driven = log.command.shape[1] > 0
    forces = _joint_units(found.arm, "[N m]", "[N]")
    figure = new_figure(8.0, 0.6 + driven + 2.0 * len(units))
    heights = [1] * driven + [2] * len(units)
    every = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)
    every, rest = every[:, 0], every[driven:, 0]
    for k, command in enumerate(log.command.T):
        colour = COLOURS[k % len(COLOURS)]
        every[0].step(log.time, command, where="post", color=colour, linewidth=1.0)
        every[0].set_ylabel("command\n" + ", ".join(dict.fromkeys(forces)))
    every[0].set_title(title, loc="left", fontsize=10)
    for k, (axes, unit) in enumerate(zip(rest, units, strict=True)):
        axes.plot(log.time, found.measured[:, k], ".", color=COLOURS[2], markersize=2.5)
        axes.plot(log.time, found.nominal[:, k], "--", color=COLOURS[1], linewidth=1.0)
        axes.plot(log.time, found.fitted[:, k], color=COLOURS[0], linewidth=1.2)
        axes.set_ylabel(f"{found.signals[k]}\n{unit}")
    rest[-1].set_xlabel("time [s]")
    rest[-1].set_xlim(log.time[0], log.time[-1])
    figure.legend(
        rest[0].lines, ("measured", "as described", "fitted"), frameon=False, ncols=3,
        loc="outside upper right", markerscale=3,
    )  # fmt: skip
    for axes in every:
        tidy(axes)
    save_figure(figure, path)


if __name__ == "__main__":
    sys.exit(completed("agents.fit", main))
