"""Controllers of the plain tasks where something happens in mid-episode, or costs.

    python -m benchmarks.harder

Each meets the same test episodes with and without the event or the cost; none was tuned or trained
for it. Writes docs/results/harder.json and .md.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agents.leaderboard.run import built, names
from agents.leaderboard.tracks import HARDER, designed_for, keywords
from agents.metrics import episode_metrics, make_batch, record
from benchmarks.output import RESULTS, argument_parser, provenance, save_results, table

TRACKS = ("state", "laboratory")
CLASSICAL = ("pd", "pd-zvd", "inverse", "lqr", "lqg", "mpc", "mpc-kalman")
SEED = 10_000  # of the first test episode
COLUMNS = ("controller", "score", "without", "failed", "cost", "excess")


def acting(env_id: str, track: str) -> list[str]:
    """Controllers of a task and track: the classical ones of this study, and shipped policies."""
    found = names(None, env_id, track, bounded=False)
    return [name for name in found if name in CLASSICAL or "ppo" in name or name in ("sac", "tqc")]


def met(name: str, env_id: str, track: str, seeds: Sequence[int]) -> dict[str, float]:
    """Means over test episodes of a controller, of a policy's first training seed."""
    kwargs = keywords(name, track)
    design, envs = make_batch(env_id, 1, kwargs), make_batch(env_id, len(seeds), kwargs)
    try:
        recording = record(next(built(name, design, env_id, track)), envs, seeds)
        core = envs.unwrapped.core
        limit = np.inf if core.curvature_limit is None else core.curvature_limit
        bent = np.abs(recording.root_curvature[1:]) / (limit * core.gauge_scale)
        excess = np.nan_to_num(np.maximum(bent.max(axis=2) - 1.0, 0.0))
        return {
            "score": float(episode_metrics(recording)["score"].mean()),
            "failed": float(recording.failed.mean()),
            "cost": float(excess.sum(axis=0).mean()),
            "excess": float(excess.max()),
        }
    finally:
        design.close()
        envs.close()


def study(env_id: str, track: str, seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """Figures of every controller of a task and track, with the score without the event."""
    found = {}
    for name in acting(env_id, track):
        plain = met(name, designed_for(env_id), track, seeds)
        found[name] = met(name, env_id, track, seeds) | {"without": plain["score"]}
        print(env_id, track, row(name, found[name]), flush=True)
    return found


def row(name: str, x: Mapping[str, float]) -> list[str]:
    """Cells of a controller."""
    return [
        name, f"{x['score']:.3f}", f"{x['without']:.3f}", f"{100.0 * x['failed']:.0f} %",
        f"{x['cost']:.2f}", f"{100.0 * x['excess']:.0f} %",
    ]  # fmt: skip


def page(data: Mapping[str, Any]) -> str:
    """Markdown page of the tables."""
    parts = []
    for env_id, tracks in data["tasks"].items():
        for track, found in tracks.items():
            best = sorted(found, key=lambda name: -found[name]["score"])
            rows = [row(name, found[name]) for name in best]
            title = f"## {env_id.removeprefix('FlexArm/')}, {track}"
            parts.append(f"{title}\n\n{table(COLUMNS, rows, 'lr')}\n")
    return f"""# Harder tasks

Made by `{data["command"]}`.

Controllers with the parameters of the plain task, and policies that were trained on it, in
{data["episodes"]} test episodes; of a policy the first training seed. `score` is the mean,
`without` that in the same episodes of the plain task, `failed` the share of episodes that a failure
ends, `cost` the mean sum of `info["cost"]` over an episode, and `excess` the largest curvature
beyond the limit, over the limit. [Environments](../envs/README.md#events-and-cost) has the formula.

{chr(10).join(parts)}
## What memory could gain

The difference of `score` and `without` bounds what a policy could win back that notices an event at
once. It does not have to vanish: time that a jump or a push takes is lost to every policy, but the
plant after a drop is an ordinary one. No observation shows the payload. A policy without memory has
to act on both plants alike; one that remembers its actions and what they did can tell them apart.
"""


def main() -> None:
    """Meet all harder tasks."""
    parser = argument_parser("harder", __doc__)
    parser.add_argument("--episodes", type=int, default=100)
    options = parser.parse_args()
    seeds = range(SEED, SEED + options.episodes)
    tasks = {x: {track: study(x, track, seeds) for track in TRACKS} for x in HARDER}
    data = {**provenance("numpy", "numba"), "episodes": options.episodes, "tasks": tasks}
    save_results(data, page(data), RESULTS / "harder.json")


if __name__ == "__main__":
    main()
