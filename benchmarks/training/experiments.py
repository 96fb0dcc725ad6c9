"""Overview of the experiments that `benchmarks.training` has stored, without training.

    python -m benchmarks.training.experiments

Writes docs/results/experiments.md and experiments.png, the page and the learning curves of every
experiment, and into the files of the shipped ones what their training seeds gave.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median, stdev
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from agents.comparison import UNTRAINED, WARM_START, titled
from agents.experiments import shipped_experiments
from agents.figures import COLOURS, new_figure, plot_learning_curve, save_figure, tidy
from agents.leaderboard.shipped import on_base
from agents.sentences import plain
from agents.tune.learners import SCALED
from benchmarks.output import RESULTS, argument_parser, table
from dynamics.types import AnyArray

SMALLEST = 0.001  # smaller values are printed as "< 0.001"
CURVES_BESIDE = 4  # learning curves in a row of the overview
FASTER = 4  # joint PD is also shown at this multiple of the control rate, without a verdict
COLUMNS = {  # metric: (header, factor, format)
    "success_rate": ("success [%]", 100.0, ".0f"),
    "settling_time": ("settling [s]", 1.0, ".2f"),
    "tip_error_final": ("tip error, end [mm]", 1e3, ".3g"),
    "tip_error_rms": ("tip error, RMS [mm]", 1e3, ".3g"),
    "residual_vibration": ("residual vibration [mm]", 1e3, ".2g"),
    "peak_root_curvature": ("peak root curvature [1/m]", 1.0, ".2g"),
    "effort": ("effort [N²m²s]", 1.0, ".2g"),
}

STATED = {"Track": ("success_rate", "tip_error_rms")}  # metrics in an experiment's file, by task
OTHERS = ("success_rate", "settling_time", "residual_vibration")
COMMENT = re.compile(r"^# Expected.*\n(?:#.*\n)*", re.MULTILINE)  # to the end of the comments

SETTLING_RULE = """\
"Wins" means: settles in at most a third of joint PD's time, with at most a tenth of its residual
vibration and no lower success rate; that joint PD acts at the policy's control rate."""
FOLLOWING_RULE = """\
"Wins" means: follows with at most a third of joint PD's RMS tip error and no lower success rate;
that joint PD acts at the policy's control rate."""


def cells(summary: Mapping[str, float | None]) -> list[str]:
    """Texts of the summary's COLUMNS."""
    return [cell(name, summary[name]) for name in COLUMNS]


def cell(name: str, value: float | None) -> str:
    """Text of a metric in the unit of its column."""
    _, factor, style = COLUMNS[name]
    shown = factor * number(value)
    if math.isinf(shown):
        return "never" if name == "settling_time" else "failed"
    return f"< {SMALLEST}" if 0.0 < shown < SMALLEST else plain(shown, style)


def number(value: float | None) -> float:
    """A number read from JSON; null (an infinite value) and NaN become infinity."""
    return math.inf if value is None or math.isnan(value) else float(value)


def stored(out: Path) -> list[dict[str, Any]]:
    """Experiments whose JSON files are in the folder."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*.json"))]
    return [data for data in found if "references" in data and "runs" in data]


def stored_seconds(name: str) -> dict[int, float]:
    """[s] of the trainings of an experiment's stored results, by seed; none without results."""
    file = RESULTS / f"{name}.json"
    runs = json.loads(file.read_text(encoding="utf-8"))["runs"] if file.exists() else []
    return {run["seed"]: run["seconds"] for run in runs}


def summarise_experiments(out: Path, only: str | None = None) -> None:
    """Write all pages of the experiments in a folder, and the learning curves of all or of one."""
    experiments = stored(out)
    (out / "experiments.md").write_text(overview(experiments), encoding="utf-8")
    save_figure(learning_curves(experiments), out / "experiments.png")
    for data in experiments:
        (out / f"{data['name']}.md").write_text(page(data), encoding="utf-8")
        if only in (None, data["name"]):
            picture = out / f"{data['name']}.png"
            plot_learning_curve(picture, stored_curves(data), curves_title(data))


