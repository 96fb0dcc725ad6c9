"""Judging controllers headlessly: many episodes in one batch, the same tasks for everybody."""

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.files import written_whole
from agents.policy import Controller
from dynamics.types import AnyArray
from flexarm_env import IDS, FlexArmVectorEnv
from flexarm_env.tasks import SETTLED_BAND

HOLD = 0.25  # [s] in the band at the end of the episode, at least, to count as settled
RESIDUAL_WINDOW = 1.0  # [s] at the end of the episode
SATURATED = 0.999  # [-] share of the torque limit that counts as saturated

METRICS = {  # name: (unit, meaning)
    "success": ("-", "settled, and held until the end of the episode"),
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
    "Medians over episodes. Success: tip error below 2 % of the reach, held to the end. "
    "Settling: since when. Tip error: at the end. "
    "Vibration: RMS elastic tip deflection over the last second."
)
NOTE = (
    "Medians over episodes; an episode that ends early counts as infinite in every metric but "
    "success. JSON has no infinity: null stands for an infinite value. SI units: "
    + "; ".join(f"{name} [{unit}] {meaning}" for name, (unit, meaning) in METRICS.items())
)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Episodes side by side: T samples of N episodes; NaN after an episode's end."""

    time: AnyArray  # (T,) [s]
    tip_error: AnyArray  # (T, N) [m]
    tip_deflection: AnyArray  # (T, N) [m]
    root_curvature: AnyArray  # (T, N, n_curvature) [1/m]
    torque: AnyArray  # (T, N, n_joint) [N m]; the first sample is zero
    action: AnyArray  # (T, N, n_joint) [-]; the first sample is zero
    failed: AnyArray  # (N,) bool: terminated before the time limit
    reach: float  # [m]


def make_batch(env_id: str, n_env: int, kwargs: Mapping[str, Any] | None = None) -> Any:
    """A batch environment of this package; errors about ids and keywords pass through."""
    envs = gym.make_vec(env_id, num_envs=n_env, **(kwargs or {}))
    if not isinstance(envs.unwrapped, FlexArmVectorEnv):
        envs.close()
        raise ValueError(f"{env_id} is not an environment of flexarm; known: {', '.join(IDS)}.")
    return envs


def record(controller: Controller, envs: Any, seeds: Sequence[int]) -> Recording:
    """Run one episode per environment of the batch, from the given seeds, and keep what matters."""
    observation, info = envs.reset(seed=list(seeds))
    n_env = envs.num_envs
    base = envs.unwrapped
    action = np.zeros((n_env, base.n_joint))
    samples = {name: [np.array(info[name], float)] for name in ("tip_error", "tip_deflection")}
    samples["root_curvature"] = [np.array(info["root_curvature"], float).reshape(n_env, -1)]
    samples["torque"], samples["action"] = [np.zeros_like(action)], [action]
    running = np.ones(n_env, bool)
    failed = np.zeros(n_env, bool)
    state, start = None, running.copy()
    while running.any():
        action, state = controller.predict(observation, state, start)
        start = ~running
        action = np.clip(np.asarray(action, np.float32), -1.0, 1.0)
        observation, _, terminated, truncated, info = envs.step(action)
        for name, rows in samples.items():
            values = action if name == "action" else info[name]
            row = np.array(values, float).reshape(rows[0].shape)
            row[~running] = np.nan
            rows.append(row)
        failed |= running & terminated
        running &= ~(terminated | truncated)
    stacked = {name: np.stack(rows) for name, rows in samples.items()}
    time = base.control_dt * np.arange(len(stacked["action"]))
    return Recording(time=time, failed=failed, reach=float(base.reach), **stacked)


def episode_metrics(recording: Recording) -> dict[str, AnyArray]:
    """Every metric of METRICS for every episode; infinite where the episode failed."""
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
    return {"success": np.isfinite(values["settling_time"]).astype(float)} | values


def settling_time(time: AnyArray, error: AnyArray, band: float) -> float:
    """First time [s] from which the error stays inside the band for good; inf if it does not.

    It must hold for HOLD seconds at least: an error that happens to cross zero at the last sample
    has not settled.
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
    """Success rate, and the median of every other metric with failures counted as infinite."""
    summary = {"success_rate": float(np.mean(metrics["success"]))}
    for name, values in metrics.items():
        if name != "success":
            summary[name] = float(np.median(values))
    return summary


def without_infinities(value: Any) -> Any:
    """A copy of the tree with null for every number that strict JSON cannot write."""
    if isinstance(value, Mapping):
        return {str(k): without_infinities(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [without_infinities(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def write_json(path: Path, data: Any) -> None:
    """Strict JSON: no NaN, no Infinity."""
    text = json.dumps(without_infinities(data), indent=2, allow_nan=False)
    with written_whole(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def write_results(
    folder: Path,
    results: Mapping[str, Mapping[str, AnyArray]],
    seeds: Sequence[int],
    about: Mapping[str, Any],
) -> None:
    """`evaluation.json` (summary and every episode) and `evaluation.csv` (a row per episode)."""
    controllers = {
        name: {"summary": summarise(metrics), "episodes": dict(metrics)}
        for name, metrics in results.items()
    }
    data = {"note": NOTE, **about, "seeds": list(seeds), "controllers": controllers}
    write_json(folder / "evaluation.json", data)
    with (
        written_whole(folder / "evaluation.csv") as path,
        open(path, "w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(["controller", "seed", *METRICS])
        for name, metrics in results.items():
            for i, seed in enumerate(seeds):
                writer.writerow([name, seed, *(float(metrics[m][i]) for m in METRICS)])


def print_table(results: Mapping[str, Mapping[str, AnyArray]]) -> None:
    """The comparison a reader wants first."""
    from rich.console import Console
    from rich.table import Table

    table = Table()
    for column in (
        "",
        "success",
        "settling [s]",
        "tip error [mm]",
        "vibration [mm]",
        "effort [N²m²s]",
    ):
        table.add_column(column, justify="right" if column else "left")
    for name, metrics in results.items():
        s = summarise(metrics)
        table.add_row(
            name,
            f"{100 * s['success_rate']:.0f} %",
            f"{s['settling_time']:.2f}" if math.isfinite(s["settling_time"]) else "never",
            f"{1e3 * s['tip_error_final']:.2f}",
            f"{1e3 * s['residual_vibration']:.2g}",
            f"{s['effort']:.3g}",
        )
    console = Console(width=None if Console().is_terminal else 100)
    console.print(table)
    console.print(CAPTION, style="dim")
