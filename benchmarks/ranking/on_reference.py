"""Scores of ranked controllers on the default model and on the reference, in the same episodes.

    python -m benchmarks.ranking.on_reference --jobs 2

Each controller of the ranking on exact states meets every episode twice: on the environment as it
is, and on `fidelity="reference"`. There it sees what it would see of the environment's own model
that bends alike. Writes docs/results/on_reference.json, .md and .png.
"""

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorObservationWrapper
from scipy.stats import kendalltau

from agents.leaderboard.run import built
from agents.leaderboard.tracks import RANKED, keywords
from agents.metrics import episode_metrics, make_batch, record
from agents.signals import workers
from benchmarks.output import RESULTS, argument_parser, count, provenance, save_results, table
from benchmarks.ranking.standings import short
from benchmarks.style import pyplot, series
from dynamics.accuracy.same_shape import transferred
from dynamics.types import AnyArray

TRACK = "state"
TASKS = tuple(env_id for env_id in RANKED if "Reach" in env_id)
SLOW = 1.0  # [ms] decisions of a controller that meets FEW episodes
FEW = 8


class Mirrored(VectorObservationWrapper[Any, Any, Any, Any]):
    """A batch of the reference whose exact states are those of the default model."""

    def __init__(self, env_id: str, n_env: int, kwargs: Mapping[str, Any]) -> None:
        envs = make_batch(env_id, n_env, {**kwargs, "fidelity": "reference"})
        super().__init__(envs)
        self.core, self.own = envs.unwrapped.core, make_batch(env_id, 1, kwargs).unwrapped.core

    def observations(self, observation: AnyArray) -> AnyArray:
        """(n_env, size) observations with the amplitudes of the default model."""
        core, layout = self.core, self.own.layout
        result = np.zeros((len(observation), layout.size), np.float32)
        bent = dict(
            zip(("modal_amplitude", "modal_rate"),
                transferred(core.q, core.v, core.arm, self.own.arm), strict=True)
        )  # fmt: skip
        for part in layout.parts:
            at = layout.slices[part.name]
            if part.name in bent:
                values = bent[part.name][:, list(part.entries)] * layout.factors[at]
                result[:, at] = np.clip(values, -10.0, 10.0)
            else:
                result[:, at] = observation[:, core.layout.slices[part.name]]
        return result


def met(env_id: str, name: str, seeds: Sequence[int]) -> dict[str, dict[str, list[float]]]:
    """Scores and settling times on both models."""
    kwargs = keywords(name, TRACK)
    design = make_batch(env_id, 1, kwargs)
    both = {
        "default": make_batch(env_id, len(seeds), kwargs),
        "reference": Mirrored(env_id, len(seeds), kwargs),
    }
    result = {}
    for model, envs in both.items():
        found = episode_metrics(record(next(built(name, design, env_id, TRACK)), envs, seeds))
        result[model] = {key: found[key].tolist() for key in ("score", "settling_time")}
    return result


def differences(found: Mapping[str, Mapping[str, Sequence[float]]]) -> dict[str, float]:
    """Mean score on both, and the differences of scores and settling times (reference less own)."""
    own, truth = found["default"], found["reference"]
    score = np.array(truth["score"]) - np.array(own["score"])
    times = np.array([own["settling_time"], truth["settling_time"]])
    settled = np.isfinite(times).all(axis=0)
    late = (times[1] - times[0])[settled]
    return {
        "default": float(np.mean(own["score"])),
        "reference": float(np.mean(truth["score"])),
        "difference": float(score.mean()),
        "most": float(np.quantile(np.abs(score), 0.95)),
        "later": float(late.mean()) if late.size else float("nan"),
        "latest": float(np.quantile(np.abs(late), 0.95)) if late.size else float("nan"),
        "alike": float(np.mean(np.isfinite(times[0]) == np.isfinite(times[1]))),
        "episodes": float(len(score)),
    }


