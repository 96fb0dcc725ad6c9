"""Train an experiment with several seeds and compare every run with the best joint PD.

    python -m benchmarks.training --config configs/one_link_reach_ppo.yaml --seeds 0 1 2 3 4
    python -m benchmarks.training --charts
    python -m benchmarks.training --film configs/one_link_reach_ppo.yaml

Writes docs/results/NAME.json, NAME.md and NAME.png (learning curves), with --gif also NAME.gif (the
first seed and joint PD), and experiments.md with experiments.png, an overview of all stored
experiments. Without training, `--charts` draws the overview and the learning curves of stored
results again, and `--film` makes NAME.gif with the shipped policy.
"""

import json
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.figure import Figure

from agents.comparison import titled
from agents.config import Config, load_config
from agents.controllers import joint_pd, tune_pd
from agents.figures import (
    COLOURS,
    film,
    new_figure,
    plot_learning_curve,
    plot_recordings,
    save_figure,
    tidy,
    write_gif,
)
from agents.hybrid.controller import acting
from agents.leaderboard.shipped import on_base, ship, shipped
from agents.leaderboard.tracks import track_of
from agents.metrics import (
    METRICS,
    Recording,
    episode_metrics,
    make_batch,
    record,
    summarise,
    write_json,
)
from agents.policy import Controller, load_policy
from agents.run_folder.folder import RunFolder, versions
from agents.training import learn
from benchmarks.output import RESULTS, argument_parser, command, table
from dynamics.types import AnyArray

# A policy wins if its medians are at most these shares of joint PD's; the rules state it in words.
SETTLING = {"settling_time": 1.0 / 3.0, "residual_vibration": 1.0 / 10.0}
FOLLOWING = {"tip_error_rms": 1.0 / 3.0}
SETTLING_RULE = """\
"Wins" means: settles in at most a third of joint PD's time, with at most a tenth of its residual
vibration and no lower success rate; that joint PD acts at the policy's control rate."""
FOLLOWING_RULE = """\
"Wins" means: follows with at most a third of joint PD's RMS tip error and no lower success rate;
that joint PD acts at the policy's control rate."""
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


def verdict(
    policy: Mapping[str, float], pd: Mapping[str, float], following: bool
) -> dict[str, Any]:
    """Shares of joint PD's medians, and whether the policy wins on every count (`passed`).

    With a moving target (`following`) the arm neither settles nor stops bending, so the RMS tip
    error is compared instead of settling time and residual vibration.
    """
    limits = FOLLOWING if following else SETTLING
    shares = {name: policy[name] / pd[name] for name in limits}
    better = all(share <= limits[name] for name, share in shares.items())
    return {"shares": shares, "passed": better and policy["success_rate"] >= pd["success_rate"]}


def run_seed(config: Config, folder: Path) -> tuple[RunFolder, float]:
    """Train one seed; returns its run and the training time [s], compiling not included."""
    folder.mkdir(parents=True)
    run = RunFolder(folder)
    begin = time.monotonic()
    learn(run, config)
    return run, time.monotonic() - begin


def faster_pd(env_id: str, kwargs: Mapping[str, Any], tasks: Sequence[int]) -> dict[str, float]:
    """Summary of joint PD at FASTER times the control rate, with the best gains for that rate."""
    env = make_batch(env_id, 1, kwargs)
    control_dt = env.unwrapped.control_dt / FASTER
    env.close()
    steps = gym.spec(env_id).max_episode_steps
    assert steps is not None
    fast = {**kwargs, "control_dt": control_dt, "max_episode_steps": FASTER * steps}
    tuned = tune_pd(env_id, fast)
    envs = make_batch(env_id, len(tasks), fast)
    pd = joint_pd(envs, tuned.frequency_ratio, tuned.damping_ratio)
    summary = summarise(episode_metrics(record(pd, envs, tasks)))
    envs.close()
    return summary


def cells(summary: Mapping[str, float]) -> list[str]:
    """Texts of the summary's COLUMNS."""
    texts = []
    for name, (_, factor, style) in COLUMNS.items():
        value = factor * summary[name]
        tiny = 0.0 < value < SMALLEST
        text = f"< {SMALLEST}" if tiny else f"{value:{style}}"
        missing = "never" if name == "settling_time" else "failed"
        texts.append(text if math.isfinite(value) else missing)
    return texts


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


