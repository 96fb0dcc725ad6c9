"""Training from an experiment file: PPO or SAC, logged, resumable, judged at the end."""

import argparse
import sys
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console

from agents.checkpoints import (
    CheckpointError,
    list_checkpoints,
    restore_checkpoint,
    save_checkpoint,
)
from agents.config import AGENT_KWARGS, SCHEDULE, Config, ConfigError, load_config
from agents.controllers import joint_pd, tune_pd
from agents.evaluation import make_batch, write_json
from agents.figures import plot_learning_curve
from agents.policy import Array, Controller, PolicyError, export_policy, load_policy, save_policy
from agents.report import compare
from agents.runs import RunFolder, new_run, versions

CHECKPOINT_SHARE = 0.05  # of the training time at most, however long a checkpoint takes
ROWS = 250  # about so many rows in the log of a whole run
SESSION_STRIDE = 1_000_003  # seeds of a resumed session are new, not those of the first one
DEFAULT_CONFIG = Path(__file__).resolve().parents[1] / "configs" / "one_link_reach_ppo.yaml"


def build_model(config: Config, session: int) -> Any:
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
    env = SB3VecEnv(config.env.id, config.env.n_envs, **config.env.make_kwargs)
    algorithm = {"ppo": PPO, "sac": SAC}[config.agent.name]
    return algorithm(
        config.agent.policy,
        env,
        policy_kwargs=policy_kwargs,
        seed=config.seed + SESSION_STRIDE * session,
        device="cpu",
        **kwargs,
    )


def falling(start: float) -> Any:
    """A schedule from `start` to zero; called with the share of the run that remains."""
    return lambda remaining: start * remaining


class EpisodeStatistics:
    """Means over the latest episodes, from what every step of the batch returns."""

    def __init__(self, n_env: int) -> None:
        self.running = np.zeros(n_env)  # return so far
        self.episodes = 0
        self.latest: deque[tuple[float, float, float, float]] = deque(maxlen=max(100, n_env))

    def add(self, rewards: Array, dones: Array, infos: Any) -> None:
        """Account for one step."""
        self.running += rewards
        for i in np.flatnonzero(dones):
            info = infos[i]
            failed = not info.get("TimeLimit.truncated", False)
            self.latest.append(
                (self.running[i], info["tip_error"], bool(info["settled"]) and not failed, failed)
            )
            self.running[i] = 0.0
            self.episodes += 1

    def means(self) -> dict[str, float | None]:
        """Return, final tip error [m], share that ends on target, share that failed."""
        names = ("return", "tip_error", "settled", "failed")
        if not self.latest:
            return dict.fromkeys(names)
        return dict(zip(names, np.mean(self.latest, axis=0).tolist(), strict=True))


