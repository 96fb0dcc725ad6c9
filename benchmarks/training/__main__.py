"""Train an experiment with several seeds and compare every run with the best joint PD.

    python -m benchmarks.training --config configs/one_link_reach_ppo.yaml --seeds 0 1 2 3 4
    python -m benchmarks.training --config configs/one_link_reach_ppo.yaml --seeds 5 6 --add
    python -m benchmarks.training --film configs/one_link_reach_ppo.yaml

Writes docs/results/NAME.json, NAME.md and NAME.png (learning curves), with --gif also NAME.gif (the
first seed and joint PD), and the overview of `benchmarks.training.experiments`. With `--add` the
stored seeds and references stay. Without training, `--film` makes NAME.gif with the shipped policy.
"""

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from agents.comparison import beginning, titled
from agents.config import Config, ConfigError, config_from_dict, load_config
from agents.controllers import joint_pd, tune_pd
from agents.controllers.pd import TunedPD
from agents.figures import film, plot_recordings, write_gif
from agents.hybrid.controller import acting
from agents.leaderboard.shipped import ship, shipped_policies
from agents.leaderboard.tracks import track_of
from agents.metrics import (
    METRICS,
    Recording,
    episode_metrics,
    make_batch,
    record,
    summarise,
)
from agents.policy import Controller, load_policy
from agents.run_folder.folder import RunFolder, versions
from agents.sentences import one_line
from agents.signals import workers
from agents.training import with_overrides
from benchmarks.output import argument_parser, command, count, write_results
from benchmarks.training.experiments import (
    COLUMNS,
    FASTER,
    cells,
    number,
    summarise_experiments,
)
from benchmarks.training.runs import episode_seeds, recorded, run_seed

# A policy wins if its medians are at most these shares of joint PD's; the rules state it in words.
SETTLING = {"settling_time": 1.0 / 3.0, "residual_vibration": 1.0 / 10.0}
FOLLOWING = {"tip_error_rms": 1.0 / 3.0}
POINTS = 60  # of a stored learning curve, about


def verdict(
    policy: Mapping[str, float], pd: Mapping[str, float], following: bool
) -> dict[str, Any]:
    """Shares of joint PD's medians, and whether the policy wins on every count (`passed`).

    With a moving target (`following`) the arm neither settles nor stops bending, so the RMS tip
    error is compared instead of settling time and residual vibration.
    """
    limits = FOLLOWING if following else SETTLING
    shares = {name: share(policy[name], pd[name]) for name in limits}
    better = all(share <= limits[name] for name, share in shares.items())
    return {"shares": shares, "passed": better and policy["success_rate"] >= pd["success_rate"]}


def share(value: float, of: float) -> float:
    """A median over another one; 0 of a zero, such as the vibration of a rigid arm, is 0."""
    return value / of if of else math.inf if value else 0.0


def faster_pd(env_id: str, kwargs: Mapping[str, Any], tasks: Sequence[int]) -> dict[str, float]:
    """Summary of joint PD at FASTER times the control rate, with the best gains for that rate."""
    env = make_batch(env_id, 1, kwargs)
    core = env.unwrapped.core
    fast = {
        **kwargs,
        "control_dt": core.control_dt / FASTER,
        "max_episode_steps": FASTER * core.max_steps,
    }
    env.close()
    tuned = tune_pd(env_id, fast)
    envs = make_batch(env_id, len(tasks), fast)
    pd = joint_pd(envs, tuned.frequency_ratio, tuned.damping_ratio)
    summary = summarise(episode_metrics(record(pd, envs, tasks)))
    envs.close()
    return summary


def film_shipped(config: Config, out: Path) -> None:
    """Film the shipped policy of the first seed and joint PD with the stored gains as NAME.gif."""
    env_id, kwargs = config.env.id, config.env.kwargs
    policies = shipped_policies(config)
    if not policies:
        raise SystemExit(
            f"No policy of {config.name} is shipped; train it with "
            f"--config configs/{config.name}.yaml --gif."
        )
    gains = json.loads((out / f"{config.name}.json").read_text(encoding="utf-8"))["pd"]
    envs = make_batch(env_id, 1, kwargs)
    pair: dict[str, Controller] = {
        "trained policy": acting(policies[0], envs),
        "joint PD": joint_pd(envs, gains["frequency_ratio"], gains["damping_ratio"]),
    }
    envs.close()
    write_film(config, pair, out)


