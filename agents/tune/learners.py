"""Keywords of an experiment's learner, found on tuning episodes by `agents.tune`."""

import gc
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from agents.config import Config, ConfigError, config_from_dict
from agents.hybrid.controller import acting
from agents.leaderboard.shipped import name_made_by
from agents.leaderboard.tracks import track_of
from agents.learners.algorithms import settings
from agents.learners.divergence import TrainingError, divergence_told
from agents.learners.export import export_policy
from agents.learners.ranges import DEFAULTS, drawn, suggested
from agents.metrics import episode_metrics, make_batch, record
from agents.policy import Policy, PolicyError
from agents.sentences import one_line
from agents.training import about_policy, begin_warm, build_model
from agents.tune.search import EPISODES, SEED, TRIALS, kept_study, objective, searched

REDUCTION = 3  # of so many trials one goes on
RUNGS = (1, 3)  # ninths of the steps after which a trial may end
NINTHS = REDUCTION * RUNGS[-1]
SCALE = "scale"  # field of an experiment's base, among the keywords of the learner
SCALES = {"between": [0.03, 1.0], "log": True}
SCALED = ("residual", "reference")  # parts whose scale is searched; others span all torques
# Errors of keywords that exclude each other, and of a training that diverges
UNUSABLE = (ConfigError, PolicyError, TrainingError)
LOST = {"score": 0.0, "success": 0.0, "objective": -1.0}  # of a training that diverges in the final
FINALISTS, SEEDS = 3, 3  # best trials beside the experiment itself; seeds of each in the final


def place_of(config: Config) -> tuple[str, str, str]:
    """Task, track and name under which an experiment's policies are ranked."""
    env, kwargs = config.env.id, config.env.kwargs
    track = track_of(config.agent.name, env, kwargs)
    if track is None:
        raise ValueError(
            f"{config.name} is not on a track: {env} with {kwargs}; search its keywords by "
            "python -m agents.sweep."
        )
    return env, track, name_made_by(config)


@dataclass(frozen=True)
class Trials:
    """Trainings of an experiment with other keywords, judged on tuning episodes."""

    config: Config
    episodes: int
    seed: int  # of the first tuning episode
    report: Callable[[str], None]

    @cached_property
    def ranges(self) -> dict[str, Any]:
        """Searched keywords of the learner, and the scale of what it adds."""
        base = self.config.base
        scaled = base is not None and base.learned in SCALED
        return ranges_of(self.config) | ({SCALE: SCALES} if scaled else {})

    def judged(self, policy: Policy) -> dict[str, float]:
        """Means of a policy on the tuning episodes."""
        return judged(self.config, policy, self.episodes, self.seed)

    def objective(self, trial: Any) -> float:
        """Objective of a trial; the first one has the experiment's own keywords."""
        from optuna import TrialPruned

        own = self.config.agent.kwargs
        found = {} if trial.user_attrs else drawn(self.ranges, own, suggested(trial))
        trial.set_user_attr("parameters", found)

        def poor(policy: Policy, rung: int) -> bool:
            trial.report(self.judged(policy)["objective"], rung)
            return bool(trial.should_prune())

        try:
            policy = trained(changed(self.config, found), poor)
            means = None if policy is None else self.judged(policy)
        except UNUSABLE as error:
            if not found:
                raise
            self.report(one_line(error))
            means = None
        if means is None:
            raise TrialPruned
        trial.set_user_attr("means", means)
        return means["objective"]

    def final(self, study: Any, trial: Any) -> dict[str, float]:
        """Means over the seeds of a trial that is in the final."""
        own = changed(self.config, trial.user_attrs["parameters"])
        means = [trial.user_attrs["means"]]
        for k in range(self.config.seed + 1, self.config.seed + SEEDS):
            key = f"trial {trial.number}, seed {k}"
            if key not in study.user_attrs:
                study.set_user_attr(key, self.finally_judged(replace(own, seed=k)))
            means.append(study.user_attrs[key])
            self.report(f"final, {key}: objective {means[-1]['objective']:.4f}")
        return {name: float(np.mean([x[name] for x in means])) for name in means[0]}

    def finally_judged(self, own: Config) -> dict[str, float]:
        """Means of one more seed of a trial; LOST where its training diverges."""
        try:
            policy = trained(own)
            assert policy is not None
            return self.judged(policy)
        except UNUSABLE as error:
            self.report(one_line(error))
            return LOST


