"""Training from an experiment file: logged, resumable, evaluated at the end."""

import argparse
import shlex
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.comparison import beginning, compare, titled
from agents.config import BaseConfig, Config, ConfigError, EnvConfig, check_steps, load_config
from agents.controllers import controller, joint_pd, tune_pd
from agents.environments import REFUSALS
from agents.experiments import find_experiment, shipped_experiments
from agents.figures import plot_learning_curve
from agents.files import FolderError, write_json
from agents.hybrid.controller import EXPERT, KEY, acting, base_of, description
from agents.hybrid.informed import is_told
from agents.leaderboard.bound import best_of
from agents.leaderboard.shipped import named_policy
from agents.leaderboard.tracks import TRACKS, keywords, takes_part, track_of
from agents.learners.algorithms import (
    DIFFERENTIATED,
    DISTILLED,
    ON_TENSORS,
    algorithms,
    learner_kwargs,
)
from agents.learners.divergence import TrainingError, divergence_told, refuse_divergence
from agents.learners.export import begin_with, export_policy
from agents.learners.limits import LIMITS
from agents.learners.normalization import normalized
from agents.metrics import make_batch
from agents.policy import Controller, Policy, PolicyError, load_policy, save_policy
from agents.run_folder.callback import Progress, make_callback, silent_disk_errors
from agents.run_folder.checkpoints import CheckpointError, newest_intact, restore_checkpoint
from agents.run_folder.folder import (
    ARM,
    FINISHED,
    RunFolder,
    arm_digest,
    check_out,
    new_run,
    refuse_used,
    versions,
)
from agents.run_folder.lock import folder_lock
from agents.sentences import one_line, refused, speaker
from agents.signals import Interrupted, StopLater, signals_to, stop_at_once
from agents.tuned import parameters_of
from dynamics.description import validate
from dynamics.description.data_file import user_path

BESIDE = ("pd-zv", "lqr", "lqg")  # tuned controllers that a policy is compared with
SESSION_STRIDE = 1_000_003  # seed increment per resumed session
DEFAULT = "one_link_reach_ppo"  # experiment without --config


def build_model(config: Config) -> Any:
    """The model of the experiment on its batch environment."""
    import torch

    from agents.learners.privileged import PrivilegedCriticPolicy

    torch.set_num_threads(1)  # faster for small networks, and leaves the other cores free
    try:
        env = _tensors(config) if config.agent.name in ON_TENSORS else _arrays(config)
    except ConfigError:
        raise
    except REFUSALS as error:
        keywords = validate.shown(config.env.make_kwargs)
        raise ConfigError(f"env: {config.env.id} refuses {keywords}: {error}") from None
    policy = PrivilegedCriticPolicy if config.env.privileged else config.agent.policy
    try:
        return algorithms()[config.agent.name](
            policy,
            env,
            seed=config.seed,
            device=config.device,
            **learner_kwargs(config.agent.kwargs, env.action_space.shape),
        )
    except ModuleNotFoundError as error:
        raise ConfigError(str(error)) from None
    except REFUSALS as error:
        raise ConfigError(f"agent: {config.agent.name} refuses its keywords: {error}") from None


def _tensors(config: Config) -> Any:
    """The experiment's arms as an algorithm on tensors takes them."""
    from agents.learners.arms import Arms
    from flexarm_env import TorchVecEnv

    env, differentiable = config.env, config.agent.name in DIFFERENTIATED
    envs = TorchVecEnv(env.id, env.n_envs, config.device, differentiable, **env.make_kwargs)
    return Arms(envs, env.stack)


def _arrays(config: Config) -> Any:
    """The experiment's arms as stable-baselines3 takes them."""
    from agents.learners.privileged import stacked
    from flexarm_env import SB3VecEnv

    given = config.env
    env: Any = SB3VecEnv(given.id, given.n_envs, privileged=given.privileged, **given.make_kwargs)
    if config.base is not None:
        from agents.hybrid.environment import HybridVecEnv

        try:
            env = HybridVecEnv(env, base_of(base_description(config.base, config.env), env.envs))
        except REFUSALS as error:
            raise ConfigError(str(error)) from None
    env = normalized(env, config.env.normalize, config.agent.gamma)
    return stacked(env, config.env.stack)


def base_description(base: BaseConfig, env: EnvConfig) -> dict[str, Any]:
    """Description of the controller on which the experiment's policy acts."""
    return description(
        base.controller, base.learned, base.scale, env.id, env.kwargs, base.parameters
    )


def prepare(config: Config, warm: bool = False) -> None:
    """Build the experiment, if asked with its warm start, and take one step.

    A bad experiment fails here, before files are made.
    """
    begin = time.monotonic()
    print(f"Preparing {config.env.id} (an arm is compiled at its first use and cached) ...")
    model = build_model(config)
    export_policy(model, {"stack": config.env.stack})
    if warm:
        begin_warm(model, config)
    env = model.env
    env.reset()
    env.step(np.zeros((config.env.n_envs, *env.action_space.shape), np.float32))
    env.close()
    print(f"Ready after {time.monotonic() - begin:.1f} s.", flush=True)


