"""Predictive control in the laboratory, told nothing, the delay, the plant or both of an episode.

    python -m benchmarks.ranking.knowledge --jobs 2

Every test episode is met with its own payload and stiffness and a delay by turns. The controller
has the laboratory's parameters and filters for all that it is not told. Writes
docs/results/knowledge.json, .md and .png.
"""

import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.environments import title
from agents.leaderboard.bound import best_of
from agents.leaderboard.output import over_best, score
from agents.leaderboard.statistics import figures
from agents.leaderboard.tracks import RANKED, keywords
from agents.metrics import episode_metrics, make_batch, record
from agents.signals import workers
from agents.tuned import parameters_of
from benchmarks.output import argument_parser, count, provenance, save_results, table
from benchmarks.ranking.standings import short
from benchmarks.style import pyplot, series
from dynamics.types import AnyArray
from flexarm_env.hardware.sensors import PRESETS

NAME, TRACK = "mpc-kalman", "laboratory"
EXACT = "exact states"
TOLD = {"nothing": (), "the delay": ("delay",), "the plant": ("plant",), "both": ("delay", "plant")}
COLUMNS = (*TOLD, EXACT)
TASKS = tuple(env_id for env_id in RANKED if "OneLink" in env_id)


@dataclass(frozen=True)
class Scene:
    """An episode of the laboratory, as it may be told to a controller."""

    delay: int  # control steps
    plant: dict[str, tuple[float, float]]  # of `randomize`, both ends the same

    def keywords(self, *known: str) -> dict[str, Any]:
        """Keywords of an environment whose delay and plant are the scene's, if they are known."""
        hardware = {"preset": TRACK} | ({"delay": self.delay} if "delay" in known else {})
        plant = {"randomize": self.plant} if "plant" in known else {}
        return {"obs": "sensors", "hardware": hardware, **plant}


def scenes(env_id: str, seeds: Sequence[int]) -> list[Scene]:
    """The plants that the laboratory draws with these seeds, and its delays by turns."""
    env = make_batch(env_id, len(seeds), keywords(NAME, TRACK))
    env.reset(seed=list(seeds))
    core, hardware = env.unwrapped.core, PRESETS[TRACK]
    assert hardware is not None
    drawn = core.parameters.tolist()
    least, most = hardware.delay
    env.close()
    return [
        Scene(
            delay=least + seed % (most - least + 1),
            plant={name: (x, x) for name, x in zip(core.randomize, row, strict=True)},
        )
        for seed, row in zip(seeds, drawn, strict=True)
    ]


def episode(env_id: str, seed: int, scene: Scene, column: str) -> dict[str, float]:
    """Metrics of one episode, in which the controller knows what the column says."""
    parameters = parameters_of(NAME, env_id, TRACK)
    if column == EXACT:
        name = "mpc"
        parameters = {key: parameters[key] for key in CONTROLLERS[name].ranges}
        met = known = {"obs": "state", "randomize": scene.plant}
    else:
        name = NAME
        met, known = scene.keywords("delay", "plant"), scene.keywords(*TOLD[column])
    with (
        closing(make_batch(env_id, 1, known)) as design,
        closing(make_batch(env_id, 1, met)) as env,
    ):
        subject = controller(name, design, parameters)
        found = episode_metrics(record(subject, env, [seed]))
        return {key: float(values[0]) for key, values in found.items()}


def cell(env_id: str, column: str, seeds: Sequence[int]) -> dict[str, Any]:
    """Figures of a task and a column."""
    found = [
        episode(env_id, seed, scene, column)
        for seed, scene in zip(seeds, scenes(env_id, seeds), strict=True)
    ]
    metrics = {key: np.array([[x[key] for x in found]]) for key in found[0]}
    return figures(metrics, best_of(env_id, TRACK, seeds))


def page(data: Mapping[str, Any]) -> str:
    """Markdown page of the tables."""
    tables = []
    for heading, value in (
        ("Score, IQM [95 %]", score),
        ("Regret, IQM [95 %]; excess of the RMS tip error [mm] on paths", over_best),
        ("Success", lambda x: f"{100.0 * x['success_rate']:.0f} %"),
    ):
        rows = [
            [title(task), *(value(found[column]) for column in COLUMNS)]
            for task, found in data["tasks"].items()
        ]
        tables.append(f"## {heading}\n\n{table(['task', *COLUMNS], rows, 'lr')}")
    return f"""# The price of not knowing

Made by `{data["command"]}`.

`{NAME}` in `hardware="laboratory"`, with the parameters of the ranking, over {data["episodes"]}
test episodes, whose payload and stiffness are the ranking's and whose delays take turns. It is told
nothing, the delay, the plant (payload and stiffness), or both, and has filters for what it is not
told; noise stays. With exact states the same law, `mpc`, knows the plant, and nothing is late.

![Score by what the controller is told](knowledge.png)

{chr(10).join(x + chr(10) for x in tables)}"""


def chart(data: Mapping[str, Any]) -> Any:
    """Scores with their intervals, a group of marks per task."""
    figure, axis = pyplot().subplots(figsize=(9.0, 3.8))
    tasks = data["tasks"]
    for k, column in enumerate(COLUMNS):
        middle: AnyArray = np.array([found[column]["score_iqm"] for found in tasks.values()])
        ends = np.array([found[column]["score_ci"] for found in tasks.values()]).T
        axis.errorbar(
            np.arange(len(tasks)) + 0.13 * (k - 2), middle, np.abs(ends - middle), label=column,
            linestyle="none", capsize=3, markersize=6, **series(k),
        )  # fmt: skip
    labels = [short(task) for task in tasks]
    axis.set_xticks(range(len(tasks)), [x.replace("-", "\n") for x in labels], fontsize=8)
    axis.set_ylabel("score, IQM")
    axis.grid(axis="y", alpha=0.3)
    axis.legend(title="told", frameon=False, ncols=len(COLUMNS), loc="upper center",
                bbox_to_anchor=(0.5, 1.25))  # fmt: skip
    figure.tight_layout()
    return figure


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argument_parser("ranking.knowledge", __doc__, ".")
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS, metavar="ID")
    parser.add_argument("--episodes", type=count, default=100)
    parser.add_argument("--jobs", type=count, default=os.cpu_count())
    options = parser.parse_args(arguments)
    seeds = range(10_000, 10_000 + options.episodes)
    tasks: dict[str, dict[str, Any]] = {env_id: {} for env_id in options.tasks}
    with workers(options.jobs) as pool:
        jobs = {
            (env_id, column): pool.submit(cell, env_id, column, seeds)
            for env_id in tasks
            for column in COLUMNS
        }
        for (env_id, column), job in jobs.items():
            tasks[env_id][column] = job.result()
            print(env_id, column, tasks[env_id][column]["score_iqm"], flush=True)
    data = {**provenance("daqp"), "episodes": options.episodes, "tasks": tasks}
    save_results(data, page, options.out / "knowledge.json", chart(data))


if __name__ == "__main__":
    main()
