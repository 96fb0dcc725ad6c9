"""Learning on one link: beside predictive control, by memory and randomization, by its parts.

    python -m benchmarks.training.studies limits --jobs 2
    python -m benchmarks.training.studies memory --jobs 2
    python -m benchmarks.training.studies recipe --jobs 2

`limits` trains PPO on every combination of torque limit, spread of the plant and delay, beside
predictive control and LQG on Kalman filters that know the combination. `memory` trains PPO with
fewer or more stacked observations, with less or more randomization, and judges all of them in the
laboratory. `recipe` leaves single parts out of an experiment with `agent.name: rsl-ppo` (extra
`tensors`). Writes docs/results/study_NAME.json, .md and .png.
"""

import os
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.config import Config, load_config
from agents.controllers import controller
from agents.leaderboard.bound import best_of
from agents.leaderboard.statistics import interquartile_mean, interval
from agents.leaderboard.tracks import keywords
from agents.metrics import evaluated, make_batch, regrets
from agents.policy import load_policy
from agents.signals import workers
from agents.tuned import parameters_of
from benchmarks.output import ROOT, argument_parser, count, provenance, save_results, table
from benchmarks.style import pyplot, series
from benchmarks.training.runs import run_seed
from dynamics.types import AnyArray

LEARNER = ROOT / "configs" / "one_link_reach_laboratory_ppo.yaml"
RECIPE = ROOT / "configs" / "one_link_reach_laboratory_rsl_ppo.yaml"
MODEL_BASED = ("mpc-kalman", "lqg")
TORQUES = {"0.95 N m": "FlexArm/OneLink-Reach-v0", "3 N m": "FlexArm/OneLink-ReachAgile-v0"}
PLANTS = {  # payload and stiffness: fields of `hardware`, and the track whose bounds hold
    "known": ({"payload": [0.0, 0.0], "stiffness": [1.0, 1.0]}, "state"),
    "drawn": ({}, "laboratory"),
}
DELAYS: dict[str, dict[str, Any]] = {"none": {"delay": 0}, "0 to 2 steps": {}}
SENSING: dict[str, dict[str, Any]] = {
    "ideal sensors": {"obs": "sensors"},
    "noise, one step of delay": {
        "hardware": {"preset": "laboratory", **PLANTS["known"][0], "delay": 1}
    },
    "laboratory": {"hardware": "laboratory"},
}
STACKS = (1, 4, 8)
PARTS: dict[str, dict[str, Any]] = {  # what is left out of RECIPE, and what stands in its place
    "nothing": {},
    "frames: the policy sees one": {"stack": 1},
    "the critic's true state": {"privileged_critic": False},
    "the floor of the standard deviation": {"std_floor": None},
    "the spread of first episodes": {"spread_starts": False},
    "the value behind time-outs": {"bootstrap_timeouts": False},
}
RUNS = Path("runs")  # trainings that were stopped continue from here, finished ones stay


@dataclass(frozen=True)
class Training:
    """One policy: its place in the study, where it is trained and where it is judged."""

    place: tuple[str, str, str]
    config: Config
    kwargs: Mapping[str, Any]  # of the environment of the evaluation
    track: str  # whose bounds hold there

    @property
    def seeds(self) -> range:
        """Seeds of the test episodes."""
        test = self.config.evaluation
        return range(test.seed, test.seed + test.episodes)


def limits(config: Config) -> list[Training]:
    """A training per torque limit, plant and delay, judged where it was trained."""
    found = []
    for torque, env_id in TORQUES.items():
        for plant, (spread, track) in PLANTS.items():
            for delay, late in DELAYS.items():
                kwargs = {"hardware": {"preset": "laboratory", **spread, **late}}
                env = replace(config.env, id=env_id, kwargs=kwargs)
                trained = replace(config, env=env)
                found.append(Training((torque, plant, delay), trained, kwargs, track))
    return found


