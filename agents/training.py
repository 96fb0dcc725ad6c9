"""Training from an experiment file: PPO or SAC, logged, resumable, judged at the end."""

import argparse
import shlex
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.comparison import compare
from agents.config import AGENT_KWARGS, LIMITS, SCHEDULE, Config, ConfigError, load_config
from agents.controllers import joint_pd, tune_pd
from agents.environments import REFUSALS
from agents.figures import plot_learning_curve
from agents.files import FolderError, alone_in
from agents.metrics import make_batch, write_json
from agents.policy import Controller, PolicyError, export_policy, load_policy, save_policy
from agents.run_folder.checkpoints import CheckpointError, newest_whole, restore_checkpoint
from agents.run_folder.folder import FINISHED, RunFolder, check_out, new_run, refuse_used, versions
from agents.run_folder.keeper import Progress, errors_in_the_main_thread, make_keeper
from agents.sentences import one_line
from agents.signals import Interrupted, StopLater, signals_to, stop_at_once
from dynamics.description import validate

SESSION_STRIDE = 1_000_003  # seeds of a resumed session are new, not those of the first one
DEFAULT_CONFIG = Path(__file__).resolve().parents[1] / "configs" / "one_link_reach_ppo.yaml"


class TrainingError(ValueError):
    """A training that cannot go on; the message is one sentence for the user."""


def build_model(config: Config) -> Any:
    """The stable-baselines3 model of the experiment on its batch environment."""
    import torch
    from stable_baselines3 import PPO, SAC

    from flexarm_env import SB3VecEnv

    torch.set_num_threads(1)  # a small network is faster, and leaves the other core alone
    activations = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU, "elu": torch.nn.ELU}
    kwargs = dict(config.agent.kwargs)
    policy_kwargs = dict(kwargs.pop("policy_kwargs", {}))
    if "activation_fn" in policy_kwargs:
        policy_kwargs["activation_fn"] = activations[policy_kwargs["activation_fn"]]
    for key, types in AGENT_KWARGS[config.agent.name].items():
        value = kwargs.get(key)
        if types == SCHEDULE and isinstance(value, str):
            kwargs[key] = falling(float(value.removeprefix("lin_")))
    try:
        env = SB3VecEnv(config.env.id, config.env.n_envs, **config.env.make_kwargs)
    except REFUSALS as error:
        keywords = validate.shown(config.env.make_kwargs)
        raise ConfigError(f"env: {config.env.id} refuses {keywords}: {error}") from None
    try:
        algorithm = {"ppo": PPO, "sac": SAC}[config.agent.name]
        return algorithm(
            config.agent.policy,
            env,
            policy_kwargs=policy_kwargs,
            seed=config.seed,
            device="cpu",
            **kwargs,
        )
    except REFUSALS as error:
        raise ConfigError(f"agent: {config.agent.name} refuses its keywords: {error}") from None


def prepare(config: Config) -> None:
    """Build the whole experiment and take one step, so that nothing is made for one that fails."""
    begin = time.monotonic()
    print(f"Preparing {config.env.id} (an arm is compiled at its first use, then cached) ...")
    env = build_model(config).env
    env.reset()
    env.step(np.zeros((config.env.n_envs, *env.action_space.shape), np.float32))
    env.close()
    print(f"Ready after {time.monotonic() - begin:.1f} s.", flush=True)


def falling(start: float) -> Any:
    """A schedule from `start` to zero; called with the share of the run that remains."""
    return lambda remaining: start * remaining


def learn(run: RunFolder, config: Config) -> int:
    """Train from the newest whole checkpoint, or from the start; leaves the policy.

    Returns the steps that the policy has been trained for.
    """
    for sentence in run.mend_log():
        print(sentence)
    model = build_model(config)
    about: dict[str, Any] = {"env_id": config.env.id, "env_kwargs": config.env.make_kwargs}
    about |= {"config": config.name, "seed": config.seed, "versions": versions()["packages"]}
    keep_untrained(run, model, about)
    progress = restore_newest(run, config, model)
    if model.num_timesteps < config.total_steps:
        hold_session(run, config, model, progress)
    save_policy(export_policy(model, about | {"steps": model.num_timesteps}), run.policy)
    model.env.close()
    return int(model.num_timesteps)


def keep_untrained(run: RunFolder, model: Any, about: dict[str, Any]) -> None:
    """Store the network as it was before its first update, unless the run holds it already."""
    try:
        load_policy(run.untrained)
    except PolicyError:
        save_policy(export_policy(model, about | {"steps": 0}), run.untrained)


def restore_newest(run: RunFolder, config: Config, model: Any) -> dict[str, Any]:
    """Put the newest whole checkpoint into the model; returns how far the run has come."""
    checkpoint, flaws = newest_whole(run.checkpoints)
    for flaw in flaws:
        print(f"Passed over {flaw}")
    if checkpoint is not None:
        progress = restore_checkpoint(model, checkpoint)
        print(f"Resuming at {model.num_timesteps:,} of {config.total_steps:,} steps.")
        return progress
    if flaws or run.rows():
        print("No checkpoint is whole: starting from the beginning.")
    return {"session": -1, "seconds": 0.0}


def hold_session(run: RunFolder, config: Config, model: Any, progress: dict[str, Any]) -> None:
    """Train to the end in a session with seeds of its own.

    A signal ends it at the next checkpoint, which is written at once.
    """
    from stable_baselines3.common.logger import configure

    session = 1 + max([progress["session"], *(row["session"] for row in run.rows())])
    if session > 0:
        model.set_random_seed((config.seed + SESSION_STRIDE * session) % 2**32)
    remaining, fresh = config.total_steps - model.num_timesteps, progress["session"] < 0
    stop = StopLater()
    with (
        signals_to(stop),
        errors_in_the_main_thread(),
        closing(Progress(config.total_steps, model.num_timesteps)) as bar,
    ):
        model.set_logger(configure(str(run.path / "tensorboard"), ["tensorboard"]))
        keeper = make_keeper(run, config, session, progress["seconds"], bar, stop)
        try:
            model.learn(remaining, keeper, log_interval=None, reset_num_timesteps=fresh)
        except ValueError:
            refuse_divergence(model)
            raise
        model.logger.close()
    stop.now()