def stored_curves(data: Mapping[str, Any]) -> dict[str, list[dict[str, float | None]]]:
    """Rows of the learning curves of a stored experiment, by training seed."""
    return {
        name: [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        for name, columns in data["curves"].items()
    }


def curves_title(data: Mapping[str, Any]) -> str:
    """Algorithm with its base, environment and hardware of a stored experiment."""
    config = data["config"]
    learner = config["agent"]["name"] + on_base(config.get("base"))
    return f"{learner} on {titled(data['env'], config['env']['kwargs'])}"


def band(curves: Mapping[str, Mapping[str, Any]]) -> tuple[AnyArray, AnyArray]:
    """(k,) steps, and (3, k) least, median and largest return over the training seeds.

    None, k = 0, if no episode of a seed has ended.
    """
    known = [[(x, y) for x, y in zip(c["steps"], c["return"], strict=True) if y is not None]
             for c in curves.values()]  # fmt: skip
    if not all(known):
        return np.empty(0), np.empty((3, 0))
    lines = [np.array(points).T for points in known]
    steps = lines[0][0]
    returns = [np.interp(steps, *line) for line in lines]
    return steps, np.quantile(returns, (0.0, 0.5, 1.0), axis=0)


def learning_curves(experiments: Sequence[Mapping[str, Any]]) -> Figure:
    """Median return over the training seeds, and the range of all seeds, by experiment."""
    columns = min(CURVES_BESIDE, len(experiments))
    rows = math.ceil(len(experiments) / columns)
    figure = new_figure(3.4 * columns, 2.4 * rows, dpi=110)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, data in zip(axes, experiments, strict=False):
        steps, (low, middle, high) = band(data["curves"])
        axis.plot(steps / 1e6, middle, color=COLOURS[0], linewidth=1.4)
        axis.fill_between(steps / 1e6, low, high, color=COLOURS[0], alpha=0.25, linewidth=0.0)
        if len(steps) == 1:  # of which neither shows anything
            around = [middle - low, high - middle]
            axis.errorbar(steps / 1e6, middle, around, color=COLOURS[0], fmt="o", markersize=4)
        count = len(data["runs"])
        axis.set_title(f"{data['name']}\n{count} seed{'s' * (count > 1)}", fontsize=9)
        axis.set_xlim(left=0.0)
        tidy(axis)
    for axis in axes[len(experiments) :]:
        axis.set_axis_off()
    figure.supxlabel("environment steps [millions]")
    figure.supylabel("episode return: median and range of the training seeds")
    return figure


def page(data: Mapping[str, Any]) -> str:
    """Markdown page of one experiment: setting, every seed, the references, the verdict."""
    header = ["run", *(h for h, _, _ in COLUMNS.values()), "steps", "training [s]", "verdict"]
    rows = []
    for run in data["runs"]:
        mark = "wins" if run["verdict"]["passed"] else "does not win"
        steps, seconds = f"{run['steps']:,}", f"{run['seconds']:.0f}"
        rows.append([f"seed {run['seed']}", *cells(run["summary"]), steps, seconds, mark])
    for name, summary in data["references"].items():
        rows.append([name, *cells(summary), "", "", ""])
    passed = sum(run["verdict"]["passed"] for run in data["runs"])
    ranges = {
        name: sorted(number(run["verdict"]["shares"][name]) for run in data["runs"])
        for name in data["runs"][0]["verdict"]["shares"]
    }
    shares = ", ".join(f"{name} {v[0]:.2g} to {v[-1]:.2g}" for name, v in ranges.items())
    rule = FOLLOWING_RULE if data["task"] == "Track" else SETTLING_RULE
    title = titled(data["env"], data["config"]["env"]["kwargs"])
    return f"""# {data["name"]}

Made by `{data["command"]}`.

{title}, {data["episodes"]} episodes from seed {data["evaluation_seed"]} on, the same
tasks for everybody; medians, an episode that never settles counting as infinite. Joint PD has the
best gains of a grid of {data["pd"]["pairs"]} pairs (frequency ratio
{data["pd"]["frequency_ratio"]:.3g}, damping ratio {data["pd"]["damping_ratio"]:.3g}), chosen on
other tasks.

{table(header, rows, "lr")}

{rule}
{passed} of {len(data["runs"])} win. Shares of joint PD's value: {shares}.

![Learning curves]({data["name"]}.png)

![Tip error and root curvature]({data["name"]}_trajectories.png)
"""


def overview(experiments: Sequence[Mapping[str, Any]]) -> str:
    """Markdown page with all experiments."""
    rows = []
    for data in experiments:
        seeds = [run["summary"] for run in data["runs"]]
        own = f"{len(seeds)} seeds" if len(seeds) > 1 else "1 seed"
        texts = {own: cells_of_seeds(seeds)}
        texts |= {name: cells(summary) for name, summary in data["references"].items()}
        steps, seconds = data["runs"][0]["steps"], data["runs"][0]["seconds"]
        first = f"[{data['name']}]({data['name']}.md), {steps / 1e6:.2g} M steps, {seconds:.0f} s"
        for name, shown in texts.items():
            rows.append([first, name, *shown])
            first = ""
    header = ["experiment", "controller", *(h for h, _, _ in COLUMNS.values())]
    return f"""# Experiments

Medians over 100 episodes, made by `python -m benchmarks.training`; details behind each name. Of
several training seeds: the median of theirs ± the standard deviation over them. Joint PD has the
best gains of a grid and acts at the policy's control rate. On a light hub that rate limits it, not
the control law, so it is also shown at {FASTER} times the rate.

{table(header, rows, "llr")}

![Learning curves](experiments.png)
"""


def cells_of_seeds(summaries: Sequence[Mapping[str, float | None]]) -> list[str]:
    """Texts of the COLUMNS of several training seeds: median ± standard deviation, where finite."""
    texts = []
    for name in COLUMNS:
        values = [number(summary[name]) for summary in summaries]
        known = len(values) > 1 and all(map(math.isfinite, values))
        texts.append(
            cell(name, median(values)) + (f" ± {cell(name, stdev(values))}" if known else "")
        )
    return texts


def expected(data: Mapping[str, Any]) -> str:
    """Comment of an experiment's file: median and range of its training seeds, beside joint PD.

    A policy that corrects a controller, or plans for it, stands beside itself before training too,
    and one with a warm start beside that.
    """
    beside = {"joint PD": data["references"]["joint PD"]}
    if (data["config"].get("base") or {}).get("learned") in SCALED:
        beside["untrained"] = data["references"][UNTRAINED]
    if WARM_START in data["references"]:
        beside[WARM_START] = data["references"][WARM_START]
    rows = [["", "median", "least", "most", *beside]]
    seeds = [run["summary"] for run in data["runs"]]
    for name in STATED.get(data["task"], OTHERS):
        values = [number(x[name]) for x in seeds]
        shown = [median(values), min(values), max(values)]
        shown += [x[name] for x in beside.values()]
        rows.append([COLUMNS[name][0], *(cell(name, value) for value in shown)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(map(str.rjust, row[1:], widths[1:]))]) for row in rows
    ]
    count = "one seed" if len(seeds) == 1 else f"{len(seeds)} seeds"
    first = f"Expected of {count} after {data['config']['total_steps']:,} steps"
    texts = (f"{first}:", *(f"  {x}" for x in lines), f"from docs/results/{data['name']}.json")
    return "".join(f"# {text}\n" for text in texts)


def state_expected(experiments: Sequence[Mapping[str, Any]]) -> None:
    """Write what is expected of the shipped experiments into their files."""
    files = shipped_experiments()
    for data in experiments:
        path = files[data["name"]]
        text, count = COMMENT.subn(expected(data), path.read_text(encoding="utf-8"))
        if count != 1:
            raise ValueError(f"{path.name} needs one comment that begins with # Expected.")
        path.write_text(text, encoding="utf-8")


def main() -> None:
    """Parse the command line and write the overview."""
    parser = argument_parser("training.experiments", __doc__, ".")
    out = parser.parse_args().out
    if not stored(out):
        parser.error(f"--out: {out} has no results of benchmarks.training")
    summarise_experiments(out)
    if out.resolve() == RESULTS:
        state_expected(stored(out))


if __name__ == "__main__":
    main()
