"""Metrics of controllers: episodes recorded in one batch, evaluated, summarised and written."""

import csv
import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from agents.files import atomic_write, write_json
from agents.learners.wrapped import refuse_wrapped
from agents.policy import Controller
from dynamics.types import AnyArray
from flexarm_env import FlexArmVectorEnv
from flexarm_env.task.tasks import SETTLED_BAND

HOLD = 0.25  # [s] least time in the band at the end of a settled episode
RESIDUAL_WINDOW = 1.0  # [s] at the end of the episode
MOST_REGRET = 4.0  # [-]
SATURATED = 0.999  # [-] an action of this magnitude or more is saturated

METRICS = {  # name: (unit, meaning)
    "success": ("-", "settled until the end of the episode"),
    "score": ("-", "0 to 1: share of the episode left after settling; Track: closeness of the RMS"),
    "settling_time": ("s", "tip error below 2 % of the reach from here to the end; inf if never"),
    "tip_error_final": ("m", "tip error at the end"),
    "tip_error_rms": ("m", "root mean square tip error over the episode"),
    "tip_error_max": ("m", "largest tip error"),
    "residual_vibration": ("m", "RMS elastic tip deflection over the last second"),
    "peak_root_curvature": ("1/m", "largest curvature at the root of any link"),
    "effort": ("N^2 m^2 s", "integral of the squared joint torques"),
    "command_variation": ("-", "total variation of the action"),
    "saturated": ("-", "share of the time with a joint at its torque limit"),
}
CAPTION = (
    "Medians over episodes. Success: tip error below 2 % of the reach until the end. "
    "Settling: time from which that holds. Tip error: at the end. "
    "Vibration: RMS elastic tip deflection over the last second."
)
NOTE = (
    "Medians over episodes; an episode that ends early has infinite values in every metric but "
    "success and score. JSON has no infinity: null stands for an infinite value. SI units: "
    + "; ".join(f"{name} [{unit}] {meaning}" for name, (unit, meaning) in METRICS.items())
)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Episodes side by side: T samples of N episodes; NaN after an episode's end."""

    time: AnyArray  # (T,) [s]
    tip_error: AnyArray  # (T, N) [m]
    tip_deflection: AnyArray  # (T, N) [m]
    root_curvature: AnyArray  # (T, N, n_curvature) [1/m]
    torque: AnyArray  # (T, N, n_torque) [N m]; the first sample is zero
    action: AnyArray  # (T, N, n_torque) [-]; the first sample is zero
    failed: AnyArray  # (N,) bool: terminated before the time limit
    reach: float  # [m]
    duration: float  # [s] of an episode that does not fail
    moving: bool  # the target moves


def make_batch(env_id: str, n_env: int, kwargs: Mapping[str, Any] | None = None) -> Any:
    """Batch environment of this package; errors about the id and keywords are not caught.

    Episodes without a time limit are refused: nothing would end their recording.
    """
    envs = gym.make_vec(env_id, num_envs=n_env, **(kwargs or {}))
    if not isinstance(envs.unwrapped, FlexArmVectorEnv):
        envs.close()
        raise ValueError(f"{env_id} is not an environment of flexarm; see flexarm_env.IDS.")
    if not envs.unwrapped.core.max_steps:
        envs.close()
        raise ValueError(
            f"{env_id} has episodes without an end here, which cannot be evaluated; give "
            "max_episode_steps, a number of control steps."
        )
    return envs


def record(
    controller: Controller, envs: Any, seeds: Sequence[int], label: str | None = None
) -> Recording:
    """Run and record one episode per environment of the batch, from the given seeds.

    With a `label`, a terminal shows a bar of progress.
    """
    observation, info = envs.reset(seed=list(seeds))
    n_env = envs.num_envs
    base = envs.unwrapped
    action = np.zeros(envs.action_space.shape)
    samples = {name: [np.array(info[name], float)] for name in ("tip_error", "tip_deflection")}
    samples["root_curvature"] = [np.array(info["root_curvature"], float).reshape(n_env, -1)]
    samples["torque"], samples["action"] = [np.zeros_like(action)], [action]
    running = np.ones(n_env, bool)
    failed = np.zeros(n_env, bool)
    state, start = None, running.copy()
    bar = progress(label, base.core.max_steps)
    while running.any():
        action, state = controller.predict(observation, state, start)
        action = np.clip(np.asarray(action, np.float32), -1.0, 1.0)
        observation, _, terminated, truncated, info = envs.step(action)
        for name, rows in samples.items():
            values = action if name == "action" else info[name]
            row = np.array(values, float).reshape(rows[0].shape)
            row[~running] = np.nan
            rows.append(row)
        start = terminated | truncated
        failed |= running & terminated
        running &= ~start
        bar.update()
    bar.close()
    stacked = {name: np.stack(rows) for name, rows in samples.items()}
    stacked["root_curvature"] = never_empty(stacked["root_curvature"])
    time = base.control_dt * np.arange(len(stacked["action"]))
    core = base.core
    return Recording(
        time=time, failed=failed, reach=float(base.reach), moving=core.task.moving,
        duration=core.max_steps * base.control_dt, **stacked,
    )  # fmt: skip


