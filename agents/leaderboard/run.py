"""`python -m agents.leaderboard`: rank controllers on every task and track.

Every controller meets the same test episodes, whose seeds no tuning and no training uses. Results
are leaderboard.json, {task: {track: {controller: figures}}}, leaderboard.csv.bz2 with one row per
episode, leaderboard.md and its pictures. A user's own class takes part by `--controllers
mymodule:MyController`; it is called with the environment, and must have `predict` as a trained
policy has.
"""

import argparse
import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.figures import save_figure
from agents.files import FolderError, check_folder
from agents.hybrid.controller import acting
from agents.leaderboard import stored
from agents.leaderboard.bound import PLANTS, best_of, compute
from agents.leaderboard.charts import Results, pictures
from agents.leaderboard.decisions import Late, decision_times, lateness
from agents.leaderboard.kinds import needs
from agents.leaderboard.output import row, write
from agents.leaderboard.replay import OPTIMAL, optimal, replayed
from agents.leaderboard.shipped import policies_of
from agents.leaderboard.statistics import Entry, compared, decisions, figures, rounded, spectrum
from agents.leaderboard.tracks import HARDER, RANKED, TRACKS, keywords, takes_part
from agents.leaderboard.users import UsersControllerError, users_controller
from agents.metrics import METRICS, episode_metrics, make_batch, record
from agents.policy import Controller
from agents.sentences import Failures
from agents.signals import workers
from agents.tuned import is_tuned, parameters_of
from dynamics.description import validate
from dynamics.description.data_file import user_path
from dynamics.types import AnyArray

SEED, EPISODES = 10_000, 100
LEFT_OUT = (UsersControllerError, ModuleNotFoundError)  # of one controller; others are ranked
RANKING = ("tasks", "tracks", "controllers", "seed", "episodes", "beside", "bound", "jobs")


def built(name: str, env: Any, env_id: str, track: str) -> Iterator[Controller]:
    """Controllers of a name, made for a design environment: one per training seed of a policy.

    Each is made when its turn comes: filters of six links take much memory.
    """
    if name in CONTROLLERS:
        parameters = parameters_of(name, env_id, track) if CONTROLLERS[name].ranges else {}
        yield controller(name, env, parameters)
    elif ":" in name:
        yield users_controller(name, env, SEED)
    else:
        for policy in policies_of(env_id, track)[name]:
            yield acting(policy, env)


def designed_in(name: str, env_id: str, track: str) -> Any:
    """An environment in the conditions for which a track's controllers are made."""
    return make_batch(env_id, 1, keywords(name, TRACKS[track].design))


def ranked(
    name: str, env_id: str, track: str, seeds: Sequence[int], bounds: Path | None = None
) -> Entry:
    """Entry of a controller, made for the track's design conditions.

    The episodes of all training seeds of a policy count. `optimal` meets those episodes alone
    that have a bound, in the package or in the folder `bounds`. A controller that misses its
    control step is judged with the delay that it causes.
    """
    if name == OPTIMAL:
        seeds = replayed(env_id, track, seeds, bounds)
    with (
        closing(designed_in(name, env_id, track)) as design,
        closing(make_batch(env_id, len(seeds), keywords(name, track))) as envs,
    ):
        if name == OPTIMAL:
            subjects: Iterator[Controller] = iter([optimal(env_id, track, seeds, bounds)])
        else:
            subjects = built(name, design, env_id, track)
        first = next(subjects)
        recordings = [record(first, envs, seeds)]
        new = seeds[-1] + 1  # an episode for which nothing is remembered
        times = timed(first, name, env_id, track, new)
        steps = lateness(times[1:], envs.unwrapped.control_dt)
        if steps.any():
            subjects = (Late(subject, steps) for subject in chain([first], subjects))
            recordings = []
        del first
        recordings += [record(subject, envs, seeds) for subject in subjects]
        each = [episode_metrics(recording) for recording in recordings]
        metrics = {key: rounded(np.stack([found[key] for found in each])) for key in METRICS}
        best = best_of(env_id, track, seeds, bounds)
        found = figures(
            metrics, best,
            privileged=name == OPTIMAL,
            learned=name in policies_of(env_id, track),
        )  # fmt: skip
        found |= needs(name, env_id, track)
        found |= decisions(times, envs.unwrapped.control_dt)
        found["judged_late"] = float(steps.mean())
        return Entry(found, metrics, spectrum(recordings), seeds)


