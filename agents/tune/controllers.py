"""Parameters of controllers, found on tuning episodes; what every search has in common."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.metrics import episode_metrics, make_batch, record
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
