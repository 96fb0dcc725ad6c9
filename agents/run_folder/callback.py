"""Callback of the training that logs, shows progress, writes checkpoints and stops on signals."""

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from agents.config import Config
from agents.run_folder.checkpoints import save_checkpoint
from agents.run_folder.folder import RunFolder
from agents.signals import StopLater
from dynamics.extras import missing
from dynamics.types import AnyArray

try:
    from rich.console import Console
except ModuleNotFoundError as error:
    raise missing(error, "agents", "train") from None

CHECKPOINT_SHARE = 0.05  # largest share of the training time that goes into checkpoints
ROWS = 250  # approximate number of rows in the log of a run


class EpisodeStatistics:
    """Means over the latest episodes of a batch."""

    def __init__(self, n_env: int, before: int = 0) -> None:
        self.running = np.zeros(n_env)  # returns of the current episodes
        self.episodes = before  # ended ones, those of earlier sessions included
        self.latest: deque[tuple[float, float, float, float]] = deque(maxlen=max(100, n_env))

    def add(self, rewards: AnyArray, dones: AnyArray, infos: Any) -> None:
        """Add the results of one step of the batch."""
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
        """Mean return, mean final tip error [m], share settled at the end, share failed."""
        names = ("return", "tip_error", "settled", "failed")
        if not self.latest:
            return dict.fromkeys(names)
        return dict(zip(names, np.mean(self.latest, axis=0).tolist(), strict=True))


def make_callback(
    run: RunFolder,
    config: Config,
    session: int,
    before: Mapping[str, Any],
    bar: "Progress",
    stop: StopLater,
) -> Any:
    """stable-baselines3 callback that logs, shows progress, writes checkpoints and stops.

    `before` is the progress of the checkpoint from which the session goes on.
    """
    from stable_baselines3.common.callbacks import BaseCallback

    class RunCallback(BaseCallback):
        def _on_training_start(self) -> None:
            self.statistics = EpisodeStatistics(config.env.n_envs, before.get("episodes", 0))
            self.started = self.checkpointed = time.monotonic()
            self.first_step = self.logged = self.num_timesteps
            self.checkpoint_cost = 0.0

        def _on_step(self) -> bool:
            s, normalized = self.locals, self.model.get_vec_normalize_env()
            rewards = normalized.get_original_reward() if normalized else s["rewards"]
            self.statistics.add(rewards, s["dones"], s["infos"])
            return True

        def _on_rollout_end(self) -> None:
            if self.num_timesteps - self.logged >= config.total_steps / ROWS:
                self.log_row()

        def _on_rollout_start(self) -> None:  # between updates: the state is consistent here
            if stop.number is not None:
                self.settle()
                stop.now()
            now = time.monotonic()
            pause = max(config.checkpoint_seconds, self.checkpoint_cost / CHECKPOINT_SHARE)
            if self.num_timesteps > self.first_step and now - self.checkpointed > pause:
                self.checkpoint()

        def _on_training_end(self) -> None:
            self.settle()

        def settle(self) -> None:
            if self.num_timesteps > self.logged:
                self.log_row()
            self.checkpoint()

        def seconds(self) -> float:
            return float(before["seconds"]) + time.monotonic() - self.started

        def checkpoint(self) -> None:
            begin = time.monotonic()
            progress = {
                "session": session,
                "seconds": self.seconds(),
                "episodes": self.statistics.episodes,
            }
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
            bar.update(self.num_timesteps, speed, means)

    return RunCallback()


class Progress:
    """Progress bar on a terminal, or about ten plain lines without one."""

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
        """Show the progress of the training."""
        note = f"{steps:,} steps, {speed:,.0f} per s"
        if means["return"] is not None and means["settled"] is not None:
            note += f", return {means['return']:.2f}, on target {100 * means['settled']:.0f} %"
        self.bar.update(self.task, completed=min(steps, self.total), note=note)
        if not self.console.is_terminal and steps >= min(self.next_line, self.total):
            share = min(1.0, steps / self.total)
            print(f"training: {100 * share:3.0f} %, {note}", flush=True)
            self.next_line = steps + self.total // 10

    def close(self) -> None:
        """Remove the bar and restore the terminal."""
        self.bar.stop()


@contextmanager
def silent_disk_errors() -> Iterator[None]:
    """Silence OSErrors in TensorBoard's thread; TensorBoard's next call raises them again."""
    before = threading.excepthook

    def report(arguments: threading.ExceptHookArgs) -> None:
        if not isinstance(arguments.exc_value, OSError):
            before(arguments)

    threading.excepthook = report
    try:
        yield
    finally:
        threading.excepthook = before