def timed(subject: Controller, name: str, env_id: str, track: str, seed: int) -> AnyArray:
    """(T,) [ms] of a controller's decisions, in episodes from `seed` on."""
    with closing(make_batch(env_id, 1, keywords(name, track))) as env:
        return decision_times(subject, env, seed)


def names(
    wanted: Sequence[str] | None, env_id: str, track: str, bounded: bool, untuned: bool = True
) -> list[str]:
    """Controllers that act on a task and track, all or those that are wanted, perhaps untuned.

    `optimal` is among them where bounds are known. Where no controller was tuned, only those
    that are wanted act.
    """
    classical = [name for name in CONTROLLERS if takes_part(name, env_id, track)]
    others = [*policies_of(env_id, track), *[OPTIMAL] * bounded]
    if wanted is None:
        ready = [name for name in classical if is_tuned(name, env_id, track)]
        return [*ready, *others] if any(CONTROLLERS[name].ranges for name in ready) else others
    if not untuned:
        classical = [name for name in classical if is_tuned(name, env_id, track)]
    return [name for name in wanted if ":" in name or name in (*classical, *others)]


def main(arguments: list[str] | None = None, prog: str = "python -m agents.leaderboard") -> int:
    """Rank, and write after every task; the exit status.

    A user's controller that fails, or one whose library is missing, is told in one sentence and
    left out, and the status is 1.
    """
    parser = _parser(prog)
    options = parser.parse_args(arguments)
    seeds = list(range(options.seed, options.seed + options.episodes))
    bounds = options.out / "bounds" if options.bound else None
    failures = Failures(prog)
    try:
        if options.redraw or options.times:
            given = [name for name in RANKING if getattr(options, name) != parser.get_default(name)]
            return redraw(options.out, given, failures, options.times)
        return rank(options, seeds, bounds, failures)
    except KeyboardInterrupt:
        failures.tell(KeyboardInterrupt("interrupted; tasks that are done are written."))
        return 130
    except BrokenPipeError:
        failures.tell(FolderError("nobody reads the output; tasks that are done are written."))
        return 1
    except OSError as error:
        failures.tell(FolderError(f"writing to {options.out} failed ({error.strerror or error})."))
        return 1


def rank(
    options: argparse.Namespace, seeds: Sequence[int], bounds: Path | None, failures: Failures
) -> int:
    """Check the options, rank, and write; the exit status."""
    options.untuned, options.tracks = options.tracks is not None, options.tracks or list(TRACKS)
    try:
        places = _check(options)
        check_folder(options.out)
        before = stored.known(stored.read(options.beside, seeds, bounds)) if options.beside else {}
    except ValueError as error:
        failures.tell(error)
        return 2
    if not [place for place in places if _works(*place, failures)]:
        return 2
    if results := _rank(options, seeds, bounds, before, failures):
        _draw(results, options.out)
    return 1 if failures.told else 0


def redraw(folder: Path, given: Sequence[str], failures: Failures, times: bool = False) -> int:
    """Write figures, page and pictures of a stored ranking again; the exit status.

    With `times`, decisions are timed again. No option of a ranking may be given beside it.
    """
    try:
        if given:
            raise ValueError(
                f"{'--times' if times else '--redraw'} takes the ranking in --out as it is, and "
                f"ranks nothing: leave out {' '.join(f'--{name}' for name in given)}."
            )
        check_folder(folder)
        entries = stored.read(folder, None, folder / "bounds")
        if times:
            _time(entries)
        results = _compared(entries)
    except ValueError as error:
        failures.tell(error)
        return 2
    each = (x for tracks in results.values() for found in tracks.values() for x in found.values())
    write(folder, results, max((entry.seeds for entry in each), key=len))
    _draw(results, folder)
    return 0


def _draw(results: Results, folder: Path) -> None:
    for file, draw in pictures(results).items():
        save_figure(draw(), folder / file)
    print(f"Everything is in {folder}/")


def _time(entries: stored.Entries) -> None:
    """Time the decisions of all entries but those of `optimal` and of users."""
    for env_id, tracks in entries.items():
        for track, found in tracks.items():
            for name, entry in found.items():
                if name != OPTIMAL and ":" not in name:
                    with closing(designed_in(name, env_id, track)) as design:
                        subject, last = next(built(name, design, env_id, track)), entry.seeds[-1]
                        timed(subject, name, env_id, track, last)  # builds what serves all episodes
                        times = timed(subject, name, env_id, track, last + 1)
                        entry.figures.update(decisions(times, design.unwrapped.control_dt))
            print(f"{env_id}, {track}: decisions timed", flush=True)


