"""`python -m agents.tune`: parameters of the classical controllers, found on tuning episodes.

Every controller gets the same number of trials of Optuna's TPE sampler on the same tuning episodes,
whose seeds differ from those of every evaluation. A trial is judged by the mean score, and among
equal ones by the RMS tip error. The first trials are the middle of the ranges and the parameters
that are stored. Results go to agents/tuned.json; a search that was interrupted keeps what it has
finished.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.files import atomic_write
from agents.leaderboard.tracks import RANKED, TRACKS, keywords, takes_part
from agents.metrics import episode_metrics, make_batch, record
from dynamics.description import validate
from dynamics.extras import missing
from dynamics.types import AnyArray

TRIALS = 40
EPISODES = 48
SEED = 500_000  # of the first tuning episode
SLIGHT = 1e-3  # weight of the RMS error, which decides between equal scores
STORE = Path(__file__).with_name("tuned.json")


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
    try:
        import optuna
    except ModuleNotFoundError as error:
        raise missing(error, "agents.tune", "train") from None

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
        mean = float(metrics["score"].mean())
        trial.set_user_attr("score", mean)
        return objective(metrics, reach)

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=0))
    for parameters in filter(None, (CONTROLLERS[name].middle, stored)):
        study.enqueue_trial(dict(parameters))
    try:
        study.optimize(judged, n_trials=trials if ranges else 1)
    finally:
        envs.close()
    best = study.best_trial
    return {
        "parameters": {key: float(f"{value:.4g}") for key, value in best.params.items()},
        "score": best.user_attrs["score"],
        "trials": len(study.trials),
        "episodes": episodes,
    }


def objective(metrics: Mapping[str, AnyArray], reach: float) -> float:
    """Mean score, less a thousandth of the mean RMS tip error over the reach, at most 1."""
    apart = np.minimum(metrics["tip_error_rms"] / reach, 1.0)
    return float(metrics["score"].mean()) - SLIGHT * float(apart.mean())


@lru_cache(maxsize=1)
def tuned() -> dict[str, Any]:
    """Contents of tuned.json: id -> track -> controller -> parameters, score, trials."""
    return read(STORE)


def is_tuned(name: str, env_id: str, track: str) -> bool:
    """True if a controller has nothing to tune, or its parameters are stored."""
    stored = tuned().get(env_id, {}).get(TRACKS[track].design, {})
    return not CONTROLLERS[name].ranges or name in stored


def parameters_of(name: str, env_id: str, track: str) -> dict[str, float]:
    """Stored parameters of a controller; a ValueError if it was not tuned there."""
    found = tuned().get(env_id, {}).get(TRACKS[track].design, {}).get(name)
    if found is None:
        raise ValueError(
            f"{name} was not tuned for {env_id} on the track {track!r}; run python -m agents.tune "
            f"--tasks {env_id} --controllers {name}."
        )
    result: dict[str, float] = found["parameters"]
    return result


def main(arguments: list[str] | None = None) -> int:
    """Tune, and store after each controller; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.tune", description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=list(RANKED), metavar="ID")
    parser.add_argument("--tracks", nargs="+", default=["state", "laboratory"], metavar="TRACK")
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME")
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
        trials = validate.integer(options.trials, "--trials", 1, 100_000)
        episodes = validate.integer(options.episodes, "--episodes", 1, 100_000)
    except ValueError as error:
        print(f"agents.tune: {error}", file=sys.stderr)
        return 2
    for env_id in options.tasks:
        for track in options.tracks:
            for name in options.controllers:
                if not takes_part(name, env_id, track) or not CONTROLLERS[name].ranges:
                    continue
                before = read(options.out).get(env_id, {}).get(track, {}).get(name, {})
                found = tune(
                    name, env_id, keywords(name, track), trials=trials, episodes=episodes,
                    stored=before.get("parameters"),
                )  # fmt: skip
                print(f"{env_id}, {track}, {name}: {_line(found)}", flush=True)
                store(options.out, env_id, track, name, found)
    return 0


def read(path: Path) -> dict[str, Any]:
    """Contents of a file of results, empty if there is none."""
    if not path.exists():
        return {}
    result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return result


def store(path: Path, env_id: str, track: str, name: str, found: Mapping[str, Any]) -> None:
    """Add one result to the file, whatever it has by now."""
    data = read(path)
    data.setdefault(env_id, {}).setdefault(track, {})[name] = dict(found)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _line(found: Mapping[str, Any]) -> str:
    numbers = ", ".join(f"{key} {value:g}" for key, value in found["parameters"].items())
    return f"score {found['score']:.3f} with {numbers}"


if __name__ == "__main__":
    sys.exit(main())
