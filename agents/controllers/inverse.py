"""Inverse dynamics with flexible feed-forward: joint PD about a planned motion of a bent arm.

The plan is that of `plan.py`. Its torques are those of the straight arm's inverse dynamics; links
are expected to bend as the plan's accelerations bend them at rest, and joints turned so far that
the tip stays on the plan (De Luca and Siciliano, J. Guidance, Control, and Dynamics 16, 1993, with
the bending of `reference.py` in place of its integration). Feedback is joint PD about the planned
angles.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.controllers.models.linear_model import LinearModels
from agents.controllers.models.memory import Remembering
from agents.controllers.models.plan import Plan, TimedMoves
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import Reference
from agents.controllers.pd import joint_pd
from dynamics.types import AnyArray, Array


@dataclass
class _Memory:
    plan: Plan
    offset: Array  # (N, m) [rad] joint errors of the bent plan


class InverseDynamics(Remembering):
    """Joint PD about a plan whose torques are fed forward; `load` is that of `TimedMoves`."""

    def __init__(
        self, env: Any, *, frequency_ratio: float, damping_ratio: float, load: float
    ) -> None:
        self.read, self.models = Reading.of(env), LinearModels.of(env)
        self.pd = joint_pd(env, frequency_ratio, damping_ratio)
        self.planner = TimedMoves(env, self.models, load)
        self.reference = Reference(self.models, [self.models.middle])
        model, exact = self.models.model, "modal_amplitude" in self.read
        self.angles = np.eye(model.n)[self.models.joints] if exact else model.encoders

    def act(self, x: AnyArray, memory: _Memory | None, fresh: AnyArray) -> tuple[AnyArray, _Memory]:
        """Actions about the episodes' plans."""
        plan = self.planner.follow(x, memory.plan if memory else None, fresh)
        bent, forward = (part[:, 0] for part in self.reference.along(plan.motion))
        offset = plan.remaining_error + bent @ self.angles.T
        before = offset if memory is None else np.where(fresh[:, None], offset, memory.offset)
        rate = plan.target.rate + (offset - before) / self.models.control_dt
        torque = (
            forward
            - self.pd.stiffness * (self.read(x, "joint_error") - offset)
            - self.pd.damping * (self.read(x, "joint_rate") - rate)
        )
        return np.clip(torque / self.pd.torque_limit, -1.0, 1.0), _Memory(plan, offset)
