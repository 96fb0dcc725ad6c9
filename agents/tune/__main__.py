"""`python -m agents.tune`: parameters of controllers and learners, found on tuning episodes.

Every controller gets the same number of trials of Optuna's TPE sampler on the same tuning episodes,
whose seeds differ from those of every evaluation. A trial is judged by the mean score, and among
equal ones by the RMS tip error. The first trials are the middle of the ranges and the parameters
that are stored. Results go to agents/tuned.json. A command that was interrupted goes on from the
trials that it has finished, in the folder of --keep.

With --experiments the keywords of learners are searched in the same way, and a trial is a training
with one seed. The first is the experiment itself. At a ninth and a third of its steps a trial ends
unless it is in the best third of those so far (successive halving). The best three and the
experiment itself are then trained with two more seeds, and the best mean wins.
"""

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

from agents.config import Config, ConfigError, load_config
from agents.controllers import CONTROLLERS
from agents.environments import title
from agents.experiments import find_experiment
from agents.files import FolderError, check_folder
from agents.leaderboard.tracks import RANKED, TRACKS, keywords, takes_part
from agents.learners.divergence import TrainingError
from agents.policy import PolicyError
from agents.sentences import one_line, refused
from agents.tune.controllers import tune
from agents.tune.search import EPISODES, TRIALS
from agents.tuned import STORE, read, store
from dynamics.command import completed
from dynamics.description import validate
from dynamics.description.data_file import user_path

SEARCHED = ("tasks", "tracks", "controllers")  # options of a search of controllers
Place = tuple[str, str, str]  # task, track and name


def main(arguments: list[str] | None = None) -> int:
    """Tune, and store after each controller; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.tune", description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=list(RANKED), metavar="ID")
    parser.add_argument("--tracks", nargs="+", default=["state", "laboratory"], metavar="TRACK")
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME")
    parser.add_argument(
        "--experiments", nargs="+", metavar="CONFIG",
        help="learners instead of controllers: files, or names of shipped experiments",
    )  # fmt: skip
    parser.add_argument("--trials", type=int, default=TRIALS)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--out", type=user_path, default=STORE)
    parser.add_argument(
        "--keep", type=user_path, default=Path("runs/tune"), metavar="DIR",
        help="folder of unfinished searches, which go on from there (default: %(default)s)",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    unused = [name for name in SEARCHED if getattr(options, name) != parser.get_default(name)]
    try:
        experiments = _check(options, unused)
    except (ValueError, ConfigError) as error:
        return refused(parser.prog, error)
    try:
        if experiments:
            tune_experiments(experiments, options)
        else:
            tune_controllers(options)
    except (ConfigError, FolderError, PolicyError, TrainingError, ModuleNotFoundError) as error:
        return refused(parser.prog, error)
    except OSError as error:
        return refused(parser.prog, f"{one_line(error)}; the same command goes on.", 1)
    except KeyboardInterrupt:
        return refused(parser.prog, "interrupted; the same command goes on.", 130)
    return 0


def _check(options: argparse.Namespace, unused: Sequence[str]) -> dict[Place, Config]:
    """Experiments of a command line by their places; a ValueError for what cannot be searched.

    `unused` are options that are given, and of controllers alone.
    """
    if options.experiments and unused:
        raise ValueError(
            f"--experiments name their own tasks, tracks and learners; leave --{unused[0]} out."
        )
    for name in options.controllers:
        validate.known(name, "controller", CONTROLLERS)
    for track in options.tracks:
        design = TRACKS[validate.known(track, "track", TRACKS)].design
        if design != track:
            raise ValueError(
                f"--tracks {track} ranks the controllers of {design}, unchanged, so that what is "
                f"found there would act nowhere; tune on --tracks {design}."
            )
    for env_id in options.tasks:
        validate.known(env_id, "task", RANKED)
    validate.integer(options.trials, "--trials", 1, 100_000)
    validate.integer(options.episodes, "--episodes", 1, 100_000)
    experiments = _placed(options.experiments or ())
    if not experiments and not _searched(options):
        raise ValueError(
            f"None of {options.controllers} has parameters to search on these tasks and tracks."
        )
    check_folder(options.out.parent)
    read(options.out)
    check_folder(options.keep, "--keep")
    return experiments


def tune_controllers(options: argparse.Namespace) -> None:
    """Tune the controllers of the command line where they take part."""
    places = _searched(options)
    for env_id, track, name in places:
        before = read(options.out).get(env_id, {}).get(track, {}).get(name, {})
        found = tune(
            name, env_id, keywords(name, track), trials=options.trials,
            episodes=options.episodes, stored=before.get("parameters"),
            keep=_folder(options.keep, env_id, track, name),
        )  # fmt: skip
        print(f"{env_id}, {track}, {name}: {_line(found)}", flush=True)
        store(options.out, env_id, track, name, found)
    _clear(options.keep, places)


def _searched(options: argparse.Namespace) -> list[Place]:
    """Places of the controllers of the command line that take part and have parameters."""
    places = (
        (env_id, track, name)
        for env_id in options.tasks
        for track in options.tracks
        for name in options.controllers
        if takes_part(name, env_id, track) and CONTROLLERS[name].ranges
    )
    return list(dict.fromkeys(places))


def tune_experiments(experiments: Mapping[Place, Config], options: argparse.Namespace) -> None:
    """Tune the learners of experiments."""
    from agents.tune.learners import tune_experiment

    for place, config in experiments.items():
        found = tune_experiment(
            config, trials=options.trials, episodes=options.episodes,
            keep=_folder(options.keep, *place),
            report=partial(_report, config.name),
        )  # fmt: skip
        print(f"{config.name}: {_line(found)}; {found['untuned']:.3f} as it is", flush=True)
        store(options.out, *place, found)
    _clear(options.keep, experiments)


def _placed(given: Sequence[str]) -> dict[Place, Config]:
    """Experiments by the place where they are ranked; a ValueError for one without its own."""
    if not given:
        return {}
    from agents.tune.learners import place_of

    placed: dict[Place, Config] = {}
    for config in (load_config(find_experiment(x)) for x in given):
        place = place_of(config)
        if (other := placed.setdefault(place, config)) != config:
            raise ValueError(
                f"--experiments: {other.name} and {config.name} have one place, "
                f"{', '.join(place)}, where one result is stored; search them one after the other, "
                "each with its --out."
            )
    return placed


def _folder(keep: Path, env_id: str, track: str, name: str) -> Path:
    """Folder of one search."""
    return keep / title(env_id) / track / name


def _clear(keep: Path, places: Iterable[Place]) -> None:
    """Remove the searches of a command that has ended; until then none of them is repeated."""
    for place in places:
        rmtree(_folder(keep, *place))


def _report(name: str, text: str) -> None:
    print(f"{name}: {text}", flush=True)


def _line(found: Mapping[str, Any]) -> str:
    numbers = ", ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in found["parameters"].items()
    )
    return f"score {found['score']:.3f} " + (f"with {numbers}" if numbers else "with none changed")


if __name__ == "__main__":
    sys.exit(completed("agents.tune", main))
