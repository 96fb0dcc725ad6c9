"""Runs of an experiment's training seeds: trained once, recorded in the test episodes."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

from agents.config import Config
from agents.hybrid.controller import acting
from agents.metrics import Recording, make_batch, record
from agents.policy import load_policy
from agents.run_folder.folder import RunFolder
from agents.run_folder.lock import folder_lock
from agents.training import learn


def run_seed(config: Config, work: Path, seed: int) -> tuple[RunFolder, float]:
    """Train one seed in a folder; returns its run and the training time [s].

    A run that was stopped continues, a finished one stays as it is.
    """
    config, run = replace(config, seed=seed), RunFolder(work / f"seed{seed}")
    run.path.mkdir(parents=True, exist_ok=True)
    with folder_lock(run.path):
        if run.config.exists() and run.read_config() != config:
            raise SystemExit(
                f"{run.path} holds a run of another experiment; remove it, or keep runs elsewhere."
            )
        run.write_config(config)
        learn(run, config)
    return run, run.curve()[-1]["seconds"]


def episode_seeds(config: Config) -> range:
    """Seeds of the test episodes."""
    first = config.evaluation.seed
    return range(first, first + config.evaluation.episodes)


def recorded(config: Config, policy: Path) -> Recording:
    """Test episodes of a stored policy."""
    seeds = episode_seeds(config)
    with closing(make_batch(config.env.id, len(seeds), config.env.kwargs)) as envs:
        return record(acting(load_policy(policy), envs), envs, seeds)