def begin_warm(model: Any, config: Config) -> None:
    """Give a new model the weights of its experiment's warm start, if there is one."""
    if config.agent.warm_start:
        first = named_policy(config.agent.warm_start, config.seed)
        begin_with(model, first, about_policy(config))


def learn(run: RunFolder, config: Config) -> int:
    """Train from the newest intact checkpoint, or from the beginning, and save the policy.

    Returns the number of steps of the trained policy. Nothing is written before the model has all
    that it goes on from.
    """
    model = build_model(config)
    about = about_policy(config)
    first = begin(run, config, model, about)
    progress = restore_newest(run, config, model)
    run.write_config(config)
    run.write_versions({"seed": config.seed})
    for sentence in run.repair_log():
        print(sentence)
    if first is not None:
        save_policy(first, run.untrained)
    if model.num_timesteps < config.total_steps:
        run_session(run, config, model, progress)
    refuse_divergence(model)
    save_policy(export_policy(model, about | {"steps": model.num_timesteps}), run.policy)
    model.env.close()
    return int(model.num_timesteps)


def about_policy(config: Config) -> dict[str, Any]:
    """Origin of a policy, which is stored beside its weights."""
    about: dict[str, Any] = {"env_id": config.env.id, "env_kwargs": config.env.kwargs}
    about |= {"stack": config.env.stack, "config": config.name, "seed": config.seed}
    about["versions"] = versions()["packages"]
    if (arm := arm_digest(config.env.kwargs)) is not None:
        about[ARM] = arm
    if config.agent.warm_start:
        about["warm_start"] = config.agent.warm_start
    if config.base is not None:
        key = EXPERT if config.base.learned == DISTILLED else KEY
        about[key] = base_description(config.base, config.env)
    return about


def begin(run: RunFolder, config: Config, model: Any, about: dict[str, Any]) -> Policy | None:
    """Let the model begin as the run did; returns its network if the run does not have it yet."""
    try:
        first = load_policy(run.untrained)
    except PolicyError:
        begin_warm(model, config)
        return export_policy(model, about | {"steps": 0})
    if config.agent.warm_start:
        begin_with(model, first, about)
    return None


def restore_newest(run: RunFolder, config: Config, model: Any) -> dict[str, Any]:
    """Restore the newest intact checkpoint into the model; returns the run's progress."""
    checkpoint, flaws = newest_intact(run.checkpoints)
    for flaw in flaws:
        print(f"Skipped {flaw}")
    if checkpoint is not None:
        progress = restore_checkpoint(model, checkpoint)
        print(f"Resuming at {model.num_timesteps:,} of {config.total_steps:,} steps.")
        return progress
    if flaws or run.rows():
        print("No checkpoint is intact: starting from the beginning.")
    return {"session": -1, "seconds": 0.0}


def run_session(run: RunFolder, config: Config, model: Any, progress: dict[str, Any]) -> None:
    """Train to the last step in a new session, with its own seeds.

    A signal ends the session after the current update, with a checkpoint.
    """
    from stable_baselines3.common.logger import configure

    session = 1 + max([progress["session"], *(row["session"] for row in run.rows())])
    if session > 0:
        model.set_random_seed((config.seed + SESSION_STRIDE * session) % 2**32)
        model._last_obs = None  # start episodes with these seeds
    remaining, fresh = config.total_steps - model.num_timesteps, progress["session"] < 0
    stop = StopLater()
    with (
        signals_to(stop),
        silent_disk_errors(),
        closing(Progress(config.total_steps, model.num_timesteps)) as bar,
    ):
        model.set_logger(configure(str(run.path / "tensorboard"), ["tensorboard"]))
        callback = make_callback(run, config, session, progress, bar, stop)
        with divergence_told(model):
            model.learn(remaining, callback, log_interval=None, reset_num_timesteps=fresh)
        model.logger.close()
    stop.now()


def judge(run: RunFolder, config: Config) -> None:
    """Compare the policy with the best joint PD and the untrained network; draw the pictures."""
    env_id, kwargs = config.env.id, config.env.kwargs
    title = f"{config.agent.name}, seed {config.seed}, on {titled(env_id, kwargs)}"
    plot_learning_curve(run.path / "learning_curve.png", {config.name: run.curve()}, title)
    run.write_curve()
    print("Searching the gains of the joint PD controller ...", flush=True)
    tuned = tune_pd(env_id, kwargs)
    write_json(run.path / "pd_gains.json", tuned.__dict__)
    env = make_batch(env_id, 1, kwargs)
    pd = joint_pd(env, tuned.frequency_ratio, tuned.damping_ratio)
    trained, untrained = (acting(load_policy(x), env) for x in (run.policy, run.untrained))
    controllers: dict[str, Controller] = {"trained policy": trained, "joint PD": pd}
    controllers[beginning(config)] = untrained
    track = track_of(config.agent.name, env_id, kwargs)
    episodes, seed = config.evaluation.episodes, config.evaluation.seed
    best = None
    if track is not None:
        controllers |= classical(env, env_id, track)
        best = best_of(env_id, track, range(seed, seed + episodes))
    base = config.base
    if base is not None and base.learned == DISTILLED and not is_told(base.controller, env):
        name = base.controller
        about = base_description(base, config.env)
        controllers[name] = controller(name, env, about["parameters"])
    env.close()
    print("Evaluating ...", flush=True)
    compare(controllers, env_id, kwargs, episodes=episodes, seed=seed, folder=run.path, best=best)


