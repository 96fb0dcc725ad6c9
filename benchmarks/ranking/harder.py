"""Controllers of the plain tasks where something happens in mid-episode, or costs; track `wide`.

    python -m benchmarks.ranking.harder

Each meets the same test episodes with and without the event or the cost; none was tuned or trained
for it. On `wide` those meet the tracks `wide` and `laboratory` that were made for both. Writes
docs/results/harder.json and .md.
"""

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS
from agents.environments import title
from agents.leaderboard.run import built, names
from agents.leaderboard.tracks import HARDER, designed_for, keywords
from agents.metrics import Recording, episode_metrics, make_batch, record
from benchmarks.output import RESULTS, argument_parser, count, provenance, save_results, table
from flexarm_env.core import Core
from flexarm_env.task.events import TIME

TRACKS = ("state", "laboratory")
CLASSICAL = ("pd", "pd-zvd", "inverse", "lqr", "lqg", "mpc", "mpc-kalman")
REACH = "FlexArm/OneLink-Reach-v0"
SEED = 10_000  # of the first test episode
COLUMNS = ("controller", "score", "without", "failed", "cost", "excess")


def acting(env_id: str, track: str) -> list[str]:
    """Controllers of a task and track: the classical ones of this study, and shipped policies."""
    found = names(None, env_id, track, bounded=False)
    return [name for name in found if name in CLASSICAL or name not in CONTROLLERS]


def met(name: str, env_id: str, track: str, seeds: Sequence[int]) -> dict[str, float]:
    """Means over test episodes of a controller, of a policy's first training seed."""
    kwargs = keywords(name, track)
    with (
        closing(make_batch(env_id, 1, kwargs)) as design,
        closing(make_batch(env_id, len(seeds), kwargs)) as envs,
    ):
        recording = record(next(built(name, design, env_id, track)), envs, seeds)
        found = {
            "score": float(episode_metrics(recording)["score"].mean()),
            "failed": float(recording.failed.mean()),
        }
        return found | costs(recording, envs.unwrapped.core)


def costs(recording: Recording, core: Core) -> dict[str, float]:
    """Mean sum of the cost over an episode, and the largest; empty without a limit."""
    if core.curvature_limit is None:
        return {}
    limits = core.curvature_limit * core.gauge_scale
    bent = (np.abs(recording.root_curvature[1:]) / limits).max(axis=2)
    excess = np.nan_to_num(np.maximum(bent - 1.0, 0.0))  # nothing once an episode has ended
    return {"cost": float(excess.sum(axis=0).mean()), "excess": float(excess.max())}


def wait(env_id: str) -> float | None:
    """Mean time of a resting target's event, over the episode; None if there is none."""
    envs = make_batch(env_id, 1)
    core = envs.unwrapped.core
    envs.close()
    if core.happening is None or core.task.moving:
        return None
    return float(np.mean(TIME) * core.move_time / (core.max_steps * core.control_dt))