def memory(config: Config) -> list[Training]:
    """A training per randomization and memory, all judged in the laboratory."""
    found = []
    for sensing, kwargs in SENSING.items():
        for stack in STACKS:
            env = replace(config.env, kwargs=kwargs, stack=stack)
            trained = replace(config, env=env)
            judged = SENSING["laboratory"]
            found.append(Training((sensing, str(stack), ""), trained, judged, "laboratory"))
    return found


def recipe(config: Config) -> list[Training]:
    """A training per part that is left out, judged where it was trained."""
    found = []
    for part, changes in PARTS.items():
        keywords = {k: v for k, v in changes.items() if k != "stack"}
        kept = {k: v for k, v in (config.agent.kwargs | keywords).items() if v is not None}
        env = replace(config.env, stack=changes.get("stack", config.env.stack))
        trained = replace(config, env=env, agent=replace(config.agent, kwargs=kept))
        found.append(Training((part, "", ""), trained, env.kwargs, "laboratory"))
    return found


def trained(training: Training, seed: int, work: Path) -> dict[str, AnyArray]:
    """Metrics (episodes,) of one policy; a run that was stopped continues."""
    name = "_".join("".join(x for x in part if x.isalnum()) for part in training.place if part)
    run, _ = run_seed(training.config, work / name, seed)
    return judged(training, load_policy(run.policy))


def model_based(training: Training, name: str) -> dict[str, AnyArray]:
    """Metrics (episodes,) of a controller with the laboratory's parameters, on its own filters."""
    env_id = training.config.env.id
    with closing(
        make_batch(env_id, 1, keywords(name, "laboratory") | dict(training.kwargs))
    ) as env:
        subject = controller(name, env, parameters_of(name, env_id, "laboratory"))
        return judged(training, subject)


def judged(training: Training, subject: Any) -> dict[str, AnyArray]:
    """Metrics (episodes,) of a controller on the test episodes."""
    test = training.config.evaluation
    return evaluated(
        subject, training.config.env.id, episodes=test.episodes, seed=test.seed, **training.kwargs
    )


def figures(training: Training, found: Sequence[Mapping[str, AnyArray]]) -> dict[str, Any]:
    """Success rates and regret with its interval, from one run or one per training seed."""
    metrics = {name: np.stack([run[name] for run in found]) for name in found[0]}
    best = best_of(training.config.env.id, training.track, training.seeds)
    assert best is not None
    regret = regrets(metrics, best)
    return {
        "success_rates": metrics["success"].mean(axis=1).tolist(),
        "regret_iqm": interquartile_mean(regret),
        "regret_ci": interval(regret),
        "settling_median": float(np.median(metrics["settling_time"])),
        "scores": metrics["score"].mean(axis=1).tolist(),
    }


def measured(name: str, config: Config, options: Namespace, work: Path) -> dict[str, Any]:
    """Rows of a study: {"place": [..], controller: figures}."""
    rows = []
    with workers(options.jobs) as pool:
        jobs = [
            (one, [pool.submit(trained, one, seed, work) for seed in options.seeds],
             {x: pool.submit(model_based, one, x) for x in MODEL_BASED if name == "limits"})
            for one in STUDIES[name].trainings(config)
        ]  # fmt: skip
        for one, runs, others in jobs:
            row: dict[str, Any] = {"place": one.place}
            row["ppo-stacked"] = figures(one, [run.result() for run in runs])
            row |= {x: figures(one, [job.result()]) for x, job in others.items()}
            print(row, flush=True)
            rows.append(row)
    return {
        "rows": rows,
        "steps": config.total_steps,
        "episodes": config.evaluation.episodes,
        "seeds": options.seeds,
    }


def percent(found: Mapping[str, Any]) -> str:
    """Regret and its interval as text, with the success rates where they are not full."""
    low, high = (f"{100 * x:.0f}" for x in found["regret_ci"])
    missed = "" if min(found["success_rates"]) == 1.0 else f"; success {successes(found)}"
    return f"{100 * found['regret_iqm']:.0f} % [{low}, {high}]{missed}"


