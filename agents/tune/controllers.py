"""Parameters of controllers, found on tuning episodes by `agents.tune`."""

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.metrics import episode_metrics, make_batch, record
from agents.tune.search import EPISODES, SEED, TRIALS, kept_study, objective, searched
from dynamics.description import validate

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
    keep: Path | None = None,
) -> dict[str, Any]:
    """Best parameters of a controller and their mean score; `stored` ones are tried too.

    With a folder `keep`, a search that was interrupted goes on.
    """
    ranges = CONTROLLERS[validate.known(name, "controller", CONTROLLERS)].ranges
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

    middle = CONTROLLERS[name].middle
    first = [dict(x) for x in (middle, stored) if x]
    about = {
        "controller": name, "env": env_id, "kwargs": dict(kwargs), "middle": dict(middle),
        "seeds": [seed, episodes],
    }  # fmt: skip
    with closing(envs), kept_study(keep, about) as study:
        done = searched(study, judged, trials if ranges else 1, first)
    best = max(done, key=lambda trial: trial.value)
    return {
        "parameters": {key: float(f"{value:.{DIGITS}g}") for key, value in best.params.items()},
        "score": best.user_attrs["score"],
        "trials": len(done),
        "episodes": episodes,
    }