def study(env_id: str, track: str, seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """Figures of every controller of a task and track, with the score without the event."""
    found = {}
    for name in acting(env_id, track):
        plain = met(name, designed_for(env_id), track, seeds)
        found[name] = met(name, env_id, track, seeds) | {"without": plain["score"]}
        print(env_id, track, row(name, found[name]), flush=True)
    return found


def widely(seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """Figures of what was tuned or trained for `wide`, with the score of the laboratory's."""
    found = {}
    for name in names(None, REACH, "wide", bounded=False):
        if name in CONTROLLERS and not CONTROLLERS[name].ranges:
            continue
        narrow = met(name, REACH, "laboratory", seeds)
        found[name] = met(name, REACH, "wide", seeds) | {"without": narrow["score"]}
        print(REACH, "wide", row(name, found[name]), flush=True)
    return found


def row(name: str, x: Mapping[str, float]) -> list[str]:
    """Cells of a controller."""
    cells = [name, f"{x['score']:.3f}", f"{x['without']:.3f}", f"{100.0 * x['failed']:.0f} %"]
    return [*cells, f"{x['cost']:.2f}", f"{100.0 * x['excess']:.0f} %"] if "cost" in x else cells


def ordered(found: Mapping[str, Mapping[str, float]], *header: str) -> str:
    """Markdown table of controllers, best first."""
    best = sorted(found, key=lambda name: -found[name]["score"])
    rows = [row(name, found[name]) for name in best]
    return table(header[: len(rows[0])], rows, "lr")


def memories(data: Mapping[str, Any]) -> str:
    """Markdown table of the best controller and the best policy without a model on sensors."""
    places = {f"{x.removeprefix('FlexArm/')}, laboratory": tracks["laboratory"]
              for x, tracks in data["tasks"].items()}  # fmt: skip
    places[f"{REACH.removeprefix('FlexArm/')}, wide"] = data["wide"]
    rows = []
    for place, found in places.items():
        best: dict[bool, str] = {}
        for name in sorted(found, key=lambda x: found[x]["score"]):
            if name in CONTROLLERS or "recurrent" in name or "-stacked" in name:
                best[name in CONTROLLERS] = f"{name} {found[name]['score']:.3f}"
        rows.append([place, best[True], best[False]])
    return table(["task, track", "controller", "policy that remembers"], rows, "lll")


def page(data: Mapping[str, Any]) -> str:
    """Markdown page of the tables."""
    parts = [
        f"## {title(env_id)}, {track}\n\n{ordered(found, *COLUMNS)}\n"
        for env_id, tracks in data["tasks"].items()
        for track, found in tracks.items()
    ]
    shares = ((title(x), share) for x, share in data["wait"].items())
    lost = " and ".join(f"{share:.2f} in {x}" for x, share in shares if share)
    return f"""# Harder tasks

Made by `{data["command"]}`.

Controllers with the parameters of the plain task, and policies that were trained on it, in
{data["episodes"]} test episodes; of a policy the first training seed. `ppo-stacked`,
`recurrent-ppo`, `ppo-ahead-of-pd`, and `ppo` beyond Reach of one link were trained on the former
defaults of the environments (see the changelog), which costs some of them their score.
`score` is the mean, `without` that in the same episodes of the plain task, `failed` the share of
episodes that a failure ends, `cost` the mean sum of `info["cost"]` over an episode, and `excess`
the largest curvature beyond the limit, over the limit.
[Environments](../envs/README.md#events-and-cost) has the formula.

{chr(10).join(parts)}
## OneLink-Reach-v0, wide

Payloads of 0 to 200 % and stiffnesses of 60 to 140 %, drawn per episode, with the sensors of the
laboratory. Controllers were tuned, and policies trained, for it, and for the laboratory beside it.

{ordered(data["wide"], "controller", "score", "laboratory", "failed")}

## What memory could gain

After a drop no time is lost and the plant is an ordinary one, so that the difference of `without`
and `score` is what a policy could win back that notices at once. No observation shows the payload:
a policy without memory acts on both plants alike, and one that remembers its actions and what they
did can tell them apart. Predictive control and LQR on exact states are designed for the middle of
the payloads, for all of the episode.

A target that has to be reached again costs whoever acts the time until the event. On average that
is a share of the episode of {lost}. `score` is to be compared with `without` less this share. The
gap that is left is largest for controllers with a filter or a plan of the whole move: these know of
no event.

With the sensors of the laboratory controllers remember what the plant did by a filter for each of
several plants, and policies without a model by the latest observations or recurrent cells. The best
of both:

{memories(data)}

What they lose on `wide` against the laboratory, whose sensors are the same, is a measure of what a
better memory could gain.
"""


def main() -> None:
    """Meet all harder tasks."""
    parser = argument_parser("ranking.harder", __doc__)
    parser.add_argument("--episodes", type=count, default=100)
    options = parser.parse_args()
    seeds = range(SEED, SEED + options.episodes)
    tasks = {x: {track: study(x, track, seeds) for track in TRACKS} for x in HARDER}
    data = provenance("numpy", "numba") | {"episodes": options.episodes, "tasks": tasks}
    data["wide"] = widely(seeds)
    data["wait"] = {env_id: wait(env_id) for env_id in HARDER}
    save_results(data, page, RESULTS / "harder.json")


if __name__ == "__main__":
    main()