def successes(found: Mapping[str, Any]) -> str:
    """Success rate of every training seed."""
    return ", ".join(f"{100 * x:.0f}" for x in found["success_rates"]) + " %"


def limits_page(data: Mapping[str, Any]) -> str:
    """Markdown page of the study beside predictive control."""
    names = ["ppo-stacked", *MODEL_BASED]
    rows = [[*row["place"], *(percent(row[name]) for name in names)] for row in data["rows"]]
    return f"""# Where learning beats predictive control

Made by `{data["command"]}`.

Regret on FlexArm/OneLink-Reach-v0 and FlexArm/OneLink-ReachAgile-v0 with the sensors of
`hardware="laboratory"`, IQM over {data["episodes"]} test episodes [95 %], and the success of every
training seed where an episode is missed. PPO sees its latest four observations and was trained on
each row ({data["steps"]:,} steps, {len(data["seeds"])} seeds). The model-based controllers have
filters for what the row draws, and the parameters that were tuned in the laboratory.

{table(["torque limit", "payload and stiffness", "delay", *names], rows, "lll")}

![Regret by torque limit, plant and delay](study_limits.png)
"""


def memory_page(data: Mapping[str, Any]) -> str:
    """Markdown page of the study of memory and randomization."""
    by_place = {tuple(row["place"][:2]): row["ppo-stacked"] for row in data["rows"]}
    rows = []
    for sensing in SENSING:
        found = [by_place[sensing, str(stack)] for stack in STACKS]
        cells = [f"{successes(x)}; {100 * x['regret_iqm']:.0f} %" for x in found]
        rows.append([sensing, *cells])
    header = ["trained with", *(f"{stack} observation{'s' * (stack > 1)}" for stack in STACKS)]
    return f"""# Memory and randomization

Made by `{data["command"]}`.

PPO on FlexArm/OneLink-Reach-v0, trained with more or less realistic sensors and with more or fewer
stacked observations ({data["steps"]:,} steps, {len(data["seeds"])} seeds), all judged with
`hardware="laboratory"`: success of every training seed; regret of all (IQM,
{data["episodes"]} test episodes, 400 % where an episode never settles).

{table(header, rows)}

![Success by memory and randomization](study_memory.png)
"""


def recipe_page(data: Mapping[str, Any]) -> str:
    """Markdown page of the study of a recipe's parts."""
    rows = []
    for row in data["rows"]:
        found = row["ppo-stacked"]
        scores = found["scores"]
        each = ", ".join(f"{x:.3f}" for x in scores)
        rows.append([row["place"][0], f"{np.mean(scores):.3f}", each, successes(found)])
    seeds = len(data["seeds"])
    header = ["left out", "score, mean", "score of each seed", "success of each seed"]
    return f"""# What the parts of a recipe are worth

Made by `{data["command"]}`.

PPO of rsl_rl on FlexArm/OneLink-Reach-v0 with `hardware="laboratory"`
(`configs/{RECIPE.name}`), and with one part left out at a time: {data["steps"]:,} steps,
{seeds} seeds. Scores are means over {data["episodes"]} test episodes. Differences below the spread
of the seeds say nothing.

{table(header, rows, "lrll")}

![Score without each part](study_recipe.png)
"""


def limits_chart(data: Mapping[str, Any]) -> Any:
    """Regret with intervals by plant and delay, a panel per torque limit."""
    figure, axes = pyplot().subplots(1, len(TORQUES), figsize=(9.0, 3.6), sharey=True)
    for axis, torque in zip(axes, TORQUES, strict=True):
        rows = [row for row in data["rows"] if row["place"][0] == torque]
        for k, name in enumerate(("ppo-stacked", *MODEL_BASED)):
            middle = np.array([100 * row[name]["regret_iqm"] for row in rows])
            ends = np.array([row[name]["regret_ci"] for row in rows]).T * 100
            axis.errorbar(
                np.arange(len(rows)) + 0.15 * (k - 1), middle, np.abs(ends - middle), label=name,
                linestyle="none", capsize=3, markersize=7, **series(k),
            )  # fmt: skip
        labels = [f"plant {plant}\ndelay {delay}" for _, plant, delay in (r["place"] for r in rows)]
        axis.set_xticks(range(len(rows)), labels, fontsize=8)
        axis.set_title(f"OneLink-Reach, {torque}", fontsize=10)
        axis.grid(axis="y", alpha=0.3)
    axes[0].set_ylabel("regret, IQM [%]")
    axes[0].set_ylim(bottom=0.0)
    axes[0].legend(frameon=False)
    figure.tight_layout()
    return figure