def number(value: float | None) -> float:
    """A number read from JSON; null (an infinite value) and NaN become infinity."""
    return math.inf if value is None or math.isnan(value) else float(value)


def stored(out: Path) -> list[dict[str, Any]]:
    """Experiments whose JSON files are in the folder."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*.json"))]
    return [data for data in found if "references" in data and "runs" in data]


def summarise_experiments(out: Path) -> None:
    """Write experiments.md and experiments.png from all experiments of the folder."""
    experiments = stored(out)
    (out / "experiments.md").write_text(overview(experiments), encoding="utf-8")
    save_figure(learning_curves(experiments), out / "experiments.png")
    for data in experiments:
        plot_learning_curve(out / f"{data['name']}.png", stored_curves(data), curves_title(data))


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


def film_shipped(config: Config, out: Path) -> None:
    """Film the shipped policy of the first seed and joint PD with the stored gains as NAME.gif."""
    env_id, kwargs = config.env.id, config.env.kwargs
    track = track_of(config.agent.name, env_id, kwargs)
    policies = {} if track is None else shipped(env_id, track)
    if config.agent.name not in policies:
        raise SystemExit(
            f"No policy of {config.name} is shipped, but {sorted(policies)} of {env_id}; train it "
            f"with --config configs/{config.name}.yaml --gif."
        )
    gains = json.loads((out / f"{config.name}.json").read_text(encoding="utf-8"))["pd"]
    envs = make_batch(env_id, 1, kwargs)
    pair: dict[str, Controller] = {
        "trained policy": acting(policies[config.agent.name][0], envs),
        "joint PD": joint_pd(envs, gains["frequency_ratio"], gains["damping_ratio"]),
    }
    envs.close()
    films = {name: film(env_id, kwargs, c, config.evaluation.seed) for name, c in pair.items()}
    write_gif(out / f"{config.name}.gif", films, titled(env_id, kwargs))


def band(curves: Mapping[str, Mapping[str, Any]]) -> tuple[AnyArray, AnyArray]:
    """(k,) steps, and (3, k) least, median and largest return over the training seeds."""
    known = [[(x, y) for x, y in zip(c["steps"], c["return"], strict=True) if y is not None]
             for c in curves.values()]  # fmt: skip
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
        count = len(data["runs"])
        axis.set_title(f"{data['name']}\n{count} seed{'s' * (count > 1)}", fontsize=9)
        axis.set_xlim(left=0.0)
        tidy(axis)
    for axis in axes[len(experiments) :]:
        axis.set_axis_off()
    figure.supxlabel("environment steps [millions]")
    figure.supylabel("episode return: median and range of the training seeds")
    return figure


def overview(experiments: Sequence[Mapping[str, Any]]) -> str:
    """Markdown page with all experiments."""
    rows = []
    for data in experiments:
        seeds = [run["summary"] for run in data["runs"]]
        own = f"{len(seeds)} seeds" if len(seeds) > 1 else "1 seed"
        summaries = {own: median_of(seeds), **data["references"]}
        steps, seconds = data["runs"][0]["steps"], data["runs"][0]["seconds"]
        first = f"[{data['name']}]({data['name']}.md), {steps / 1e6:.2g} M steps, {seconds:.0f} s"
        for name, summary in summaries.items():
            numbers = {k: number(v) for k, v in summary.items()}
            rows.append([first, name, *cells(numbers)])
            first = ""
    header = ["experiment", "controller", *(h for h, _, _ in COLUMNS.values())]
    return f"""# Experiments

Medians over 100 episodes (and over seeds), made by `python -m benchmarks.training`; details behind
each name. Joint PD has the best gains of a grid and acts at the policy's control rate. On a light
hub that rate limits it, not the control law, so it is also shown at {FASTER} times the rate.

{table(header, rows, "llr")}

