"""`python -m agents.leaderboard`: rank controllers on every task and track.

Every controller meets the same test episodes, whose seeds no tuning and no training uses. Results
are leaderboard.json, {task: {track: {controller: figures}}}, leaderboard.csv with one row per
episode, leaderboard.md and its pictures. A user's own class takes part by `--controllers
mymodule:MyController`; it is called with the environment, and must have `predict` as a trained
policy has.
"""

import argparse
import importlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.environments import look_in_present_folder
from agents.figures import save_figure
from agents.files import check_folder
from agents.hybrid.controller import acting
from agents.leaderboard import stored
from agents.leaderboard.bound import PLANTS, best_of, compute
from agents.leaderboard.charts import pictures
from agents.leaderboard.output import row, write
from agents.leaderboard.replay import YARDSTICK, optimal, replayed
from agents.leaderboard.shipped import shipped
from agents.leaderboard.statistics import (
    Entry,
    compared,
    decisions,
    figures,
    rounded,
    spectrum,
)
from agents.leaderboard.tracks import RANKED, TRACKS, keywords, takes_part
from agents.metrics import METRICS, episode_metrics, make_batch, record
from agents.policy import Controller
from agents.sentences import one_line, speaker
from agents.tuned import is_tuned, parameters_of
from dynamics.description import validate
from dynamics.types import AnyArray

SEED, EPISODES = 10_000, 100
TIMED = 200  # single decisions that are timed


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


def built(name: str, env: Any, env_id: str, track: str) -> Iterator[Controller]:
    """Controllers of a name, made for a design environment: one per training seed of a policy.

    Each is made when its turn comes: filters of six links take much memory.
    """
    if name in CONTROLLERS:
        parameters = parameters_of(name, env_id, track) if CONTROLLERS[name].ranges else {}
        yield controller(name, env, parameters)
    elif ":" in name:
        yield users_controller(name, env)
    else:
        for policy in shipped(env_id, TRACKS[track].design)[name]:
            yield acting(policy, env)


def users_class(name: str) -> Callable[[Any], Controller]:
    """The class that a user names on the command line as mymodule:MyController."""
    module, _, attribute = name.partition(":")
    here = look_in_present_folder()
    try:
        found: Callable[[Any], Controller] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"--controllers {name} cannot be imported: {error}. Write module:Class, the module "
            f"without .py and in {here} or installed."
        ) from None
    return found


def users_controller(name: str, env: Any) -> Controller:
    """A user's controller, after one call as every episode makes it."""
    try:
        subject = users_class(name)(env)
    except (AttributeError, TypeError) as error:
        raise ValueError(
            f"--controllers {name} cannot be made: {error}; it is called with the environment."
        ) from error
    observation, _ = env.reset(seed=[SEED])
    wanted = "it is called as predict(observation, state, episode_start) and returns action, state"
    try:
        result = subject.predict(observation, None, np.ones(1, dtype=bool))
        action, _ = result
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"--controllers {name} failed in predict: {error}; {wanted}.") from error
    shape = np.shape(action)
    if shape != env.action_space.shape:
        raise ValueError(
            f"--controllers {name} gave actions of shape {shape}, expected "
            f"{env.action_space.shape}: a row per environment; {wanted}."
        )
    return subject


def try_users_controller(name: str, env_id: str, track: str) -> None:
    """Refuse a user's class that cannot be made or called under the track's design conditions."""
    env = make_batch(env_id, 1, keywords(name, TRACKS[track].design))
    try:
        users_controller(name, env)
    finally:
        env.close()


def ranked(
    name: str, env_id: str, track: str, seeds: Sequence[int], bounds: Path | None = None
) -> Entry:
    """Entry of a controller, made for the track's design conditions.

    The episodes of all training seeds of a policy count. The yardstick meets those episodes alone
    that have a bound, in the package or in the folder `bounds`.
    """
    if name == YARDSTICK:
        seeds = replayed(env_id, track, seeds, bounds)
    design = make_batch(env_id, 1, keywords(name, TRACKS[track].design))
    kwargs = keywords(name, track)
    envs, single = make_batch(env_id, len(seeds), kwargs), make_batch(env_id, 1, kwargs)
    try:
        if name == YARDSTICK:
            subjects: Iterator[Controller] = iter([optimal(env_id, track, seeds, bounds)])
        else:
            subjects = built(name, design, env_id, track)
        first = next(subjects)
        recordings = [record(first, envs, seeds)]
        milliseconds = decision_times(first, single, seeds[0])
        del first
        recordings += [record(subject, envs, seeds) for subject in subjects]
        each = [episode_metrics(recording) for recording in recordings]
        metrics = {key: rounded(np.stack([found[key] for found in each])) for key in METRICS}
        best = best_of(env_id, track, seeds, bounds)
        found = figures(
            metrics, best,
            privileged=name == YARDSTICK,
            learned=name in shipped(env_id, TRACKS[track].design),
        ) | decisions(milliseconds, envs.unwrapped.control_dt)  # fmt: skip
        return Entry(found, metrics, spectrum(recordings), seeds)
    finally:
        for env in (design, envs, single):
            env.close()


