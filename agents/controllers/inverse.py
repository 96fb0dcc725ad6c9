"""Inverse dynamics with flexible feed-forward: joint PD about a planned motion of a bent arm.

The plan takes every joint smoothly from its first reading to the target, and along with it where it
moves. Its torques are those of the straight arm's inverse dynamics; links are expected to bend as
the plan's accelerations bend them at rest, and joints turned so far that the tip stays on the plan
(De Luca and Siciliano, J. Guidance, Control, and Dynamics 16, 1993, with the bending of
`reference.py` in place of its integration). Feedback is joint PD about the planned angles.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.controllers.linear_model import LinearModels
from agents.controllers.observers import fresh_of
from agents.controllers.pd import joint_pd
from agents.controllers.reading import Reading
from agents.controllers.reference import Course, Reference, followed, smooth_way
from dynamics.types import AnyArray, Array
from flexarm_env.scales import MOVE


@dataclass
class _Plan:
    """Knowledge of the controller of its episodes."""

    course: Course  # of the targets
    steps: Array  # (N,) control steps since the start
    start: Array  # (N, m) [rad] first reading of the joint error
    offset: Array  # (N, m) [rad] planned joint errors of the last step


class InverseDynamics:
    """Joint PD about a plan whose torques are fed forward.

    `rise` is the time of a move of `MOVE` rad over the environment's move time; other moves take
    the root of their share of it.
    """

    def __init__(
        self, env: Any, *, frequency_ratio: float, damping_ratio: float, rise: float
    ) -> None:
        self.read, self.models = Reading.of(env), LinearModels.of(env)
        self.pd = joint_pd(env, frequency_ratio, damping_ratio)
        self.reference = Reference(self.models, [self.models.middle])
        self.rise = rise * env.unwrapped.core.move_time

    def predict(
        self,
        observation: AnyArray,
        state: _Plan | None = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, _Plan]:
        """Actions; the state holds the episodes' plans."""
        x, dt = np.atleast_2d(observation), self.models.control_dt
        error, rate = self.read(x, "joint_error"), self.read(x, "joint_rate")
        fresh = fresh_of(state, episode_start, len(x))
        course = followed(self.read, x, state.course if state else None, fresh, dt)
        steps = np.zeros(len(x)) if state is None else np.where(fresh, 0.0, state.steps)
        start = error if state is None else np.where(fresh[:, None], error, state.start)
        away = [self._away(dt * (steps + k), start) for k in (-1, 0, 1)]
        offset, forward = self._bent(course, away)
        before = offset if state is None else np.where(fresh[:, None], offset, state.offset)
        torque = (
            forward
            - self.pd.stiffness * (error - offset)
            - self.pd.damping * (rate - course.rate - (offset - before) / dt)
        )
        action = np.clip(torque / self.pd.torque_limit, -1.0, 1.0)
        plan = _Plan(course, steps + 1.0, start, offset)
        return action.reshape(*np.shape(observation)[:-1], -1), plan

    def _away(self, time: Array, start: Array) -> tuple[Array, Array]:
        """(N, m) [rad] planned joint errors and [rad/s] their rates at times (N,) [s]."""
        least = self.models.control_dt
        rise = np.maximum(self.rise * np.sqrt(np.abs(start).max(axis=1) / MOVE), least)
        way, slope = smooth_way(time / rise)
        return start * (1.0 - way)[:, None], -start * (slope / rise)[:, None]

    def _bent(self, course: Course, away: list[tuple[Array, Array]]) -> tuple[Array, Array]:
        """(N, m) [rad] planned joint errors of the bent arm, and [N m] torques to come."""
        dt, joints = self.models.control_dt, self.models.joints
        (_, last), (here, rate), (_, following) = away
        plan = replace(
            course,
            way=course.way + here,
            rate=course.rate + rate,
            acceleration=course.acceleration + (rate - last) / dt,
            coming=course.coming + (following - rate) / dt,
        )
        offset, forward = (x[:, 0] for x in self.reference.along(plan))
        return here + offset[:, joints], forward
