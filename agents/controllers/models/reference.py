"""References of model-based controllers: where a target goes, and how the arm goes with it.

A reference has its joints at the target, links bent as a steady acceleration of the joints bends
them, and joints turned so far that the tip stays on the target. A resting target has straight links
as its reference.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.controllers.models.linear_model import KEPT, LinearModel, LinearModels
from agents.controllers.models.memory import kept
from agents.controllers.models.reading import Reading
from dynamics import Model
from dynamics.types import AnyArray, Array


@dataclass
class Course:
    """Targets of N episodes since their start."""

    posture: Array  # (N, m) [rad] target at the start
    way: Array  # (N, m) [rad] target from there
    rate: Array  # (N, m) [rad/s]
    acceleration: Array  # (N, m) [rad/s^2] over the last control step
    coming: Array  # (N, m) [rad/s^2] over the next one, extrapolated

    @property
    def now(self) -> Array:
        """(N, m) [rad/s^2] present acceleration."""
        return 0.5 * (self.acceleration + self.coming)


def followed(
    read: Reading, x: AnyArray, before: Course | None, fresh: AnyArray, dt: float
) -> Course:
    """Course of the targets after another observation; `fresh` (N,) marks new episodes."""
    posture, rate = posture_of(read, x), target_rate(read, x)
    if before is None:
        still = np.zeros_like(rate)
        return Course(posture, still, rate, still, still)
    new = fresh[:, None]
    earlier = before.rate - dt * before.acceleration
    way = before.way + dt / 12.0 * (5.0 * rate + 8.0 * before.rate - earlier)  # Adams-Moulton
    acceleration = np.where(new, 0.0, (rate - before.rate) / dt)
    return Course(
        posture=np.where(new, posture, before.posture),
        way=np.where(new, 0.0, way),
        rate=rate,
        acceleration=acceleration,
        coming=np.where(new, 0.0, 2.0 * acceleration - before.acceleration),
    )


class Reference:
    """References of some of an arm's plants, in order, along the course of a target.

    The forces are those of the lightest and the heaviest payload, and in proportion between them:
    inverse dynamics is affine in a mass.
    """

    def __init__(self, models: LinearModels, plants: Sequence[int]) -> None:
        self.models, self.plants = models, plants
        self._bend = kept(self._bending, KEPT)

    def along(self, course: Course) -> tuple[Array, Array]:
        """Offsets (N, P, n) from the straight arm on the target; torques (N, P, m) [N m] ahead."""
        models, count = self.models, len(course.posture)
        offset = np.zeros((count, len(self.plants), models.model.n))
        forward = np.zeros((count, len(self.plants), len(models.joints)))
        moving = np.flatnonzero(course.rate.any(axis=1) | course.now.any(axis=1))
        if not moving.size:
            return offset, forward
        plants = [models.plants[p] for p in self.plants]
        first, last = plants[0], plants[-1]
        light = heavy = _forces(models, first.model, course, moving)
        if last.model is not first.model:
            heavy = _forces(models, last.model, course, moving)
        bends = np.array([self._bend(models.at(x)) for x in course.posture[moving]])
        for p, plant in enumerate(plants):
            share = (plant.payload - first.payload) / (last.payload - first.payload or 1.0)
            coming, now = light + share * (heavy - light)
            forward[moving, p] = coming[:, models.joints]
            # the torques of joints bend pinned-free links too, whose roots they turn
            load = now[:, models.modal] - now[:, models.joints] @ models.forces[models.modal].T
            bent = (bends @ load[..., None])[..., 0]
            offset[moving, p] = bent / plant.factor
        return offset, forward

    def _bending(self, model: LinearModel) -> Array:
        """(n, modal) offset by forces on the modes: links bend, joints undo it at the tip.

        It holds for the nominal stiffness.
        """
        joints, modal = self.models.joints, self.models.modal
        bend = np.zeros((self.models.model.n, len(modal)))
        nominal = model.K / self.models.plants[self.models.middle].factor
        bend[modal] = -np.linalg.inv(nominal[np.ix_(modal, modal)])
        gap = model.tip_of[:, modal] @ bend[modal]
        bend[joints] = -np.linalg.lstsq(model.tip_of[:, joints], gap, rcond=1e-6)[0]
        return bend


def torques(models: LinearModels, course: Course, plant: int) -> Array:
    """(N, m) [N m] torques of one plant."""
    found = np.zeros_like(course.way)
    moving = np.flatnonzero(course.rate.any(axis=1) | course.coming.any(axis=1))
    if moving.size:
        coming, _ = _forces(models, models.plants[plant].model, course, moving)
        found[moving] = coming[:, models.joints]
    return found


def _forces(models: LinearModels, model: Model, course: Course, moving: AnyArray) -> Array:
    """(2, k, n) forces on the straight arm that accelerates as it soon will, and as it does."""
    q, v, a = np.zeros((3, 2, len(moving), model.n))
    q[..., models.joints] = (course.posture + course.way)[moving]
    v[..., models.joints] = course.rate[moving]
    a[..., models.joints] = course.coming[moving], course.now[moving]
    return model.inverse_dynamics(*(x.reshape(-1, model.n) for x in (q, v, a))).reshape(a.shape)


def posture_of(read: Reading, x: AnyArray) -> Array:
    """(N, m) [rad] target angles; the first is zero where it does not matter: not observed."""
    error = read(x, "joint_error")
    posture = np.zeros_like(error)
    if "joint_sin" in read:
        angle = np.arctan2(read(x, "joint_sin"), read(x, "joint_cos"))
        posture[:, -angle.shape[1] :] = angle - error[:, -angle.shape[1] :]
    return posture


def smooth_way(share: Array) -> tuple[Array, Array]:
    """Way from 0 to 1 and its slope over shares of its time: at rest at both ends, and beyond."""
    x = np.clip(share, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0)), 30.0 * x**2 * (1.0 - x) ** 2


def target_rate(read: Reading, x: AnyArray) -> Array:
    """(N, m) [rad/s] rate of the target."""
    return (
        read(x, "target_rate") if "target_rate" in read else np.zeros_like(read(x, "joint_error"))
    )
