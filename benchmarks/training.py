"""Train an experiment with several seeds and compare every run with the best joint PD.

    python benchmarks/training.py --config configs/one_link_reach_ppo.yaml --seeds 0 1 2 3 4

writes docs/results/NAME.json, NAME.md and NAME.png (learning curves); with --gif also NAME.gif
(the first seed beside joint PD). The tables in the documentation come from here.
"""

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import gymnasium as gym  # noqa: E402

from agents.config import Config, load_config  # noqa: E402
from agents.controllers import joint_pd, tune_pd  # noqa: E402
from agents.evaluation import (  # noqa: E402
    METRICS,
    Recording,
    episode_metrics,
    make_batch,
    record,
    summarise,
    write_json,
)
from agents.figures import film, plot_learning_curve, plot_recordings, write_gif  # noqa: E402
from agents.policy import Controller, load_policy  # noqa: E402
from agents.runs import RunFolder, versions  # noqa: E402
from agents.training import learn  # noqa: E402

SETTLING_SHARE = 1.0 / 3.0  # of joint PD's median settling time, at most
VIBRATION_SHARE = 1.0 / 10.0  # of joint PD's median residual vibration, at most
FASTER = 4  # joint PD is also shown at this multiple of the control rate; it is not the yardstick
COLUMNS = {  # metric: (header, factor, format)
    "success_rate": ("success [%]", 100.0, ".0f"),
    "settling_time": ("settling [s]", 1.0, ".2f"),
    "tip_error_final": ("tip error, end [mm]", 1e3, ".2g"),
    "tip_error_rms": ("tip error, RMS [mm]", 1e3, ".3g"),
    "residual_vibration": ("residual vibration [mm]", 1e3, ".2g"),
    "peak_root_curvature": ("peak root curvature [1/m]", 1.0, ".2g"),
    "effort": ("effort [N²m²s]", 1.0, ".2g"),
}


def verdict(policy: Mapping[str, float], pd: Mapping[str, float]) -> dict[str, Any]:
    """How the policy stands against joint PD; `passed` if it wins on every count."""
    settling = policy["settling_time"] / pd["settling_time"]
    vibration = policy["residual_vibration"] / pd["residual_vibration"]
    return {
        "settling_share": settling,
        "vibration_share": vibration,
        "passed": settling <= SETTLING_SHARE
        and vibration <= VIBRATION_SHARE
        and policy["success_rate"] >= pd["success_rate"],
    }


def run_seed(config: Config, folder: Path) -> tuple[RunFolder, float]:
    """Train one seed; returns its folder and the seconds it took, compiling not included."""
    folder.mkdir(parents=True)
    run = RunFolder(folder)
    begin = time.monotonic()
    learn(run, config)
    return run, time.monotonic() - begin


def faster_pd(env_id: str, kwargs: Mapping[str, Any], tasks: Sequence[int]) -> dict[str, float]:
    """Joint PD with its own best gains at a multiple of the policy's control rate."""
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
    """One row of the table."""
    texts = []
    for name, (_, factor, style) in COLUMNS.items():
        value = factor * summary[name]
        texts.append(f"{value:{style}}" if math.isfinite(value) else "never")
    return texts