def page(data: Mapping[str, Any]) -> str:
    """Markdown page of the tables."""
    parts = []
    for env_id, found in data["tasks"].items():
        rows = [
            [f"`{name}`", f"{x['default']:.3f}", f"{x['reference']:.3f}",
             f"{x['difference']:+.4f}", f"{x['most']:.3f}", milliseconds(x["later"], "+.0f"),
             milliseconds(x["latest"], ".0f"), f"{x['alike']:.0%}", f"{x['episodes']:.0f}"]
            for name, x in found.items()
        ]  # fmt: skip
        head = ("controller", "score", "on the reference", "difference", "95 % of episodes",
                "settles later [ms]", "95 % [ms]", "settle alike", "episodes")  # fmt: skip
        order = data["order"][env_id]
        parts.append(
            f"## {env_id}\n\nOrder of the controllers: Kendall's tau {order['tau']:.2f}; the best "
            f"is `{order['best'][0]}` on the default, `{order['best'][1]}` on the reference.\n\n"
            + table(head, rows, "lr")
        )
    return f"""# Does the error of the model change a score?

Made by `{data["command"]}`.

Every controller of the ranking on exact states met the same episodes on the default model and on
the reference. On the reference it sees the amplitudes of the default's modes that bend the links
alike. Differences are those of the reference from the default. Controllers whose decisions take
more than a millisecond meet {FEW} episodes. Policies were trained on earlier defaults. `lqg`,
`-kalman` and `-extended` see sensors, among them gauges at the roots of the links.

![Scores on the default model and on the reference](on_reference.png)

{chr(10).join(x + chr(10) for x in parts)}"""


def milliseconds(seconds: float, form: str) -> str:
    """A time in ms; nothing where no episode settles on both models."""
    return "" if np.isnan(seconds) else f"{1e3 * seconds:{form}}"


def chart(data: Mapping[str, Any]) -> Any:
    """Score on the reference over that on the default, a mark per controller."""
    figure, axis = pyplot().subplots(figsize=(5.2, 5.0))
    for k, (env_id, found) in enumerate(data["tasks"].items()):
        axis.plot(
            [x["default"] for x in found.values()], [x["reference"] for x in found.values()],
            label=short(env_id), linestyle="none",
            markersize=6, **series(k),
        )  # fmt: skip
    axis.plot([0.0, 1.0], [0.0, 1.0], color="grey", linewidth=0.8, zorder=0)
    axis.set_xlabel("mean score on the default")
    axis.set_ylabel("mean score on the reference")
    axis.legend(frameon=False)
    axis.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def order_of(found: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Rank correlation of the scores on both models, and the best controller on either."""
    scores = np.array([[x["default"], x["reference"]] for x in found.values()])
    names = list(found)
    tau = kendalltau(scores[:, 0], scores[:, 1]).statistic if len(names) > 1 else 1.0
    return {"tau": float(tau), "best": [names[k] for k in scores.argmax(axis=0)]}


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argument_parser("ranking.on_reference", __doc__, ".")
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS, metavar="ID")
    parser.add_argument("--episodes", type=count, default=32)
    parser.add_argument("--jobs", type=count, default=os.cpu_count())
    options = parser.parse_args(arguments)
    ranking = json.loads((RESULTS / "leaderboard.json").read_text(encoding="utf-8"))
    seeds = range(20_000, 20_000 + options.episodes)
    tasks: dict[str, dict[str, Any]] = {env_id: {} for env_id in options.tasks}
    with workers(options.jobs) as pool:
        jobs = {}
        for env_id in tasks:
            for name, x in ranking[env_id][TRACK].items():
                if not x["privileged"]:
                    few = seeds[:FEW] if x["ms_per_action"] > SLOW else seeds
                    jobs[env_id, name] = pool.submit(met, env_id, name, few)
        for (env_id, name), job in jobs.items():
            tasks[env_id][name] = differences(job.result())
            print(env_id, name, tasks[env_id][name], flush=True)
    data = {
        **provenance(), "tasks": tasks,
        "order": {env_id: order_of(found) for env_id, found in tasks.items()},
    }  # fmt: skip
    save_results(data, page, options.out / "on_reference.json", chart(data))


if __name__ == "__main__":
    main()
