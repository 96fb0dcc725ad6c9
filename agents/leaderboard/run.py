"""`python -m agents.leaderboard`: rank controllers on every task and track.

Every controller meets the same test episodes, whose seeds no tuning and no training uses. Results
are leaderboard.json, {task: {track: {controller: figures}}}, leaderboard.csv with one row per
episode, leaderboard.md and leaderboard.png. A user's own class takes part by `--controllers
mymodule:MyController`; it is called with the environment, and must have `predict` as a trained
policy has.
"""

import argparse
import csv
import importlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from agents.controllers import CONTROLLERS, controller
from agents.files import atomic_write
from agents.leaderboard.bound import shortest_times
from agents.leaderboard.charts import draw
from agents.leaderboard.shipped import shipped
from agents.leaderboard.tracks import RANKED, TRACKS, keywords, takes_part
from agents.metrics import METRICS, episode_metrics, make_batch, record, regrets, without_infinities
from agents.policy import Controller
from agents.tune import parameters_of
from dynamics.description import validate
from dynamics.types import AnyArray

SEED, EPISODES = 10_000, 100
RESAMPLES = 2000  # of the bootstrap
TIMED = 200  # single decisions that are timed
Figures = dict[str, Any]


def decision_times(subject: Controller, env: Any, seed: int) -> AnyArray:
    """(n,) [ms] of single decisions, without the first, in episodes of one environment."""
    observation, _ = env.reset(seed=[seed])
    state, start, times = None, np.ones(1, dtype=bool), []
    for _ in range(TIMED):
        begin = time.perf_counter()
        action, state = subject.predict(observation, state, start)
        times.append(1e3 * (time.perf_counter() - begin))
        observation, _, terminated, truncated, _ = env.step(np.asarray(action, np.float32))
        start = terminated | truncated
    return np.array(times[1:])


def interquartile_mean(x: AnyArray, axis: int = -1) -> Any:
    """Mean of the middle half."""
    return stats.trim_mean(x, 0.25, axis=axis)


def interval(x: AnyArray) -> list[float]:
    """95 % bootstrap interval of the interquartile mean over episodes."""
    if np.ptp(x) == 0.0:
        return [float(x[0]), float(x[0])]
    found = stats.bootstrap(
        (x,), interquartile_mean, n_resamples=RESAMPLES, method="percentile", rng=0
    ).confidence_interval
    return [float(found.low), float(found.high)]


def figures(
    metrics: Mapping[str, AnyArray],
    milliseconds: AnyArray,
    control_dt: float,
    shortest: AnyArray | None,
) -> Figures:
    """Figures of one controller on one task and track.

    `shortest` [s] are the shortest settling times that are known, one per episode; without them
    there is no regret.
    """
    score = metrics["score"]
    regret = None if shortest is None else regrets(metrics["settling_time"], shortest)
    return {
        "success_rate": float(metrics["success"].mean()),
        "score_iqm": float(interquartile_mean(score)),
        "score_ci": interval(score),
        "regret_iqm": None if regret is None else float(interquartile_mean(regret)),
        "regret_ci": None if regret is None else interval(regret),
        "settling_median": float(np.median(metrics["settling_time"])),
        "tip_error_rms_median": float(np.median(metrics["tip_error_rms"])),
        "residual_vibration_median": float(np.median(metrics["residual_vibration"])),
        "ms_per_action": float(np.median(milliseconds)),
        "ms_per_action_p99": float(np.percentile(milliseconds, 99.0)),
        "ms_control_step": 1e3 * control_dt,
    }


def built(name: str, env: Any, env_id: str, track: str) -> list[Controller]:
    """Controllers of a name, made for a design environment: one per training seed of a policy."""
    if name in CONTROLLERS:
        parameters = parameters_of(name, env_id, track) if CONTROLLERS[name].ranges else {}
        return [controller(name, env, parameters)]
    if ":" in name:
        return [users_class(name)(env)]
    return list(shipped(env_id, TRACKS[track].design)[name])


def users_class(name: str) -> Callable[[Any], Controller]:
    """The class that a user names on the command line as mymodule:MyController."""
    module, _, attribute = name.partition(":")
    try:
        found: Callable[[Any], Controller] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"--controllers {name} cannot be imported: {error}.") from None
    return found


def ranked(name: str, env_id: str, track: str, seeds: Sequence[int]) -> tuple[Figures, Any]:
    """Figures and metrics per episode of a controller, made for the track's design conditions.

    The episodes of all training seeds of a policy count.
    """
    design = make_batch(env_id, 1, keywords(name, TRACKS[track].design))
    kwargs = keywords(name, track)
    envs, single = make_batch(env_id, len(seeds), kwargs), make_batch(env_id, 1, kwargs)
    try:
        subjects = built(name, design, env_id, track)
        each = [episode_metrics(record(subject, envs, seeds)) for subject in subjects]
        metrics = {key: np.concatenate([found[key] for found in each]) for key in METRICS}
        milliseconds = decision_times(subjects[0], single, seeds[0])
        shortest = shortest_times(env_id, track, list(seeds) * len(subjects))
        return figures(metrics, milliseconds, envs.unwrapped.control_dt, shortest), metrics
    finally:
        for env in (design, envs, single):
            env.close()


