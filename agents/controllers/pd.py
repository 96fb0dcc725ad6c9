"""Joint PD, and the search for its gains."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.metrics import episode_metrics, make_batch, record, summarise
from dynamics.types import AnyArray

# Dimensionless gains, so that one grid suits every arm; see `joint_pd`. The grid is so fine that
# doubling its points improves joint PD by a tenth at most: a coarse grid would favour policies.
FREQUENCY_RATIOS = tuple(np.geomspace(0.05, 1.5, 20).tolist())
DAMPING_RATIOS = tuple(np.geomspace(0.15, 3.0, 16).tolist())
# Metrics by which pairs of gains are ordered, most important first; -1 if larger is better.
SETTLING = (("success_rate", -1.0), ("settling_time", 1.0), ("tip_error_rms", 1.0))
FOLLOWING = (("tip_error_rms", 1.0), ("success_rate", -1.0))
TUNING_SEED = 500_000  # first seed of the tuning episodes, which differ from the evaluation's
TUNING_EPISODES = 16


@dataclass(frozen=True, kw_only=True)
class JointPD:
    """tau = -stiffness (q - q_target) - damping (v - v_target) per joint, within the limits."""

    stiffness: AnyArray  # (n_joint,) or one row per environment (n_env, n_joint) [N m/rad]
    damping: AnyArray  # same shape [N m s/rad]
    torque_limit: AnyArray  # (n_joint,) [N m]
    slices: Mapping[str, slice]  # where the observation holds "joint_error" and "joint_rate"
    scales: Mapping[str, AnyArray]  # physical value = observation x scale
    idle: int = 0  # actions beyond those of the joints, of a torque on the base, which stay zero

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions from the measured joint angles and rates."""
        return self.whole(self.of_joints(observation)), state

    def whole(self, action: AnyArray) -> AnyArray:
        """All actions within the limits, from what the joints (..., n_joint) ask for."""
        idle = np.zeros((*action.shape[:-1], self.idle))
        return np.concatenate([np.clip(action, -1.0, 1.0), idle], axis=-1)

    def of_joints(self, observation: AnyArray) -> AnyArray:
        """Actions (..., n_joint) that the joints ask for, also beyond the limits."""
        x = np.asarray(observation, float)
        error = x[..., self.slices["joint_error"]] * self.scales["joint_error"]
        rate = x[..., self.slices["joint_rate"]] * self.scales["joint_rate"]
        if "target_rate" in self.slices:  # a moving target: damp the relative motion
            rate = rate - x[..., self.slices["target_rate"]] * self.scales["target_rate"]
        return np.asarray((-self.stiffness * error - self.damping * rate) / self.torque_limit)


def joint_pd(
    env: Any, frequency_ratio: AnyArray | float, damping_ratio: AnyArray | float
) -> JointPD:
    """JointPD for this environment's arm from dimensionless gains.

    stiffness = I (r w)^2, damping = 2 z I (r w), with I the inertia about each joint of the
    straight arm (the diagonal of M), w its first frequency with the joints locked, r the frequency
    ratio and z the damping ratio. Ratios of shape (n_env, 1) are gains per environment.
    """
    base = env.unwrapped
    model = base.model
    rest = np.zeros(model.n)
    inertia = np.diag(model.mass_matrix(rest))[list(model.arm.joint_index)]
    locked = np.asarray(model.frequencies(rest, joints="locked"))
    limit = np.asarray(base.torque_limit, float)[: model.n_joint]
    # A rigid arm has no bending frequency: w then uses the full torque at one radian.
    w = float(locked[0]) if locked.size else float(np.sqrt(np.min(limit / inertia)))
    bandwidth = np.asarray(frequency_ratio, float) * w
    return JointPD(
        stiffness=inertia * bandwidth**2,
        damping=2.0 * np.asarray(damping_ratio, float) * inertia * bandwidth,
        torque_limit=limit,
        slices=base.observation_slices,
        scales=base.observation_scales,
        idle=base.torque_limit.size - limit.size,
    )


@dataclass(frozen=True, kw_only=True)
class TunedPD:
    """Best gains of a grid, and the summary of every pair."""

    frequency_ratio: float
    damping_ratio: float
    table: tuple[dict[str, float], ...]  # one row per pair: the two ratios and the summary


def tune_pd(
    env_id: str,
    kwargs: Mapping[str, Any] | None = None,
    *,
    frequency_ratios: Sequence[float] = FREQUENCY_RATIOS,
    damping_ratios: Sequence[float] = DAMPING_RATIOS,
    episodes: int = TUNING_EPISODES,
    seed: int = TUNING_SEED,
) -> TunedPD:
    """Search a grid of gains on the same episodes for every pair, in one batch.

    The best pair has the highest success rate, then the shortest median settling time, then the
    smallest RMS tip error. With a moving target, RMS tip error is compared first.
    """
    pairs = list(itertools.product(frequency_ratios, damping_ratios))
    envs = make_batch(env_id, len(pairs) * episodes, kwargs)
    try:
        task = envs.unwrapped.task
        ratios = np.repeat(np.array(pairs), episodes, axis=0)
        controller = joint_pd(envs, ratios[:, :1], ratios[:, 1:])
        seeds = [seed + i for i in range(episodes)] * len(pairs)
        metrics = episode_metrics(record(controller, envs, seeds, "gains of joint PD"))
    finally:
        envs.close()
    table = []
    for p, (r, z) in enumerate(pairs):
        rows = slice(p * episodes, (p + 1) * episodes)
        summary = summarise({name: values[rows] for name, values in metrics.items()})
        table.append({"frequency_ratio": r, "damping_ratio": z} | summary)
    order = FOLLOWING if task == "Track" else SETTLING
    best = min(table, key=lambda row: [sign * row[name] for name, sign in order])
    return TunedPD(
        frequency_ratio=best["frequency_ratio"],
        damping_ratio=best["damping_ratio"],
        table=tuple(table),
    )