def memory_chart(data: Mapping[str, Any]) -> Any:
    """Success in the laboratory against memory and randomization, a point per training seed."""
    figure, axis = pyplot().subplots(figsize=(6.0, 3.6))
    for k, sensing in enumerate(SENSING):
        rows = [row for row in data["rows"] if row["place"][0] == sensing]
        for i, row in enumerate(rows):
            success = 100 * np.array(row["ppo-stacked"]["success_rates"])
            label = f"trained with {sensing}" if i == 0 else None
            place = np.full(len(success), i + 0.15 * (k - 1))
            axis.plot(place, success, label=label, linestyle="none", alpha=0.8, **series(k))
    axis.set_xticks(range(len(STACKS)), [str(stack) for stack in STACKS])
    axis.set_xlabel("observations that the policy sees")
    axis.set_ylabel("success in the laboratory [%]")
    axis.set_ylim(-3.0, 103.0)
    axis.grid(alpha=0.3)
    axis.legend(frameon=False, fontsize=9)
    figure.tight_layout()
    return figure


def recipe_chart(data: Mapping[str, Any]) -> Any:
    """Score without each part, a point per training seed."""
    figure, axis = pyplot().subplots(figsize=(6.0, 2.8))
    parts = [row["place"][0] for row in data["rows"]]
    for k, row in enumerate(data["rows"]):
        scores = row["ppo-stacked"]["scores"]
        axis.plot(scores, np.full(len(scores), k), linestyle="none", alpha=0.8, **series(k > 0))
    axis.set_yticks(range(len(parts)), parts)
    axis.invert_yaxis()
    axis.set_xlabel("score, a point per seed")
    axis.set_title("Left out", loc="left", fontsize=10)
    axis.grid(alpha=0.3)
    figure.tight_layout()
    return figure


@dataclass(frozen=True)
class Study:
    """An experiment, what is trained of it, and what is shown of that."""

    learner: Path
    trainings: Callable[[Config], list[Training]]
    page: Callable[[Mapping[str, Any]], str]
    chart: Callable[[Mapping[str, Any]], Any]
    steps: int = 1_000_000  # of each training


STUDIES = {
    "limits": Study(LEARNER, limits, limits_page, limits_chart),
    "memory": Study(LEARNER, memory, memory_page, memory_chart),
    "recipe": Study(RECIPE, recipe, recipe_page, recipe_chart, steps=4_000_000),
}


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argument_parser("training.studies", __doc__, ".")
    parser.add_argument("study", choices=sorted(STUDIES))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--steps", type=count, help="of each training")
    parser.add_argument("--episodes", type=count, default=100)
    parser.add_argument("--jobs", type=count, default=os.cpu_count())
    options = parser.parse_args(arguments)
    if options.episodes < 2:
        parser.error("argument --episodes: a regret with its interval needs 2 or more, got 1")
    study = STUDIES[options.study]
    config = replace(load_config(study.learner), total_steps=options.steps or study.steps)
    config = replace(config, evaluation=replace(config.evaluation, episodes=options.episodes))
    found = measured(options.study, config, options, RUNS / f"study_{options.study}")
    data = {**provenance("torch", "stable-baselines3"), **found}
    path = options.out / f"study_{options.study}.json"
    save_results(data, study.page, path, study.chart(data))


if __name__ == "__main__":
    main()
