"""Keywords of an experiment's learner, found on tuning episodes by `agents.tune`."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from agents.config import Config, config_from_dict
from agents.hybrid.controller import acting
from agents.leaderboard.shipped import ranked_as
from agents.leaderboard.tracks import track_of
from agents.learners.algorithms import settings
from agents.learners.export import export_policy
from agents.learners.ranges import DEFAULTS, drawn, suggested
from agents.metrics import episode_metrics, make_batch, record
from agents.policy import Policy
from agents.training import about_policy, build_model
from agents.tune import EPISODES, SEED, TRIALS, objective, searched

REDUCTION = 3  # of so many trials one goes on
RUNGS = (1, 3)  # ninths of the steps after which a trial may end
NINTHS = REDUCTION * RUNGS[-1]
SCALES = {"between": [0.03, 1.0], "log": True}  # of what is learned beside a base


def place_of(config: Config) -> tuple[str, str, str]:
    """Task, track and name under which an experiment's policies are ranked."""
    env, kwargs = config.env.id, config.env.kwargs
    track = track_of(config.agent.name, env, kwargs)
    if track is None:
        raise ValueError(
            f"{config.name} is not on a track: {env} with {kwargs}; search its keywords by "
            "python -m agents.sweep."
        )
    return env, track, ranked_as(config.agent.name, config.to_dict().get("base"), config.env.stack)


def tune_experiment(
    config: Config, *, trials: int = TRIALS, episodes: int = EPISODES, seed: int = SEED
) -> dict[str, Any]:
    """Best keywords of an experiment's learner, their mean score, and that of its own."""
    plain = replace(config, sweep={})
    ranges = ranges_of(config)
    scales = {} if config.base is None else {"scale": SCALES}

    def score(trial: Any) -> float:
        draw, own = suggested(trial), config.agent.kwargs
        kwargs, base = (drawn(x, own, draw) if trial.number else {} for x in (ranges, scales))
        trial.set_user_attr("parameters", kwargs | base)

        def judge(policy: Policy) -> float:
            means = judged(config, policy, episodes, seed)
            trial.set_user_attr("score", means["score"])
            return means["objective"]

        def poor(policy: Policy, rung: int) -> bool:
            trial.report(judge(policy), rung)
            return bool(trial.should_prune())

        policy = trained(changed(plain, kwargs, base), poor)
        if policy is None:
            from optuna import TrialPruned

            raise TrialPruned
        return judge(policy)

    study = searched(score, trials, reduction=REDUCTION)
    best = study.best_trial.user_attrs
    return {
        "parameters": best["parameters"],
        "score": best["score"],
        "untuned": study.trials[0].user_attrs["score"],
        "trials": len(study.trials),
        "episodes": episodes,
        "steps": config.total_steps,
    }


def ranges_of(config: Config) -> dict[str, Any]:
    """The ranges of an experiment, or those of DEFAULTS that its algorithm has."""
    known = settings(config.agent.name)
    return config.sweep or {key: table for key, table in DEFAULTS.items() if key in known}


def changed(config: Config, kwargs: dict[str, Any], base: dict[str, Any]) -> Config:
    """An experiment with other keywords of the learner and fields of the base."""
    data = config.to_dict()
    data["agent"]["kwargs"] |= kwargs
    if base:
        data["base"] |= base
    return config_from_dict(data)


def trained(config: Config, poor: Callable[[Policy, int], bool]) -> Policy | None:
    """The policy after a training; None if `poor`, asked at a rung, has ended it."""
    from stable_baselines3.common.callbacks import BaseCallback

    model = build_model(config)

    def policy() -> Policy:
        return export_policy(model, about_policy(config) | {"steps": model.num_timesteps})

    class Halving(BaseCallback):
        rungs, ended = list(RUNGS), False

        def _on_rollout_start(self) -> None:  # between updates: the policy is consistent here
            if self.rungs and NINTHS * self.num_timesteps >= self.rungs[0] * config.total_steps:
                self.ended = poor(policy(), self.rungs.pop(0))

        def _on_step(self) -> bool:
            return not self.ended

    halving = Halving()
    try:
        model.learn(config.total_steps, halving, log_interval=None)
        return None if halving.ended else policy()
    finally:
        model.env.close()


def judged(config: Config, policy: Policy, episodes: int, seed: int = SEED) -> dict[str, float]:
    """Mean score, success rate and objective of a policy on tuning episodes."""
    envs = make_batch(config.env.id, episodes, config.env.kwargs)
    try:
        seeds = range(seed, seed + episodes)
        metrics = episode_metrics(record(acting(policy, envs), envs, seeds))
        reach = float(envs.unwrapped.reach)
    finally:
        envs.close()
    means = {name: float(np.mean(metrics[name])) for name in ("score", "success")}
    return means | {"objective": objective(metrics, reach)}
