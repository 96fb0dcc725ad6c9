"""Motions that controllers follow: the target's own, or planned ones that lead to it."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.controllers.models.linear_model import LinearModels
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import Course, Reference, followed, smooth_way
from dynamics.types import AnyArray, Array

SAMPLES = 41  # of a move, at which its torques are computed


@dataclass
class Plan:
    """Motions of N episodes."""

    target: Course
    motion: Course  # the target, and the remaining moves
    start: Array  # (N, m) [rad] joint errors at the start
    rise: Array  # (N,) [s] durations of the moves
    steps: Array  # (N,) control steps since the start

    @property
    def remaining_error(self) -> Array:
        """(N, m) [rad] distance of the plan from the target."""
        return self.motion.way - self.target.way


class Planner:
    """No moves: motions are the targets'."""

    def __init__(self, env: Any, models: LinearModels) -> None:
        self.read, self.models = Reading.of(env), models
        self.moving = "target_rate" in self.read

    def follow(self, x: AnyArray, before: Plan | None, fresh: AnyArray) -> Plan:
        """The plan after another observation (N, n); `fresh` (N,) marks new episodes."""
        dt = self.models.control_dt
        target = followed(self.read, x, before.target if before else None, fresh, dt)
        start, (rise, steps) = self.read(x, "joint_error"), np.zeros((2, len(x)))
        if before is not None:
            start = np.where(fresh[:, None], start, before.start)
            rise, steps = np.where(fresh, 0.0, (before.rise, before.steps + 1.0))
        plan = Plan(target, target, start, rise, steps)
        self._move(plan, fresh)
        return plan

    def _move(self, plan: Plan, fresh: AnyArray) -> None:
        """Add moves to the motions, timed where an episode starts."""


class TimedMoves(Planner):
    """Every joint goes smoothly to its target, all in the same time.

    The time is the least in which no joint takes more than a share `load` of its torque limit, and
    no link bends beyond that share of its own limit along y or z: both fall with its square
    (Hollerbach, Dynamic scaling of manipulator trajectories, ASME J. Dynamic Systems, Measurement,
    and Control 106, 1984). The torques are those of the straight arm's inverse dynamics with the
    middle plant.
    """

    def __init__(self, env: Any, models: LinearModels, load: float) -> None:
        super().__init__(env, models)
        self.moving, self.load, core = True, load, env.unwrapped.core
        self.limit = np.asarray(core.torque_limit, dtype=np.float64)
        self.deflection_limit = core.arguments["deflection_limit"]
        self.reference = Reference(models, [models.middle])

    def _move(self, plan: Plan, fresh: AnyArray) -> None:
        dt, target = self.models.control_dt, plan.target
        for i in np.flatnonzero(fresh):
            plan.rise[i] = max(dt, self.time(target.posture[i], plan.start[i]))
        (_, last), (left, rate), (_, following) = (self._remaining(plan, k) for k in (-1, 0, 1))
        plan.motion = replace(
            target,
            way=target.way + left,
            rate=target.rate + rate,
            acceleration=target.acceleration + (rate - last) / dt,
            coming=target.coming + (following - rate) / dt,
        )

    def time(self, posture: Array, start: Array) -> float:
        """[s] of a move to a resting target at angles (m,) from errors (m,) [rad]."""
        share = np.linspace(0.0, 1.0, SAMPLES)
        way, slope = smooth_way(share)
        bend = np.gradient(slope, share)
        still = np.zeros((SAMPLES, len(start)))
        course = Course(
            posture=still + posture,
            way=np.outer(1.0 - way, start),
            rate=-np.outer(slope, start),
            acceleration=-np.outer(bend, start),
            coming=-np.outer(bend, start),
        )
        offset, forward = (x[:, 0] for x in self.reference.along(course))
        bent = offset @ self.models.bends.T / self.deflection_limit
        most = max(np.abs(forward / self.limit).max(), np.abs(bent).max())
        return float(np.sqrt(most / self.load))

    def _remaining(self, plan: Plan, ahead: int) -> tuple[Array, Array]:
        """(N, m) [rad] errors and [rad/s] rates that the moves still have, some steps ahead."""
        way, slope = smooth_way(self.models.control_dt * (plan.steps + ahead) / plan.rise)
        return plan.start * (1.0 - way)[:, None], -plan.start * (slope / plan.rise)[:, None]
