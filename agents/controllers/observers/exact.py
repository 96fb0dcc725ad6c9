"""Exact states as estimates for model-based controllers.

`kalman.py` has the observer of sensors. Coordinates are taken from the reference of
`models/reference.py`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.controllers.models.linear_model import LinearModel, LinearModels
from agents.controllers.models.plan import Plan, Planner
from agents.controllers.models.preview import Preview
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import Reference
from dynamics.types import AnyArray, Array

NEVER: Array = np.empty(0)  # [s] times of a preview that is not wanted
PLANT = "plant"  # part of an observation: added payload [kg] and factor of the stiffness


@dataclass(frozen=True)
class Estimate:
    """State of one environment about its reference, and the plant that is assumed."""

    model: LinearModel
    x: Array  # (2r,) modal coordinates and rates
    forward: Array  # (m,) [N m] torque of the reference
    ahead: Array  # (K, m) [N m] torques of the reference at the times of the preview


def alike(estimates: list[Estimate]) -> Iterator[tuple[AnyArray, list[Estimate]]]:
    """Rows (k,) and estimates of environments whose states are equally large and can be stacked."""
    for rows in _rows_alike([estimate.model for estimate in estimates]):
        yield rows, [estimates[i] for i in rows]


def _rows_alike(models: list[LinearModel]) -> Iterator[AnyArray]:
    """Rows (k,) of models with as many modes."""
    sizes = np.array([len(model.modes) for model in models])
    for size in np.unique(sizes):
        yield np.flatnonzero(sizes == size)


@dataclass
class _Sight:
    """Memory of `ExactState`."""

    plan: Plan
    models: list[LinearModel]  # N, at the targets
    offset: Array  # (N, n) of the reference at the last step
    seen: Array  # of the target's path, see `Preview`


class ExactState:
    """The state as obs="state" gives it; the plant is the middle one, unless PLANT is observed."""

    parts = ("joint_error", "joint_rate", "modal_amplitude", "modal_rate")

    def __init__(
        self, env: Any, name: str, planner: Planner | None = None, times: Array = NEVER
    ) -> None:
        self.read, self.models = Reading.of(env), LinearModels.of(env)
        self.read.require(name, *self.parts)
        self.planner = planner or Planner(env, self.models)
        every = range(len(self.models.plants))
        self.reference = Reference(
            self.models, every if PLANT in self.read else [self.models.middle]
        )
        self.preview = Preview(env, self.models, times)

    def observe(
        self, x: AnyArray, memory: _Sight | None, fresh: AnyArray
    ) -> tuple[list[Estimate], _Sight]:
        """Estimates of N environments, and the memory for the next step."""
        dt, count = self.models.control_dt, len(x)
        plants = self._plants(x)
        plan = self.planner.follow(x, memory.plan if memory else None, fresh)
        place, speed = np.zeros((2, count, self.models.model.n))
        place[:, self.models.joints] = self.read(x, "joint_error") - plan.remaining_error
        place[:, self.models.modal] = self.read(x, "modal_amplitude")
        speed[:, self.models.joints] = self.read(x, "joint_rate") - plan.motion.rate
        speed[:, self.models.modal] = self.read(x, "modal_rate")
        which = np.arange(count), np.searchsorted(self.reference.plants, plants)
        offset, forward = (y[which] for y in self.reference.along(plan.motion))
        before = offset if memory is None else np.where(fresh[:, None], offset, memory.offset)
        speed -= (offset - before) / dt
        seen = self.preview.see(x, plan.target, memory.seen if memory else None, fresh)
        ahead = self.preview.torques(plan.target, seen, plants)
        known: list[Any] = memory.models if memory else [None] * count
        models = [
            self.models.at(posture, plant) if new or plant != model.plant else model
            for posture, plant, new, model in zip(
                plan.target.posture, plants.tolist(), fresh, known, strict=True
            )
        ]
        about = np.stack([place - offset, speed], axis=1)[..., None]
        states: list[Any] = [None] * count
        for rows in _rows_alike(models):
            modes = np.array([models[i].modes for i in rows])[:, None]
            for i, state in zip(rows, (modes @ about[rows]).reshape(len(rows), -1), strict=True):
                states[i] = state
        estimates = list(map(Estimate, models, states, forward, ahead))
        return estimates, _Sight(plan, models, offset, seen)

    def _plants(self, x: AnyArray) -> AnyArray:
        """(N,) plants."""
        if PLANT in self.read:
            return self.models.nearest(self.read(x, PLANT))
        return np.full(len(x), self.models.middle)

    def act(self, memory: _Sight, torque: Array) -> None:
        """Nothing to note: torques (N, m) show in the next state."""