def names(wanted: Sequence[str] | None, env_id: str, track: str, bounded: bool) -> list[str]:
    """Controllers that act on a task and track, all or those that are wanted.

    The yardstick is among them where bounds are known.
    """
    classical = [name for name in CONTROLLERS if takes_part(name, env_id, track)]
    others = [*shipped(env_id, TRACKS[track].design), *[YARDSTICK] * bounded]
    if wanted is None:
        return [*(name for name in classical if is_tuned(name, env_id, track)), *others]
    return [name for name in wanted if ":" in name or name in (*classical, *others)]


def main(arguments: list[str] | None = None, prog: str = "python -m agents.leaderboard") -> int:
    """Rank, and write after every task; the exit status."""
    options = _parser(prog).parse_args(arguments)
    seeds = list(range(options.seed, options.seed + options.episodes))
    bounds = options.out / "bounds" if options.bound else None
    try:
        _check(options)
        check_folder(options.out)
        before = stored.known(stored.read(options.beside, seeds, bounds)) if options.beside else {}
    except ValueError as error:
        print(f"{speaker(prog)}: {one_line(error)}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    results = {
        env_id: {track: compared(found) for track, found in tracks.items()}
        for env_id, tracks in before.items()
    }
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        run = map if options.jobs == 1 else pool.map
        for env_id in options.tasks:
            places = _places(options, env_id, seeds, bounds)
            now = before.setdefault(env_id, {})
            entries = run(partial(_entry, env_id, seeds, bounds), places)
            for (track, name), entry in zip(places, entries, strict=True):
                now.setdefault(track, {})[name] = entry
                print(f"{env_id}, {track}: {row(name, entry.figures)}", flush=True)
            if now:
                results[env_id] = {track: compared(found) for track, found in now.items()}
            write(options.out, results, seeds)
    for file, draw in pictures(results).items():
        save_figure(draw(), options.out / file)
    print(f"Everything is in {options.out}/")
    return 0


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog, description="Rank controllers on tasks and tracks, on the same test episodes."
    )
    parser.add_argument("--tasks", nargs="+", default=list(RANKED), metavar="ID")
    parser.add_argument("--tracks", nargs="+", default=list(TRACKS), metavar="TRACK")
    parser.add_argument(
        "--controllers", nargs="+", metavar="NAME",
        help="of the table, of a shipped policy, or mymodule:MyController (default: all)",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=SEED, help="of the first test episode")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument(
        "--beside", type=Path, metavar="FOLDER",
        help="of a former ranking of these episodes, whose other controllers are kept",
    )  # fmt: skip
    parser.add_argument(
        "--bound", action="store_true",
        help="search the bounds of episodes that have none, and keep them in OUT/bounds",
    )  # fmt: skip
    parser.add_argument(
        "--jobs", type=int, default=1, help="processes; decisions are timed in them"
    )
    parser.add_argument("--out", type=Path, default=Path("leaderboard"))
    return parser


def _places(
    options: argparse.Namespace, env_id: str, seeds: Sequence[int], bounds: Path | None
) -> list[tuple[str, str]]:
    """Tracks and controllers that are ranked on a task, after the bounds that are asked for."""
    if bounds is not None:
        for track in [track for track in options.tracks if track in PLANTS]:
            compute(env_id, track, seeds, options.jobs, bounds)
    return [
        (track, name)
        for track in options.tracks
        for name in names(
            options.controllers, env_id, track, best_of(env_id, track, seeds, bounds) is not None
        )
    ]


def _entry(env_id: str, seeds: Sequence[int], bounds: Path | None, place: tuple[str, str]) -> Entry:
    track, name = place
    return ranked(name, env_id, track, seeds, bounds)


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
            known = sorted({*CONTROLLERS, *shipped_names, YARDSTICK})
            if name not in known and (Path(name).exists() or Path(f"{name}.py").exists()):
                raise ValueError(
                    f"{name!r} is a file or a folder; --controllers takes a name of {known}, or a "
                    "class or function of yours as module:Class, which may load a policy."
                )
            validate.known(name, "controller", known)
    validate.integer(options.jobs, "--jobs", 1, 1024)
    validate.integer(options.episodes, "--episodes", 2, 100_000)  # an interval needs two
    validate.integer(options.seed, "--seed", 0, 2**31)
    seeds = range(options.seed, options.seed + options.episodes)
    found = [
        (name, env_id, track)
        for env_id in options.tasks
        for track in options.tracks
        for name in names(
            options.controllers, env_id, track,
            (options.bound and track in PLANTS) or best_of(env_id, track, seeds) is not None,
        )
    ]  # fmt: skip
    for name, *place in found:
        if name in CONTROLLERS and CONTROLLERS[name].ranges:
            parameters_of(name, *place)
        elif ":" in name:
            try_users_controller(name, *place)
    if not found:
        raise ValueError(f"None of {options.controllers} acts on these tasks and tracks.")


if __name__ == "__main__":
    sys.exit(main())