def names(wanted: Sequence[str] | None, env_id: str, track: str) -> list[str]:
    """Controllers that act on a task and track: all, or those that are wanted."""
    classical = [name for name in CONTROLLERS if takes_part(name, env_id, track)]
    known = [*classical, *shipped(env_id, TRACKS[track].design)]
    return known if wanted is None else [x for x in wanted if ":" in x or x in known]


def rows(results: Mapping[str, Any], env_id: str, track: str) -> Iterator[tuple[str, Figures]]:
    """Controllers of a task and track, best first."""
    found = results[env_id][track].items()
    yield from sorted(found, key=lambda item: -item[1]["score_iqm"])


def page(results: Mapping[str, Any], about: str) -> str:
    """Markdown page of the results."""
    parts = ["# Leaderboard", about, "![Scores](leaderboard.png)"]
    for env_id, tracks in results.items():
        parts.append(f"## {env_id}")
        for track in tracks:
            lines = [
                f"**{track}**: {TRACKS[track].text}",
                "",
                "| controller | success | score, IQM [95 %] | regret, IQM [95 %] | settling [s] | "
                "RMS [mm] | decision, median and 99 % [ms] |",
                "|---|---:|---:|---:|---:|---:|---:|",
            ]
            lines += [_row(name, x) for name, x in rows(results, env_id, track)]
            parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def _row(name: str, x: Figures) -> str:
    low, high = x["score_ci"]
    settling, regret = x["settling_median"], "-"
    if x["regret_iqm"] is not None:
        least, most = x["regret_ci"]
        regret = f"{100.0 * x['regret_iqm']:.0f} % [{100.0 * least:.0f}, {100.0 * most:.0f}]"
    return (
        f"| {name} | {100.0 * x['success_rate']:.0f} % | {x['score_iqm']:.3f} "
        f"[{low:.3f}, {high:.3f}] | {regret} | {_number(settling, '.2f', 'never')} | "
        f"{_number(1e3 * x['tip_error_rms_median'], '.3g', 'failed')} | "
        f"{x['ms_per_action']:.2g}, {x['ms_per_action_p99']:.2g} |"
    )


def _number(x: float, style: str, otherwise: str) -> str:
    return f"{x:{style}}" if np.isfinite(x) else otherwise


def main(arguments: list[str] | None = None) -> int:
    """Rank, and write after every task; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.leaderboard", description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=list(RANKED), metavar="ID")
    parser.add_argument("--tracks", nargs="+", default=list(TRACKS), metavar="TRACK")
    parser.add_argument(
        "--controllers", nargs="+", metavar="NAME",
        help="of the table, of a shipped policy, or mymodule:MyController (default: all)",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=SEED, help="of the first test episode")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--out", type=Path, default=Path("leaderboard"))
    options = parser.parse_args(arguments)
    try:
        _check(options)
    except ValueError as error:
        print(f"agents.leaderboard: {error}", file=sys.stderr)
        return 2
    seeds = list(range(options.seed, options.seed + options.episodes))
    options.out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {}
    episodes: list[list[Any]] = []
    for env_id in options.tasks:
        for track in options.tracks:
            for name in names(options.controllers, env_id, track):
                found, metrics = ranked(name, env_id, track, seeds)
                results.setdefault(env_id, {}).setdefault(track, {})[name] = found
                columns = zip(*(metrics[key].tolist() for key in METRICS), strict=True)
                episodes += [
                    [env_id, track, name, k // len(seeds), seeds[k % len(seeds)], *row]
                    for k, row in enumerate(columns)
                ]
                print(f"{env_id}, {track}: {_row(name, found)}", flush=True)
        write(options.out, results, episodes, seeds)
    print(f"Everything is in {options.out}/")
    return 0


def _check(options: argparse.Namespace) -> None:
    for env_id in options.tasks:
        validate.known(env_id, "task", RANKED)
    for track in options.tracks:
        validate.known(track, "track", TRACKS)
    shipped_names = {
        name for env_id in RANKED for track in TRACKS for name in shipped(env_id, track)
    }
    for name in options.controllers or ():
        if ":" in name:
            users_class(name)
        else:
            validate.known(name, "controller", sorted({*CONTROLLERS, *shipped_names}))
    validate.integer(options.episodes, "--episodes", 1, 100_000)
    validate.integer(options.seed, "--seed", 0, 2**31)


def write(
    folder: Path, results: Mapping[str, Any], episodes: list[list[Any]], seeds: Sequence[int]
) -> None:
    """Write the files; each replaces its former version as a whole."""
    with atomic_write(folder / "leaderboard.json") as path:
        path.write_text(json.dumps(without_infinities(results), indent=1) + "\n", encoding="utf-8")
    with (
        atomic_write(folder / "leaderboard.csv") as path,
        open(path, "w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(["task", "track", "controller", "run", "seed", *METRICS])
        writer.writerows(episodes)
    about = (
        f"Test episodes {seeds[0]} to {seeds[-1]}. Score: 0 to 1, the share of the episode that is "
        "left after settling; for Track 1 / (1 + RMS / band). IQM: mean of the middle half, "
        f"with a 95 % bootstrap interval over episodes. Decisions: one environment at a time."
    )
    with atomic_write(folder / "leaderboard.md") as path:
        path.write_text(page(results, about), encoding="utf-8")
    draw(results, folder / "leaderboard.png")


if __name__ == "__main__":
    sys.exit(main())
