"""Nominal motions: joints from rest to rest, and the rigid arm's torques that produce them."""

import math
from dataclasses import dataclass, replace

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.formulations.newton_euler import inverse_dynamics, rigid_links
from dynamics.simulation.case_file import Numbers
from dynamics.types import Array


@dataclass(frozen=True, kw_only=True)
class Cycloidal:
    """Cycloidal joint motion from `start` to `goal`, eq. (2.14) of Cyril's FLEXLINK thesis.

    q(t) = q(0) + (q(T) - q(0))/T (t - T/(2 pi) sin(2 pi t/T)), and q(T) after T. Rates and
    accelerations are zero at both ends.
    """

    start: Numbers  # (n_joint,) [rad or m]
    goal: Numbers  # (n_joint,) [rad or m]
    duration: float  # [s] T

    def __post_init__(self) -> None:
        start = validate.numbers(self.start, "Cycloidal.start", unit="rad")
        goal = validate.numbers(self.goal, "Cycloidal.goal", len(start), "rad")
        duration = validate.positive(self.duration, "Cycloidal.duration", "s")
        for name, value in (("start", start), ("goal", goal), ("duration", duration)):
            object.__setattr__(self, name, value)

    def __call__(self, t: float) -> tuple[Array, Array, Array]:
        """(n_joint,) coordinates, rates and accelerations at time t [s]."""
        T = self.duration
        start, way = np.array(self.start), np.subtract(self.goal, self.start)
        turn = 2.0 * math.pi * min(max(t / T, 0.0), 1.0)
        return (
            start + way * (turn - math.sin(turn)) / (2.0 * math.pi),
            way / T * (1.0 - math.cos(turn)),
            way * (2.0 * math.pi / T**2) * math.sin(turn),
        )


def stiffened(arm: Arm) -> Arm:
    """The arm without modes and joint springs, on which nominal torques are computed."""
    links = tuple(
        replace(
            link, modes=(), segments=1, damping_ratio=0.0, damping_beta=0.0,
            damping_beta_torsion=None,
            joint=replace(link.joint, stiffness=None, spring_damping=0.0),
        )
        for link in arm.links
    )  # fmt: skip
    return replace(arm, links=links)


class NominalTorque:
    """(n_joint,) [N m or N] torques over time with which the stiffened arm follows a motion."""

    def __init__(self, arm: Arm, motion: Cycloidal) -> None:
        self.motion, self.gravity = motion, arm.gravity
        self.links = rigid_links(stiffened(arm))
        if len(motion.start) != arm.n_joint:
            raise ValueError(
                f"Cycloidal.start must have {arm.n_joint} numbers, one per joint of the arm that "
                f"moves, got {len(motion.start)}."
            )
        self.breakpoints = (motion.duration,)

    def __call__(self, t: float) -> Array:
        q, v, a = (x.tolist() for x in self.motion(t))
        return np.array(inverse_dynamics(self.links, q, v, a, gravity=self.gravity))