def table(data: Mapping[str, Any]) -> str:
    """The page: what was run, every seed, the references, the verdict."""
    header = ["run", *(h for h, _, _ in COLUMNS.values()), "steps", "training [s]", "verdict"]
    lines = [" | ".join(header), " | ".join(["---"] + ["---:"] * (len(header) - 1))]
    for run in data["runs"]:
        mark = "wins" if run["verdict"]["passed"] else "does not win"
        steps, seconds = f"{run['steps']:,}", f"{run['seconds']:.0f}"
        row = [f"seed {run['seed']}", *cells(run["summary"]), steps, seconds, mark]
        lines.append(" | ".join(row))
    for name, summary in data["references"].items():
        lines.append(" | ".join([name, *cells(summary), "", "", ""]))
    passed = sum(run["verdict"]["passed"] for run in data["runs"])
    shares = ", ".join(
        f"{run['verdict']['settling_share']:.2f} / {run['verdict']['vibration_share']:.3f}"
        for run in data["runs"]
    )
    rows = "\n".join(f"| {line} |" for line in lines)
    return f"""# {data["name"]}

Made by `{data["command"]}`.

{data["env"]}, {data["episodes"]} episodes from seed {data["evaluation_seed"]} on, the same
tasks for everybody; medians, an episode that never settles counting as infinite. Joint PD has the
best gains of a grid of {data["pd"]["pairs"]} pairs (frequency ratio
{data["pd"]["frequency_ratio"]:.3g}, damping ratio {data["pd"]["damping_ratio"]:.3g}), chosen on
other tasks.

{rows}

"Wins" means: settles in at most a third of joint PD's time, with at most a tenth of its residual
vibration and no lower success rate; that joint PD acts at the policy's control rate.
{passed} of {len(data["runs"])} runs win. Shares of settling time / residual vibration: {shares}.

![Learning curves]({data["name"]}.png)

![Tip error and root curvature]({data["name"]}_trajectories.png)
"""


def benchmark(config: Config, seeds: Sequence[int], work: Path, out: Path, gif: bool) -> None:
    """Train, judge, write."""
    env_id, kwargs = config.env.id, config.env.make_kwargs
    episodes, first = config.evaluation.episodes, config.evaluation.seed
    tuned = tune_pd(env_id, kwargs)
    envs = make_batch(env_id, episodes, kwargs)
    pd = joint_pd(envs, tuned.frequency_ratio, tuned.damping_ratio)
    tasks = range(first, first + episodes)
    recordings: dict[str, Recording] = {"joint PD": record(pd, envs, tasks)}
    summaries = {"joint PD": summarise(episode_metrics(recordings["joint PD"]))}
    runs, curves, policies = [], {}, []
    for seed in seeds:
        run, seconds = run_seed(replace(config, seed=seed), work / f"seed{seed}")
        policies.append(load_policy(run.policy))
        if len(policies) == 1:
            untrained = record(load_policy(run.untrained), envs, tasks)
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
                "verdict": verdict(summary, summaries["joint PD"]),
            }
        )
        print(f"seed {seed}: {dict(zip(COLUMNS, cells(summary), strict=True))}", flush=True)
    envs.close()
    data = {
        "name": config.name,
        "command": "python benchmarks/training.py " + " ".join(sys.argv[1:]),
        "env": env_id,
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
    text = table(data)
    (out / f"{config.name}.md").write_text(text, encoding="utf-8")
    plot_learning_curve(out / f"{config.name}.png", curves)
    shown = {f"policy, seed {seeds[0]}": recordings[f"seed {seeds[0]}"]}
    shown |= {name: recordings[name] for name in ("joint PD", "untrained policy")}
    title = f"{env_id}, {episodes} episodes"
    plot_recordings(out / f"{config.name}_trajectories.png", shown, title)
    if gif:
        pair: dict[str, Controller] = {"trained policy": policies[0], "joint PD": pd}
        films = {name: film(env_id, kwargs, c, first) for name, c in pair.items()}
        write_gif(out / f"{config.name}.gif", films)
    print(text)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--steps", type=int, help="instead of the experiment's total_steps")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results")
    parser.add_argument("--keep", type=Path, help="folder to keep the runs in")
    parser.add_argument("--gif", action="store_true", help="film the first seed beside joint PD")
    a = parser.parse_args()
    config = load_config(a.config)
    if a.steps is not None:
        config = replace(config, total_steps=a.steps)
    with tempfile.TemporaryDirectory() as temporary:
        benchmark(config, a.seeds, a.keep or Path(temporary), a.out, a.gif)


if __name__ == "__main__":
    main()