def tune_experiment(
    config: Config,
    *,
    trials: int = TRIALS,
    episodes: int = EPISODES,
    seed: int = SEED,
    keep: Path | None = None,
    report: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Best keywords of an experiment's learner, their mean score, and that of its own.

    With a folder `keep`, a search that was interrupted goes on. `report` is told of each training.
    A trial that diverges, or whose keywords exclude each other, is ended early.
    """
    search = Trials(config, episodes, seed, report)

    def ended(count: int, value: float | None) -> None:
        what = "ended early" if value is None else f"objective {value:.4f}"
        report(f"trial {count} of {trials}: {what}")

    about = {
        "experiment": replace(config, sweep=search.ranges).to_dict(),
        "seeds": [seed, episodes],
    }
    with kept_study(keep, about) as study:
        done = searched(study, search.objective, trials, [{}], REDUCTION, ended)
        whole = [trial for trial in done if "means" in trial.user_attrs]
        first = next(trial for trial in whole if not trial.user_attrs["parameters"])
        others = sorted((t for t in whole if t is not first), key=lambda trial: -trial.value)
        finalists = {trial.number: trial for trial in (first, *others[:FINALISTS])}
        means = {number: search.final(study, trial) for number, trial in finalists.items()}
    best = max(means, key=lambda number: means[number]["objective"])
    return {
        "parameters": finalists[best].user_attrs["parameters"],
        "score": means[best]["score"],
        "untuned": means[first.number]["score"],
        "trials": len(done),
        "episodes": episodes,
        "seeds": SEEDS,
        "steps": config.total_steps,
    }


def ranges_of(config: Config) -> dict[str, Any]:
    """The ranges of an experiment, or those of DEFAULTS that its algorithm has."""
    known = settings(config.agent.name)
    return config.sweep or {key: table for key, table in DEFAULTS.items() if key in known}


def changed(config: Config, found: dict[str, Any]) -> Config:
    """An experiment with other keywords of the learner, or another scale of what it adds."""
    data = replace(config, sweep={}).to_dict()
    data["agent"]["kwargs"] |= {key: value for key, value in found.items() if key != SCALE}
    if SCALE in found:
        data["base"][SCALE] = found[SCALE]
    return config_from_dict(data)


def trained(
    config: Config, poor: Callable[[Policy, int], bool] = lambda policy, rung: False
) -> Policy | None:
    """The policy after a training; None if `poor`, asked at a rung, has ended it.

    Raises
    ------
    TrainingError : if it diverges.
    """
    from stable_baselines3.common.callbacks import BaseCallback

    gc.collect()  # a learner and its environments form a cycle: those of the last training go first
    model = build_model(config)
    begin_warm(model, config)

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
    with closing(model.env):
        with divergence_told(model):
            model.learn(config.total_steps, halving, log_interval=None)
        return None if halving.ended else policy()


def judged(config: Config, policy: Policy, episodes: int, seed: int = SEED) -> dict[str, float]:
    """Mean score, success rate and objective of a policy on tuning episodes."""
    with closing(make_batch(config.env.id, episodes, config.env.kwargs)) as envs:
        seeds = range(seed, seed + episodes)
        metrics = episode_metrics(record(acting(policy, envs), envs, seeds))
        reach = float(envs.unwrapped.reach)
    means = {name: float(np.mean(metrics[name])) for name in ("score", "success")}
    return means | {"objective": objective(metrics, reach)}