def write_film(config: Config, pair: Mapping[str, Controller], out: Path) -> None:
    """NAME.gif of the first test episode under both controllers."""
    env_id, kwargs = config.env.id, config.env.kwargs
    films = {name: film(env_id, kwargs, c, config.evaluation.seed) for name, c in pair.items()}
    write_gif(out / f"{config.name}.gif", films, titled(env_id, kwargs))


def benchmark(
    config: Config, trained: Mapping[int, tuple[RunFolder, float]], out: Path, gif: bool,
    pool: Executor,
) -> None:  # fmt: skip
    """Evaluate every seed's policy and the references, write JSON, trajectories and the film."""
    env_id, kwargs = config.env.id, config.env.kwargs
    folders = [run for run, _ in trained.values()]
    coming = pool.map(
        partial(recorded, config), [folders[0].untrained, *(run.policy for run in folders)]
    )
    tuned = tune_pd(env_id, kwargs)
    with closing(make_batch(env_id, config.evaluation.episodes, kwargs)) as envs:
        pd = joint_pd(envs, tuned.frequency_ratio, tuned.damping_ratio)
        references = {"joint PD": record(pd, envs, episode_seeds(config))}
        references[beginning(config)] = next(coming)
        seeds = dict(zip(trained, coming, strict=True))
        data = results(config, trained, tuned, references, seeds, envs.unwrapped.task)
        out.mkdir(parents=True, exist_ok=True)
        write_results(out / f"{config.name}.json", data)
        draw(config, references, seeds, out)
        if gif:
            policy = acting(load_policy(folders[0].policy), envs)
            write_film(config, {"trained policy": policy, "joint PD": pd}, out)


def add(
    config: Config, trained: Mapping[int, tuple[RunFolder, float]], data: dict[str, Any],
    out: Path, pool: Executor,
) -> None:  # fmt: skip
    """Evaluate the policies of further seeds, write them into the JSON of the stored results."""
    folders = [run.policy for run, _ in trained.values()]
    seeds = dict(zip(trained, pool.map(partial(recorded, config), folders), strict=True))
    judge(data, trained, seeds)
    data["command"] += f"; {command()}"
    write_results(out / f"{config.name}.json", data)


def results(
    config: Config, trained: Mapping[int, tuple[RunFolder, float]], tuned: TunedPD,
    references: Mapping[str, Recording], seeds: Mapping[int, Recording], task: str,
) -> dict[str, Any]:  # fmt: skip
    """Stored results of an experiment: the references, every seed with its verdict, the curves."""
    env_id, kwargs = config.env.id, config.env.kwargs
    summaries = {name: summarise(episode_metrics(r)) for name, r in references.items()}
    summaries[f"joint PD, {FASTER} x control rate"] = faster_pd(
        env_id, kwargs, episode_seeds(config)
    )
    data = {
        "name": config.name,
        "command": command(),
        "env": env_id,
        "task": task,
        "episodes": config.evaluation.episodes,
        "evaluation_seed": config.evaluation.seed,
        "units": {name: unit for name, (unit, _) in METRICS.items()},
        "config": config.to_dict(),
        "versions": versions()["packages"],
        "pd": {
            "frequency_ratio": tuned.frequency_ratio,
            "damping_ratio": tuned.damping_ratio,
            "pairs": len(tuned.table),
        },
        "references": summaries,
        "runs": [],
        "curves": {},
    }
    judge(data, trained, seeds)
    return data