def evaluated(
    controller: Controller, env_id: str, *, episodes: int = 100, seed: int = 10_000, **kwargs: Any
) -> dict[str, AnyArray]:
    """All METRICS of the episodes seed, seed + 1, ... of an id with the keywords `kwargs`.

    The controller may be any learner's model that has the method `predict`, unless it was trained
    through wrappers of observations or actions that are not here (`refuse_wrapped`).
    """
    refuse_wrapped(controller)
    with closing(make_batch(env_id, episodes, kwargs)) as envs:
        return episode_metrics(record(controller, envs, range(seed, seed + episodes)))


def never_empty(curvature: AnyArray) -> AnyArray:
    """Curvatures (..., links that bend); of a rigid arm one column of zeros."""
    return curvature if curvature.shape[-1] else np.zeros((*curvature.shape[:-1], 1))


def progress(label: str | None, total: int) -> Any:
    """Bar of progress on standard error: on a terminal and with a label, else one that is silent.

    It disappears when it is closed.
    """
    return tqdm(total=total, desc=label, disable=None if label else True, leave=False)


def episode_metrics(recording: Recording) -> dict[str, AnyArray]:
    """All METRICS per episode; in a failed episode all but success and score are infinite."""
    r = recording
    time = r.time
    settling = np.array([settling_time(time, e, SETTLED_BAND * r.reach) for e in r.tip_error.T])
    last = np.array([np.flatnonzero(np.isfinite(e))[-1] for e in r.tip_error.T])
    at_end = time[:, None] > time[last] - RESIDUAL_WINDOW + 1e-9
    dt = time[1] - time[0]
    steps = np.diff(r.action[1:], axis=0)
    saturated = (np.abs(r.action[1:]) >= SATURATED).any(axis=-1)
    values = {
        "settling_time": settling,
        "tip_error_final": r.tip_error[last, np.arange(last.size)],
        "tip_error_rms": np.sqrt(np.nanmean(r.tip_error**2, axis=0)),
        "tip_error_max": np.nanmax(r.tip_error, axis=0),
        "residual_vibration": np.sqrt(
            np.nanmean(np.where(at_end, r.tip_deflection**2, np.nan), axis=0)
        ),
        "peak_root_curvature": np.nanmax(np.abs(r.root_curvature), axis=(0, 2)),
        "effort": np.nansum(r.torque[1:] ** 2, axis=(0, 2)) * dt,
        "command_variation": np.nansum(np.abs(steps), axis=(0, 2)),
        "saturated": saturated.sum(axis=0) / last,
    }
    values = {name: np.where(r.failed, np.inf, value) for name, value in values.items()}
    success = np.isfinite(values["settling_time"]).astype(float)
    return {"success": success, "score": score(values, r)} | values


def score(values: Mapping[str, AnyArray], recording: Recording) -> AnyArray:
    """Score of every episode in [0, 1], which does not depend on the reward; 0 for a failure.

    With a resting target it is the share of the episode that is left after settling. With a moving
    target it is 1 / (1 + RMS / band): 1/2 for an RMS tip error as wide as the settled band.
    """
    if recording.moving:
        return 1.0 / (1.0 + values["tip_error_rms"] / (SETTLED_BAND * recording.reach))
    return np.clip(1.0 - values["settling_time"] / recording.duration, 0.0, 1.0)