def _compared(entries: stored.Entries) -> dict[str, dict[str, dict[str, Entry]]]:
    return {
        env_id: {track: compared(found) for track, found in tracks.items()}
        for env_id, tracks in entries.items()
    }


def _rank(
    options: argparse.Namespace,
    seeds: Sequence[int],
    bounds: Path | None,
    before: stored.Entries,
    failures: Failures,
) -> Results:
    """Results of all tasks, beside former entries, which are written after every task."""
    results = _compared(before)
    with workers(options.jobs) as pool:
        run = map if options.jobs == 1 else pool.map
        for env_id in options.tasks:
            places = _places(options, env_id, seeds, bounds)
            now = before.get(env_id, {})
            entries = run(partial(_entry, env_id, seeds, bounds), places)
            for (track, name), entry in zip(places, entries, strict=True):
                if isinstance(entry, LEFT_OUT):
                    failures.tell(entry)
                    now.get(track, {}).pop(name, None)
                else:
                    now.setdefault(track, {})[name] = entry
                    shown = " | ".join(row(name, entry.figures))
                    print(f"{env_id}, {track}: | {shown} |", flush=True)
            if ranked_now := {track: compared(found) for track, found in now.items() if found}:
                results[env_id] = ranked_now
                options.out.mkdir(parents=True, exist_ok=True)
                write(options.out, results, seeds)
    return results


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog, description="Rank controllers on tasks and tracks, on the same test episodes."
    )
    parser.add_argument("--tasks", nargs="+", default=list(RANKED), metavar="ID",
                        help=f"default: all but {', '.join(HARDER)}")  # fmt: skip
    parser.add_argument("--tracks", nargs="+", metavar="TRACK",
                        help="default: all on which a controller was tuned")  # fmt: skip
    parser.add_argument(
        "--controllers", nargs="+", metavar="NAME",
        help="of the table, of a shipped policy, or mymodule:MyController (default: all)",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=SEED, help="of the first test episode")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument(
        "--beside", type=user_path, metavar="FOLDER",
        help="of a former ranking of these episodes, whose other controllers are kept",
    )  # fmt: skip
    parser.add_argument(
        "--bound", action="store_true",
        help="search the bounds of episodes that have none, and keep them in OUT/bounds",
    )  # fmt: skip
    parser.add_argument(
        "--redraw", action="store_true",
        help="rank nothing: figures, page and pictures of the ranking in OUT from its episodes",
    )  # fmt: skip
    parser.add_argument(
        "--times", action="store_true",
        help="rank nothing: time the decisions of the ranking in OUT again, and redraw it",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=1, help="processes, which time decisions")
    parser.add_argument(
        "--out", type=user_path, default=Path("leaderboard"), metavar="DIR",
        help="folder, whose former ranking is replaced (default: %(default)s)",
    )  # fmt: skip
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
            options.controllers,
            env_id,
            track,
            best_of(env_id, track, seeds, bounds) is not None,
            options.untuned,
        )
    ]


def _entry(
    env_id: str, seeds: Sequence[int], bounds: Path | None, place: tuple[str, str]
) -> Entry | UsersControllerError | ModuleNotFoundError:
    track, name = place
    try:
        return ranked(name, env_id, track, seeds, bounds)
    except LEFT_OUT as error:
        return error


def _works(name: str, env_id: str, track: str, failures: Failures) -> bool:
    """True unless a user's class fails under the track's design conditions, which is told."""
    if ":" not in name:
        return True
    try:
        with closing(designed_in(name, env_id, track)) as env:
            users_controller(name, env, SEED)
    except UsersControllerError as error:
        failures.tell(error)
        return False
    return True


def _check(options: argparse.Namespace) -> list[tuple[str, str, str]]:
    """Controllers, tasks and tracks of a ranking; a ValueError if one of them cannot be."""
    for env_id in options.tasks:
        validate.known(env_id, "task", (*RANKED, *HARDER))
    for track in options.tracks:
        validate.known(track, "track", TRACKS)
    shipped_names = {
        name for env_id in RANKED for track in TRACKS for name in policies_of(env_id, track)
    }
    for name in options.controllers or ():
        if ":" not in name:
            known = sorted({*CONTROLLERS, *shipped_names, OPTIMAL})
            if name not in known and any(map(os.path.exists, (name, f"{name}.py"))):
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
            options.untuned,
        )
    ]  # fmt: skip
    for name, *place in found:
        if name in CONTROLLERS and CONTROLLERS[name].ranges:
            parameters_of(name, *place)
    if not found:
        raise ValueError(f"None of {options.controllers} acts on these tasks and tracks.")
    return found
