"""A cart on a line, in the place of an episode: linear, so that its optima are known exactly."""

from typing import Any

import numpy as np
from scipy.optimize import linprog

from agents.leaderboard.motions import Motion
from dynamics.types import Array

DT, STEPS, BAND = 0.1, 40, 0.02  # [s], [-], [m]
AGE = np.subtract.outer(np.arange(STEPS), np.arange(STEPS))
RESPONSE = np.where(AGE >= 0, DT**2 * (AGE + 0.5), 0.0)  # [m/N] of a mass of 1 kg


class Cart:
    """1 kg, at rest at the origin; `bend` is the deflection by a unit force."""

    env_id, seed = "FlexArm/OneLink-Reach-v0", 0
    steps, held, dt, reach = STEPS, STEPS - 2, DT, 50.0 * BAND

    def __init__(self, target: Any = 1.0, bend: float = 0.5) -> None:
        self.target, self.bend = np.broadcast_to(target, STEPS), bend
        self.start = abs(float(self.target[0])) / BAND

    def follow(self, actions: Array) -> list[Motion]:
        return [self.motion(force) for force in actions]

    def effects(self, motion: Motion) -> tuple[Array, Array]:
        return RESPONSE[:, None] / BAND, self.bend * np.eye(STEPS)

    def motion(self, force: Array) -> Motion:
        errors = (RESPONSE @ force[:, 0] - self.target)[:, None] / BAND
        outside = np.flatnonzero(np.abs(errors[:, 0]) >= 1.0)
        settled = int(outside[-1]) + 1 if outside.size else 0
        return Motion(force, errors, np.abs(errors[:, 0]), self.bend * force[:, 0], settled, True)

    def resting(self) -> Motion:
        return self.motion(np.zeros((STEPS, 1)))


def first_feasible(largest: float) -> int:
    """First step from which forces of at most `largest` can keep the cart on a target at 1 m."""
    for k in range(STEPS):
        rows, room = np.vstack([RESPONSE[k:], -RESPONSE[k:]]), np.full(STEPS - k, BAND)
        b = np.concatenate([room + 1.0, room - 1.0])
        if linprog(np.zeros(STEPS), rows, b, bounds=(-largest, largest)).status == 0:
            return k
    raise AssertionError("no step is feasible")