![Learning curves](experiments.png)
"""


def median_of(summaries: Sequence[Mapping[str, float | None]]) -> dict[str, float]:
    """Median over seeds of every metric, with null as infinity."""
    return {name: median(number(s[name]) for s in summaries) for name in summaries[0]}


def benchmark(config: Config, seeds: Sequence[int], work: Path, out: Path, gif: bool) -> None:
    """Train all seeds, evaluate every policy and the references, write JSON, pages and pictures."""
    env_id, kwargs = config.env.id, config.env.kwargs
    episodes, first = config.evaluation.episodes, config.evaluation.seed
    tuned = tune_pd(env_id, kwargs)
    envs = make_batch(env_id, episodes, kwargs)
    pd = joint_pd(envs, tuned.frequency_ratio, tuned.damping_ratio)
    task = envs.unwrapped.task
    tasks = range(first, first + episodes)
    recordings: dict[str, Recording] = {"joint PD": record(pd, envs, tasks)}
    summaries = {"joint PD": summarise(episode_metrics(recordings["joint PD"]))}
    runs, curves, policies = [], {}, []
    for seed in seeds:
        run, seconds = run_seed(replace(config, seed=seed), work / f"seed{seed}")
        policies.append(acting(load_policy(run.policy), envs))
        if len(policies) == 1:
            untrained = record(acting(load_policy(run.untrained), envs), envs, tasks)
            recordings["untrained policy"] = untrained
            summaries["untrained policy"] = summarise(episode_metrics(untrained))
            fast = faster_pd(env_id, kwargs, tasks)
            summaries[f"joint PD, {FASTER} x control rate"] = fast
        r = record(policies[-1], envs, tasks)
        recordings.setdefault(f"seed {seed}", r)
        summary = summarise(episode_metrics(r))
        curves[f"seed {seed}"] = run.curve()
        runs.append(
            {
                "seed": seed,
                "steps": curves[f"seed {seed}"][-1]["steps"],
                "seconds": seconds,
                "summary": summary,
                "verdict": verdict(summary, summaries["joint PD"], task == "Track"),
            }
        )
        print(f"seed {seed}: {dict(zip(COLUMNS, cells(summary), strict=True))}", flush=True)
    envs.close()
    data = {
        "name": config.name,
        "command": command(),
        "env": env_id,
        "task": task,
        "episodes": episodes,
        "evaluation_seed": first,
        "units": {name: unit for name, (unit, _) in METRICS.items()},
        "config": config.to_dict(),
        "versions": versions()["packages"],
        "pd": {
            "frequency_ratio": tuned.frequency_ratio,
            "damping_ratio": tuned.damping_ratio,
            "pairs": len(tuned.table),
        },
        "references": summaries,
        "runs": runs,
        "curves": {
            name: {
                key: [row[key] for row in rows[:: max(1, len(rows) // 60)]]
                for key in ("steps", "return", "settled")
            }
            for name, rows in curves.items()
        },
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{config.name}.json", data)
    text = page(data)
    (out / f"{config.name}.md").write_text(text, encoding="utf-8")
    what = titled(env_id, kwargs)
    shown = {f"policy, seed {seeds[0]}": recordings[f"seed {seeds[0]}"]}
    shown |= {name: recordings[name] for name in ("joint PD", "untrained policy")}
    title = f"{what}, {episodes} episodes"
    plot_recordings(out / f"{config.name}_trajectories.png", shown, title)
    if gif:
        pair: dict[str, Controller] = {"trained policy": policies[0], "joint PD": pd}
        films = {name: film(env_id, kwargs, c, first) for name, c in pair.items()}
        write_gif(out / f"{config.name}.gif", films, what)
    summarise_experiments(out)
    print(text)


def main() -> None:
    """Command line."""
    parser = argument_parser("training", __doc__)
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--config", type=Path, help="experiment file")
    task.add_argument("--charts", action="store_true", help="only pictures of stored results")
    task.add_argument("--film", type=Path, help="only NAME.gif of an experiment file")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--steps", type=int, help="replaces the experiment's total_steps")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--keep", type=Path, help="folder that keeps the runs")
    parser.add_argument("--ship", action="store_true", help="keep the policies in agents/policies")
    parser.add_argument("--gif", action="store_true", help="film the first seed and joint PD")
    a = parser.parse_args()
    if a.charts:
        summarise_experiments(a.out)
        return
    if a.film:
        film_shipped(load_config(a.film), a.out)
        return
    config = load_config(a.config)
    if a.steps is not None:
        config = replace(config, total_steps=a.steps)
    with tempfile.TemporaryDirectory() as temporary:
        work = a.keep or Path(temporary)
        benchmark(config, a.seeds, work, a.out, a.gif)
        track = track_of(config.agent.name, config.env.id, config.env.kwargs)
        if a.ship and track is not None:
            for seed in a.seeds:
                ship(load_policy(RunFolder(work / f"seed{seed}").policy), config.env.id, track)


if __name__ == "__main__":
    main()