def classical(env: Any, env_id: str, track: str) -> dict[str, Controller]:
    """Tuned controllers of BESIDE that can act on the observation that a policy has on a track."""
    obs = TRACKS[track].obs[0]
    fit = (x for x in BESIDE if takes_part(x, env_id, track) and keywords(x, track)["obs"] == obs)
    return {name: controller(name, env, parameters_of(name, env_id, track)) for name in fit}


def train(run: RunFolder, config: Config) -> None:
    """Run the experiment in an existing run folder: train, evaluate, record."""
    begin = time.monotonic()
    steps = learn(run, config)
    run.refuse_other_arm(config.env.kwargs)
    judge(run, config)
    seconds = round(time.monotonic() - begin, 1)
    run.write_versions({"seed": config.seed, "seconds": seconds, FINISHED: steps})
    print(f"Done in {seconds:.0f} s. Everything is in {run.path}/")


def start(out: Path | None, config: Config) -> RunFolder:
    """Create the folder of a new run, after the experiment was built successfully."""
    check_out(out)
    prepare(config, warm=True)
    return new_run(out, config)


def resume(run: RunFolder, steps: int | None, prog: str) -> None:
    """Continue a run, unless it is finished; `prog` is the command that is running."""
    run.refuse_links()
    config = with_overrides(run.read_config(), None, steps)
    run.refuse_other_arm(config.env.kwargs)
    finished = run.finished_at()
    if finished is not None and finished >= config.total_steps:
        print(
            f"{run.path} is finished at {finished:,} steps; to continue, give it more: "
            f"{resume_command(run, prog)} --steps {2 * finished}"
        )
        return
    prepare(config)
    train(run, config)


def resume_command(run: RunFolder, prog: str) -> str:
    """Command that resumes the run."""
    return f"{prog} --resume {shlex.quote(str(run.path))}"


def main(arguments: list[str] | None = None, prog: str = "python train.py") -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=prog, description="Train a policy and compare it with joint PD."
    )
    experiment = parser.add_mutually_exclusive_group()
    shipped = f"an experiment file, or one of {', '.join(shipped_experiments())}"
    experiment.add_argument("experiment", nargs="?", metavar="EXPERIMENT", help=shipped)
    experiment.add_argument("--config", metavar="EXPERIMENT", help=f"the same (default: {DEFAULT})")
    parser.add_argument("--seed", type=int, help="replaces the experiment's seed")
    parser.add_argument("--steps", type=int, help="replaces the experiment's total_steps")
    parser.add_argument("--out", type=user_path, help="folder of the run (runs/NAME/seedN)")
    parser.add_argument("--resume", type=user_path, metavar="RUN", help="continue the run in RUN")
    a = parser.parse_args(arguments)
    run = None if a.resume is None else RunFolder(a.resume)
    named = a.config or a.experiment
    try:
        with signals_to(stop_at_once):
            if run is None:
                config = with_overrides(
                    load_config(find_experiment(named or DEFAULT)), a.seed, a.steps
                )
                run = start(a.out, config)
                with folder_lock(run.path):
                    refuse_used(run.path)
                    print(f"Run folder: {run.path}", flush=True)
                    train(run, config)
            elif named or a.out or a.seed is not None:
                raise ConfigError("--resume allows only --steps: a run keeps its experiment.")
            else:
                run.require()
                with folder_lock(run.path):
                    resume(run, a.steps, prog)
    except (ConfigError, FolderError, PolicyError, CheckpointError) as error:
        return refused(prog, error)
    except TrainingError as error:
        return refused(prog, error, 1)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        reason = error.strerror or one_line(error)
        print(f"{speaker(prog)}: {place}{reason}; {remedy(run, prog)}", file=sys.stderr)
        return 1
    except Interrupted as error:
        print(f"\n{speaker(prog)}: interrupted; {remedy(run, prog)}", file=sys.stderr)
        return error.status
    return 0


def remedy(run: RunFolder | None, prog: str) -> str:
    """Remedy in messages about interrupted work: the command that resumes it."""
    if run is None or not run.config.is_file():
        return "there is no run to resume yet."
    return f"resume with: {resume_command(run, prog)}"


def with_overrides(config: Config, seed: int | None, steps: int | None) -> Config:
    """The experiment with the numbers given on the command line."""
    for name, value in (("seed", seed), ("total_steps", steps)):
        low, high = LIMITS[name]
        if value is not None and not low <= value <= high:
            option = "--seed" if name == "seed" else "--steps"
            raise ConfigError(f"{option} must be between {low:_} and {high:_}, got {value}.")
    if steps is not None:
        check_steps(config.agent, steps)
    seed = config.seed if seed is None else seed
    return replace(config, seed=seed, total_steps=config.total_steps if steps is None else steps)
