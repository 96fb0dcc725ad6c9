"""`python -m agents.tune`: parameters of controllers and learners, found on tuning episodes.

Every controller gets the same number of trials of Optuna's TPE sampler on the same tuning episodes,
whose seeds differ from those of every evaluation. A trial is judged by the mean score, and among
equal ones by the RMS tip error. The first trials are the middle of the ranges and the parameters
that are stored. Results go to agents/tuned.json; a search that was interrupted keeps what it has
finished.

With --experiments the keywords of learners are searched in the same way, and a trial is a training
with one seed. The first is the experiment itself. At a ninth and a third of its steps a trial ends
unless it is in the best third of those so far (successive halving). The best three and the
experiment itself are then trained with two more seeds, and the best mean wins.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.config import Config, ConfigError, load_config
from agents.controllers import CONTROLLERS, controller
from agents.experiments import find_experiment
from agents.leaderboard.tracks import RANKED, TRACKS, keywords, takes_part
from agents.metrics import episode_metrics, make_batch, record
from agents.sentences import one_line
from agents.tuned import STORE, read, store
from dynamics.description import validate
from dynamics.extras import missing
from dynamics.types import AnyArray

TRIALS = 40
EPISODES = 48
SEED = 500_000  # of the first tuning episode
SLIGHT = 1e-3  # weight of the RMS error, which decides between equal scores
DIGITS = 4  # significant ones of what is found


def tune(
    name: str,
    env_id: str,
    kwargs: Mapping[str, Any],
    *,
    trials: int = TRIALS,
    episodes: int = EPISODES,
    seed: int = SEED,
    stored: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Best parameters of a controller and their mean score; `stored` ones are tried too."""
    ranges = CONTROLLERS[name].ranges
    envs = make_batch(env_id, episodes, kwargs)
    seeds, reach = list(range(seed, seed + episodes)), float(envs.unwrapped.reach)

    def judged(trial: Any) -> float:
        drawn = {
            key: trial.suggest_float(key, low, high, log=low > 0.0)
            for key, (low, high) in ranges.items()
        }
        try:
            metrics = episode_metrics(record(controller(name, envs, drawn), envs, seeds))
        except np.linalg.LinAlgError:  # no gain for these weights
            trial.set_user_attr("score", 0.0)
            return -1.0
        trial.set_user_attr("score", float(metrics["score"].mean()))
        return objective(metrics, reach)

    first = [dict(x) for x in (CONTROLLERS[name].middle, stored) if x]
    try:
        study = searched(judged, trials if ranges else 1, first)
    finally:
        envs.close()
    best = study.best_trial
    return {
        "parameters": {key: float(f"{value:.{DIGITS}g}") for key, value in best.params.items()},
        "score": best.user_attrs["score"],
        "trials": len(study.trials),
        "episodes": episodes,
    }


def searched(
    judged: Callable[[Any], float],
    trials: int,
    first: Sequence[dict[str, Any]] = (),
    reduction: int | None = None,
) -> Any:
    """Optuna's study of an objective; the first trials are those given.

    With a `reduction`, one of so many goes on at each step of successive halving.
    """
    try:
        import optuna
    except ModuleNotFoundError as error:
        raise missing(error, "agents.tune", "train") from None

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=0)
    pruner: Any = optuna.pruners.NopPruner()
    if reduction is not None:
        pruner = optuna.pruners.SuccessiveHalvingPruner(min_resource=1, reduction_factor=reduction)
    study = optuna.create_study(direction="maximize", sampler=sampler, pruner=pruner)
    for parameters in first:
        study.enqueue_trial(parameters)
    study.optimize(judged, n_trials=trials)
    return study


def objective(metrics: Mapping[str, AnyArray], reach: float) -> float:
    """Mean score, less a thousandth of the mean RMS tip error over the reach, at most 1."""
    apart = np.minimum(metrics["tip_error_rms"] / reach, 1.0)
    return float(metrics["score"].mean()) - SLIGHT * float(apart.mean())


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
    parser.add_argument("--out", type=Path, default=STORE)
    options = parser.parse_args(arguments)
    try:
        for name in options.controllers:
            validate.known(name, "controller", CONTROLLERS)
        for track in options.tracks:
            validate.known(track, "track", TRACKS)
        for env_id in options.tasks:
            validate.known(env_id, "task", RANKED)
        validate.integer(options.trials, "--trials", 1, 100_000)
        validate.integer(options.episodes, "--episodes", 1, 100_000)
        experiments = [load_config(find_experiment(x)) for x in options.experiments or ()]
        if experiments:
            tune_experiments(experiments, options)
            return 0
    except (ValueError, ConfigError) as error:
        print(f"agents.tune: {one_line(error)}", file=sys.stderr)
        return 2
    tune_controllers(options)
    return 0


def tune_controllers(options: argparse.Namespace) -> None:
    """Tune the controllers of the command line where they take part."""
    for env_id in options.tasks:
        for track in options.tracks:
            for name in options.controllers:
                if not takes_part(name, env_id, track) or not CONTROLLERS[name].ranges:
                    continue
                before = read(options.out).get(env_id, {}).get(track, {}).get(name, {})
                found = tune(
                    name, env_id, keywords(name, track), trials=options.trials,
                    episodes=options.episodes, stored=before.get("parameters"),
                )  # fmt: skip
                print(f"{env_id}, {track}, {name}: {_line(found)}", flush=True)
                store(options.out, env_id, track, name, found)


def tune_experiments(experiments: list[Config], options: argparse.Namespace) -> None:
    """Tune the learners of experiments; all must be of a track, so that they can be ranked."""
    from agents.learners.tuning import place_of, tune_experiment

    places = [place_of(config) for config in experiments]
    for config, place in zip(experiments, places, strict=True):
        found = tune_experiment(config, trials=options.trials, episodes=options.episodes)
        print(f"{config.name}: {_line(found)}; {found['untuned']:.3f} as it is", flush=True)
        store(options.out, *place, found)


def _line(found: Mapping[str, Any]) -> str:
    numbers = ", ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in found["parameters"].items()
    )
    return f"score {found['score']:.3f} with {numbers}"


if __name__ == "__main__":
    sys.exit(main())
