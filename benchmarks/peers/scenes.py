"""Three planar scenes whose true tips are computed without assumed modes.

Each scene is an arm of links without modes, a motion in joint space, and the tip of a converged
geometrically exact beam (beam.py, stored in tests/reference/*_exact_beam.csv).
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np

from benchmarks.accuracy.model_choice import S1, SpinUp
from benchmarks.output import REFERENCE
from benchmarks.work_precision.scenes import GOOD
from dynamics import Arm, Joint, Link
from dynamics.accuracy.scene import JointMotion, bang_bang, release
from dynamics.types import Array

HEAVY = 1e9  # [kg m^2] a rotor that no link can move: its joint turns as prescribed
SPUN_INERTIA = 400.0  # [kg m^2] of the straight beam of S3 about its root
RESOLVED = 5.0  # the smallest error compared is this many times that of the truth
SPUN = Arm(
    links=(Link(length=10.0, rho_A=1.2, EIz=1.4e4, modes=(), joint=Joint(rotor_inertia=HEAVY)),),
)
_SWUNG = Link(length=1.0, rho_A=5.0, EIz=1000.0, modes=())
SWUNG = Arm(links=(_SWUNG, _SWUNG), gravity=(0.0, -9.81, 0.0))


@dataclass(frozen=True)
class PeerScene:
    """A scene for every engine."""

    name: str  # as in tests/reference/NAME_exact_beam.csv
    title: str
    arm: Arm  # without modes
    motion: JointMotion
    interval: float  # [s] between rows of the truth
    axial: float  # [N] EA, for engines with axial stretch
    others: tuple[float, ...]  # [N] smaller EA, which allow longer steps, and larger ones
    demands: tuple[tuple[float, str, float], ...]  # error [-], peer, wanted ratio of costs

    @property
    def rows(self) -> int:
        """Number of rows of the truth."""
        return round(self.motion.t_end / self.interval) + 1

    @property
    def start(self) -> Array:
        """(2,) [m] tip at the start, where the links are straight."""
        angles = np.cumsum(self.motion.joint_angles)
        return np.array([link.length for link in self.arm.links]) @ np.stack(
            [np.cos(angles), np.sin(angles)], axis=1
        )

    @property
    def file(self) -> Path:
        """File of the truth."""
        return REFERENCE / f"{self.name}_exact_beam.csv"

    @cached_property
    def truth(self) -> Array:
        """(N, 3) t [s] and tip [m] in the plane, at equal times."""
        return np.loadtxt(self.file, delimiter=",")

    @cached_property
    def finest(self) -> float:
        """Smallest error [-] of the reach that the truth resolves."""
        return RESOLVED * float(self.file.read_text().split(GOOD)[1].split()[0])

    def sampled(self, rate: Fraction) -> Array:
        """Rows of the truth at which a run of `rate` steps per row has a step's end."""
        return self.truth[:: rate.denominator]

    def step(self, rate: Fraction) -> float:
        """Time step at `rate` steps per row of the truth [s]."""
        return self.interval / float(rate)

    def allows(self, rate: Fraction) -> bool:
        """True if steps end at the end of the motion and at every jump of the torque."""
        steps = np.array(self.motion.knots) / self.interval / rate.denominator
        return bool(np.all(np.abs(steps - np.round(steps)) < 1e-9))

    def torques(self, rate: Fraction) -> Array:
        """(n,) [N m] torque of the first joint at the middle of every step."""
        h = self.step(rate)
        count = round(self.motion.t_end / h)
        if self.motion.torque is None:
            return np.zeros(count)
        torque = self.motion.torque
        return np.array([np.asarray(torque((k + 0.5) * h))[0] for k in range(count)])

    def error(self, tips: Array, rate: Fraction) -> float:
        """Largest tip distance from the truth over the reach [-]; infinite if the run diverged."""
        largest = np.hypot(*(tips - self.sampled(rate)[1:, 1:]).T).max()
        return float(largest) / self.arm.reach if np.isfinite(largest) else math.inf


SCENES = {
    scene.name: scene
    for scene in (
        PeerScene(
            "S1", "S1: one link, torque pulses", S1, bang_bang((0.5,), pulse=0.25, t_end=2.0),
            0.01, 6.255e6, (6e4, 6e3),
            ((1e-3, "Exudyn", 30.0), (1e-3, "MuJoCo", 100.0), (1e-4, "any", 30.0)),
        ),
        PeerScene(
            "S3", "S3: spin-up of a long beam", SPUN,
            JointMotion(
                joint_angles=(0.0,), joint_rates=(0.0,), t_end=20.0,
                torque=SpinUp(HEAVY + SPUN_INERTIA),
            ),
            0.05, 2.8e7, (2.8e6, 2.8e5), ((1e-2, "any", 4.0), (1e-3, "any", 10.0)),
        ),
        PeerScene(
            "korayem", "Two links released under gravity", SWUNG,
            release((-0.5 * math.pi, math.radians(5.0)), t_end=1.5),
            0.01, 4.9e7, (4.9e9, 4.9e6), ((1e-5, "any", 10.0),),
        ),
    )
}  # fmt: skip