def settling_time(time: AnyArray, error: AnyArray, band: float) -> float:
    """First time [s] from which the error stays within the band to the end; inf if there is none.

    The error must stay there for HOLD seconds at least, so that crossing zero at the last sample
    is not settling.
    """
    finite = np.isfinite(error)
    time, error = time[finite], error[finite]
    outside = np.flatnonzero(~(error < band))
    if outside.size == 0:
        return float(time[0])
    first = outside[-1] + 1
    if first == error.size or time[-1] - time[first] < HOLD - 1e-9:
        return math.inf
    return float(time[first])


def summarise(metrics: Mapping[str, AnyArray]) -> dict[str, float]:
    """Success rate, and the median of every other metric, where failures are infinite."""
    summary = {"success_rate": float(np.mean(metrics["success"]))}
    for name, values in metrics.items():
        if name != "success":
            summary[name] = float(np.median(values))
    return summary


def write_results(
    folder: Path,
    results: Mapping[str, Mapping[str, AnyArray]],
    seeds: Sequence[int],
    about: Mapping[str, Any],
) -> None:
    """Write `evaluation.json` (summary and episodes) and `evaluation.csv` (a row per episode)."""
    controllers = {
        name: {"summary": summarise(metrics), "episodes": dict(metrics)}
        for name, metrics in results.items()
    }
    data = {"note": NOTE, **about, "seeds": list(seeds), "controllers": controllers}
    write_json(folder / "evaluation.json", data)
    with (
        atomic_write(folder / "evaluation.csv") as path,
        open(path, "w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(["controller", "seed", *METRICS])
        for name, metrics in results.items():
            for i, seed in enumerate(seeds):
                writer.writerow([name, seed, *(float(metrics[m][i]) for m in METRICS)])


@dataclass(frozen=True)
class Best:
    """Best values of a metric that any torques are known to reach, NaN where none is known."""

    metric: str  # "settling_time" [s], or "tip_error_rms" [m] where the target moves
    values: AnyArray  # (episodes,)

    @property
    def of_path(self) -> bool:
        """True if the target moves."""
        return self.metric == "tip_error_rms"


def regrets(metrics: Mapping[str, AnyArray], best: Best) -> AnyArray:
    """A metric (..., episodes) over the best that is known, minus 1, at most MOST_REGRET.

    Episodes without a best are left out, and those that are settled from the start.
    """
    known = best.values > 0.0
    ratio = metrics[best.metric][..., known] / best.values[known]
    return np.minimum(ratio - 1.0, MOST_REGRET)


def excesses(metrics: Mapping[str, AnyArray], best: Best) -> AnyArray:
    """A metric (..., episodes) less the best that is known; infinite in a failed episode.

    Episodes without a best are left out.
    """
    known = best.values > 0.0
    return np.asarray(metrics[best.metric][..., known] - best.values[known])


def print_table(results: Mapping[str, Mapping[str, AnyArray]], best: Best | None = None) -> None:
    """Print the main metrics of every controller, and the regret where a bound is known."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table()
    columns = ["", "success", "score", "settling [s]", "tip error [mm]", "vibration [mm]"]
    columns += ["effort [N²m²s]"]
    if best is not None:
        columns.append("excess [mm]" if best.of_path else "regret")
    for column in columns:
        table.add_column(Text(column), justify="right" if column else "left")
    for name, metrics in results.items():
        s = summarise(metrics)
        cells = [
            f"{100 * s['success_rate']:.0f} %",
            f"{s['score']:.3f}",
            f"{s['settling_time']:.2f}" if math.isfinite(s["settling_time"]) else "never",
            f"{1e3 * s['tip_error_final']:.2f}",
            f"{1e3 * s['residual_vibration']:.2g}",
            f"{s['effort']:.3g}",
        ]
        if best is not None and best.of_path:
            cells.append(f"{1e3 * np.median(excesses(metrics, best)):.3g}")
        elif best is not None:
            cells.append(f"{100 * np.median(regrets(metrics, best)):.0f} %")
        table.add_row(name, *cells)
    console = Console(width=None if Console().is_terminal else 100)
    console.print(table)
    console.print(CAPTION, style="dim")
    if best is not None:
        console.print(_bounded(best), style="dim")


def _bounded(best: Best) -> str:
    """Sentence on the last column of the table."""
    median = np.nanmedian(best.values)
    if best.of_path:
        return (
            "Excess: RMS tip error less the smallest that any torques are known to reach (median "
            f"{1e3 * median:.3g} mm)."
        )
    return (
        "Regret: settling time over the best that any torques are known to reach (median "
        f"{median:.3g} s), minus one."
    )