def refuse_divergence(model: Any) -> None:
    """Say so if numbers of the network are no longer finite; torch refuses those in many ways."""
    if not all(parameter.isfinite().all() for parameter in model.policy.parameters()):
        raise TrainingError(
            "the training has diverged: weights of the network are not finite; start anew with a "
            "smaller agent.kwargs.learning_rate."
        ) from None


def judge(run: RunFolder, config: Config) -> None:
    """Compare the policy with the best joint PD and with the untrained network; draw everything."""
    plot_learning_curve(run.path / "learning_curve.png", {config.name: run.curve()})
    run.write_curve()
    env_id, kwargs = config.env.id, config.env.make_kwargs
    print("Searching the gains of the joint PD controller ...", flush=True)
    tuned = tune_pd(env_id, kwargs)
    write_json(run.path / "pd_gains.json", tuned.__dict__)
    env = make_batch(env_id, 1, kwargs)
    pd = joint_pd(env, tuned.frequency_ratio, tuned.damping_ratio)
    env.close()
    controllers: dict[str, Controller] = {"trained policy": load_policy(run.policy), "joint PD": pd}
    controllers["untrained policy"] = load_policy(run.untrained)
    print("Evaluating ...", flush=True)
    episodes, seed = config.evaluation.episodes, config.evaluation.seed
    compare(controllers, env_id, kwargs, episodes=episodes, seed=seed, folder=run.path)


def train(run: RunFolder, config: Config) -> None:
    """The whole experiment in an existing run folder: learn, judge, leave the record."""
    begin = time.monotonic()
    run.write_config(config)
    run.write_versions({"seed": config.seed})
    steps = learn(run, config)
    judge(run, config)
    seconds = round(time.monotonic() - begin, 1)
    run.write_versions({"seed": config.seed, "seconds": seconds, FINISHED: steps})
    print(f"Done in {seconds:.0f} s. Everything is in {run.path}/")


def start(out: Path | None, config: Config) -> RunFolder:
    """The folder of a new run, made once all that the run needs has been built."""
    check_out(out)
    prepare(config)
    return new_run(out, config)


def resume(run: RunFolder, steps: int | None) -> None:
    """Go on with a run, if there is anything left to do."""
    run.refuse_links()
    config = with_overrides(run.read_config(), None, steps)
    finished = run.finished_at()
    if finished is not None and finished >= config.total_steps:
        print(
            f"{run.path} is finished at {finished:,} steps; to go on, give it more: "
            f"{resume_command(run)} --steps {2 * finished}"
        )
        return
    prepare(config)
    train(run, config)


def resume_command(run: RunFolder) -> str:
    """The command that goes on with the run."""
    return f"python train.py --resume {shlex.quote(str(run.path))}"


def main(arguments: list[str] | None = None) -> int:
    """Command line of `train.py`."""
    parser = argparse.ArgumentParser(description="Train a policy and compare it with joint PD.")
    parser.add_argument("--config", type=Path, help=f"experiment file ({DEFAULT_CONFIG.name})")
    parser.add_argument("--seed", type=int, help="instead of the experiment's seed")
    parser.add_argument("--steps", type=int, help="instead of the experiment's total_steps")
    parser.add_argument("--out", type=Path, help="folder of the run (runs/NAME/seedN)")
    parser.add_argument("--resume", type=Path, metavar="RUN", help="continue this run")
    a = parser.parse_args(arguments)
    run = None if a.resume is None else RunFolder(a.resume)
    try:
        with signals_to(stop_at_once):
            if run is None:
                config = with_overrides(load_config(a.config or DEFAULT_CONFIG), a.seed, a.steps)
                run = start(a.out, config)
                with alone_in(run.path):
                    refuse_used(run.path)
                    print(f"Run folder: {run.path}", flush=True)
                    train(run, config)
            elif a.config or a.out or a.seed is not None:
                raise ConfigError("--resume goes with --steps only: a run keeps its experiment.")
            else:
                run.require()
                with alone_in(run.path):
                    resume(run, a.steps)
    except (ConfigError, FolderError, PolicyError, CheckpointError) as error:
        print(f"train.py: {one_line(error)}", file=sys.stderr)
        return 2
    except TrainingError as error:
        print(f"train.py: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        reason = error.strerror or one_line(error)
        print(f"train.py: {place}{reason}; {go_on(run)}", file=sys.stderr)
        return 1
    except Interrupted as error:
        print(f"\ntrain.py: interrupted; {go_on(run)}", file=sys.stderr)
        return error.status
    return 0


def go_on(run: RunFolder | None) -> str:
    """The end of a sentence about work that was cut short."""
    if run is None or not run.config.is_file():
        return "there is no run to go on with yet."
    return f"go on with: {resume_command(run)}"


def with_overrides(config: Config, seed: int | None, steps: int | None) -> Config:
    """The experiment with the numbers given on the command line."""
    for name, value in (("seed", seed), ("total_steps", steps)):
        low, high = LIMITS[name]
        if value is not None and not low <= value <= high:
            option = "--seed" if name == "seed" else "--steps"
            raise ConfigError(f"{option} must be between {low:_} and {high:_}, got {value}.")
    seed = config.seed if seed is None else seed
    return replace(config, seed=seed, total_steps=config.total_steps if steps is None else steps)