def make_callback(run: RunFolder, config: Config, session: int, seconds_before: float) -> Any:
    """The stable-baselines3 callback that logs, shows progress and writes checkpoints."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Keeper(BaseCallback):
        def _on_training_start(self) -> None:
            self.statistics = EpisodeStatistics(config.env.n_envs)
            self.started = self.checkpointed = time.monotonic()
            self.first_step = self.logged = self.num_timesteps
            self.checkpoint_cost = 0.0
            self.bar = Progress(config.total_steps, self.num_timesteps)

        def _on_step(self) -> bool:
            s = self.locals
            self.statistics.add(s["rewards"], s["dones"], s["infos"])
            return True

        def _on_rollout_end(self) -> None:
            if self.num_timesteps - self.logged >= config.total_steps / ROWS:
                self.log_row()

        def _on_rollout_start(self) -> None:  # between updates: the state is consistent here
            now = time.monotonic()
            pause = max(config.checkpoint_seconds, self.checkpoint_cost / CHECKPOINT_SHARE)
            if self.num_timesteps > self.first_step and now - self.checkpointed > pause:
                self.checkpoint()

        def _on_training_end(self) -> None:
            if self.num_timesteps > self.logged:
                self.log_row()
            self.checkpoint()
            self.bar.close()

        def seconds(self) -> float:
            return seconds_before + time.monotonic() - self.started

        def checkpoint(self) -> None:
            begin = time.monotonic()
            progress = {"session": session, "seconds": self.seconds()}
            save_checkpoint(self.model, run.checkpoints, progress)
            self.checkpointed = time.monotonic()
            self.checkpoint_cost = self.checkpointed - begin

        def log_row(self) -> None:
            means = self.statistics.means()
            speed = (self.num_timesteps - self.first_step) / (time.monotonic() - self.started)
            for name, value in means.items():
                if value is not None:
                    self.logger.record(f"rollout/{name}", value)
            self.logger.record("time/steps_per_second", speed)
            row: dict[str, Any] = {
                "session": session,
                "steps": self.num_timesteps,
                "seconds": round(self.seconds(), 3),
                "episodes": self.statistics.episodes,
                "steps_per_second": round(speed, 1),
            }
            values = self.logger.name_to_value
            losses = {k: float(v) for k, v in values.items() if k.startswith("train/")}
            run.append(row | means | losses)
            self.logger.dump(self.num_timesteps)
            self.logged = self.num_timesteps
            self.bar.update(self.num_timesteps, speed, means)

    return Keeper()


class Progress:
    """A bar on a terminal, ten plain lines elsewhere."""

    def __init__(self, total: int, done: int) -> None:
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        self.total, self.next_line = total, done
        self.console = Console()
        columns = ("{task.percentage:>3.0f} %", "{task.fields[note]}")
        self.bar = RichProgress(
            TextColumn("training"),
            BarColumn(),
            *(TextColumn(text) for text in columns),
            TimeRemainingColumn(),
            console=self.console,
            disable=not self.console.is_terminal,
        )
        self.bar.start()
        self.task = self.bar.add_task("training", total=total, completed=done, note="")

    def update(self, steps: int, speed: float, means: dict[str, float | None]) -> None:
        """Show where training stands."""
        note = f"{steps:,} steps, {speed:,.0f} per s"
        if means["return"] is not None and means["settled"] is not None:
            note += f", return {means['return']:.2f}, on target {100 * means['settled']:.0f} %"
        self.bar.update(self.task, completed=min(steps, self.total), note=note)
        if not self.console.is_terminal and steps >= self.next_line:
            print(f"training: {100 * steps / self.total:3.0f} %, {note}", flush=True)
            self.next_line = steps + self.total // 10

    def close(self) -> None:
        """Leave the terminal as it was."""
        self.bar.stop()


def learn(run: RunFolder, config: Config) -> None:
    """Train from the last checkpoint, or from the start if there is none; leaves the policy."""
    from stable_baselines3.common.logger import configure

    rows, found = run.rows(), list_checkpoints(run.checkpoints)
    session = rows[-1]["session"] + 1 if rows else 0
    begin = time.monotonic()
    print(f"Preparing {config.env.id} (an arm is compiled at its first use, then cached) ...")
    model = build_model(config, session)
    print(f"Ready after {time.monotonic() - begin:.1f} s.", flush=True)
    about: dict[str, Any] = {"env_id": config.env.id, "env_kwargs": config.env.make_kwargs}
    about |= {"config": config.name, "seed": config.seed, "versions": versions()["packages"]}
    progress: dict[str, Any] = {"seconds": 0.0}
    if found:
        progress = restore_checkpoint(model, found[-1])
        print(f"Resuming at {model.num_timesteps:,} of {config.total_steps:,} steps.")
    else:
        save_policy(export_policy(model, about | {"steps": 0}), run.untrained)
    model.set_logger(configure(str(run.path / "tensorboard"), ["tensorboard"]))
    remaining = config.total_steps - model.num_timesteps
    if remaining > 0:
        callback = make_callback(run, config, session, progress["seconds"])
        try:
            model.learn(remaining, callback, log_interval=None, reset_num_timesteps=not found)
        except KeyboardInterrupt:
            callback.bar.close()
            raise
    save_policy(export_policy(model, about | {"steps": model.num_timesteps}), run.policy)
    model.env.close()


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
    run.write_versions(seed=config.seed)
    learn(run, config)
    judge(run, config)
    run.write_versions(seed=config.seed, seconds=round(time.monotonic() - begin, 1))
    print(f"Done in {time.monotonic() - begin:.0f} s. Everything is in {run.path}/")


def main(arguments: list[str] | None = None) -> int:
    """Command line of `train.py`."""
    parser = argparse.ArgumentParser(description="Train a policy and compare it with joint PD.")
    parser.add_argument("--config", type=Path, help=f"experiment file ({DEFAULT_CONFIG.name})")
    parser.add_argument("--seed", type=int, help="instead of the experiment's seed")
    parser.add_argument("--steps", type=int, help="instead of the experiment's total_steps")
    parser.add_argument("--out", type=Path, help="folder of the run (runs/NAME/seedN)")
    parser.add_argument("--resume", type=Path, metavar="RUN", help="continue this run")
    a = parser.parse_args(arguments)
    try:
        if a.resume is not None:
            if a.config or a.out or a.seed is not None:
                raise ConfigError("--resume goes with --steps only: a run keeps its experiment.")
            run = RunFolder(a.resume)
            config = run.read_config()
        else:
            config = load_config(a.config or DEFAULT_CONFIG)
        config = with_overrides(config, a.seed, a.steps)
        if a.resume is None:
            run = new_run(a.out, config)
        print(f"Run folder: {run.path}")
        train(run, config)
    except (ConfigError, PolicyError, CheckpointError, gym.error.Error) as error:
        print(f"train.py: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\nInterrupted. Continue with: python train.py --resume {run.path}")
        return 130
    return 0


def with_overrides(config: Config, seed: int | None, steps: int | None) -> Config:
    """The experiment with the numbers given on the command line."""
    if seed is not None and seed < 0:
        raise ConfigError(f"--seed must not be negative, got {seed}.")
    if steps is not None and steps < 1:
        raise ConfigError(f"--steps must be positive, got {steps}.")
    seed = config.seed if seed is None else seed
    return replace(config, seed=seed, total_steps=config.total_steps if steps is None else steps)