def judge(
    data: dict[str, Any],
    trained: Mapping[int, tuple[RunFolder, float]],
    seeds: Mapping[int, Recording],
) -> None:
    """Add the runs of training seeds, with their verdicts and learning curves, to the results."""
    pd = {name: number(value) for name, value in data["references"]["joint PD"].items()}
    for seed, (run, seconds) in trained.items():
        curve, summary = run.curve(), summarise(episode_metrics(seeds[seed]))
        data["runs"].append(
            {
                "seed": seed,
                "steps": curve[-1]["steps"],
                "seconds": seconds,
                "summary": summary,
                "verdict": verdict(summary, pd, data["task"] == "Track"),
            }
        )
        rows = curve[:: max(1, len(curve) // POINTS)]
        data["curves"][f"seed {seed}"] = {
            key: [row[key] for row in rows] for key in ("steps", "return", "settled")
        }
        print(f"seed {seed}: {dict(zip(COLUMNS, cells(summary), strict=True))}", flush=True)
    data["runs"].sort(key=lambda run: run["seed"])


def extended(config: Config, seeds: Sequence[int], out: Path) -> dict[str, Any]:
    """Stored results of an experiment that take further seeds; a ValueError where they cannot."""
    file = out / f"{config.name}.json"
    if not file.exists():
        raise ValueError(f"--add: {file} does not exist; leave --add out.")
    data: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    before = config_from_dict(data["config"], name=config.name).to_dict()  # with today's defaults
    then = {"config": before, "versions": data["versions"]}
    now = {"config": config.to_dict(), "versions": versions()["packages"]}
    changed = [
        f"{part}.{key}"
        for part, values in now.items()
        for key in sorted({*values, *then[part]})
        if key != "seed" and values.get(key) != then[part].get(key)
    ]
    if changed:
        raise ValueError(
            f"--add: {', '.join(changed)} changed since {file}; train all seeds again."
        )
    if known := sorted({run["seed"] for run in data["runs"]} & {*seeds}):
        raise ValueError(f"--seeds: {file} has those of {known} already; leave them or --add out.")
    return data


def draw(
    config: Config, references: Mapping[str, Recording], seeds: Mapping[int, Recording], out: Path
) -> None:
    """NAME_trajectories.png of the first seed and the references."""
    first, recording = next(iter(seeds.items()))
    title = f"{titled(config.env.id, config.env.kwargs)}, {config.evaluation.episodes} episodes"
    shown = {f"policy, seed {first}": recording, **references}
    plot_recordings(out / f"{config.name}_trajectories.png", shown, title)


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argument_parser("training", __doc__, ".")
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--config", type=Path, help="experiment file")
    task.add_argument("--film", type=Path, help="only NAME.gif of an experiment file")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    first = parser.add_mutually_exclusive_group()
    first.add_argument("--add", action="store_true", help="add the seeds to the stored results")
    first.add_argument("--gif", action="store_true", help="film the first seed and joint PD")
    parser.add_argument(
        "--jobs", type=count, default=1, help="seeds that are trained, and judged, side by side"
    )
    parser.add_argument("--steps", type=count, help="replaces the experiment's total_steps")
    parser.add_argument("--keep", type=Path, help="folder of the runs, which go on from there")
    parser.add_argument("--ship", action="store_true", help="keep the policies in agents/policies")
    a = parser.parse_args(arguments)
    try:
        config = with_overrides(load_config(a.film or a.config), None, a.steps)
    except ConfigError as error:
        parser.error(one_line(error))
    if a.film:
        film_shipped(config, a.out)
        return
    try:
        stored = extended(config, a.seeds, a.out) if a.add else None
    except ValueError as error:
        parser.error(one_line(error))
    with tempfile.TemporaryDirectory() as temporary:
        work = a.keep or Path(temporary)
        # a process per seed: what a training leaves behind would fill the memory of the next
        with workers(a.jobs, tasks_each=1) as pool:
            runs = pool.map(partial(run_seed, config, work), a.seeds)
            trained = dict(zip(a.seeds, runs, strict=True))
            if stored is None:
                benchmark(config, trained, a.out, a.gif, pool)
            else:
                add(config, trained, stored, a.out, pool)
        summarise_experiments(a.out, config.name)
        print((a.out / f"{config.name}.md").read_text(encoding="utf-8"))
        track = track_of(config.agent.name, config.env.id, config.env.kwargs)
        if a.ship and track is not None:
            for seed in a.seeds:
                ship(load_policy(RunFolder(work / f"seed{seed}").policy), config.env.id, track)


if __name__ == "__main__":
    main()
