"""What an arm is asked to do: Reach, Track, Damp.

Every task is a joint reference; the target is the tip of the arm with straight links there. So a
target can always be reached, and a controller of joints knows where to go.
"""

import math
from dataclasses import dataclass

import numpy as np

from dynamics.description import validate
from dynamics.types import Array
from flexarm_env.scales import MOVE

Range = tuple[float, float]
SETTLED_BAND = 0.02  # [-] tip error over reach


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task: what its episodes are drawn from, uniformly, by an environment's own stream."""

    title: str
    description: str
    start: Range  # [rad] joint angles at the start, about the home posture
    start_text: str
    reward: str  # name of its default reward
    moves: Range = (0.0, 0.0)  # [rad] joint angles from start to target, either sign
    share: Range = (0.0, 0.0)  # [-] acceleration of each sine of the path, of full torque's
    tempo: Range = (0.0, 0.0)  # [-] frequency of the sines, of a typical move's
    shake: Range = (0.0, 0.0)  # [-] modal amplitudes and rates, of those in a bang-bang

    @property
    def moving(self) -> bool:
        """Whether the target moves."""
        return self.tempo[1] > 0.0

    def ranges(self, move_time: float) -> Array:
        """(5, 2) ranges that `episode.begin` draws from; the rows are named there."""
        base = math.pi / move_time  # [rad/s]
        tempo = (self.tempo[0] * base, self.tempo[1] * base)
        return np.array([self.start, self.moves, self.share, tempo, self.shake])


TASKS = {
    "Reach": Task(
        title="rest to rest",
        description=(
            "Bring the tip from rest onto a resting target, as fast as the torques allow, and "
            "leave no vibration behind."
        ),
        start=(-0.5, 0.5),
        moves=(0.3, 0.8),
        start_text=(
            "At rest, links straight. Joint angles: uniform within 0.5 rad of the home posture. "
            "Target: every joint 0.3 to 0.8 rad away, either way."
        ),
        reward="reach",
    ),
    "Track": Task(
        title="follow a smooth fast path",
        description=(
            "Keep the tip on a target that moves along a smooth path at speeds that bend the arm; "
            "the observation looks ahead by half and by one typical move."
        ),
        start=(-0.3, 0.3),
        share=(0.15, 0.35),
        tempo=(0.4, 1.2),
        start_text=(
            "At rest on the target, links straight. Joint angles: uniform within 0.3 rad of the "
            "home posture. Path of every joint: two sines with random phase, 0.4 to 1.2 times a "
            "typical move's frequency, each with 15 to 35 % of the acceleration at full torque "
            f"(at most {MOVE} rad), faded in over one typical move."
        ),
        reward="track",
    ),
    "Damp": Task(
        title="still a shaken arm",
        description="The arm was shaken and vibrates: bring it to rest where its joints were.",
        start=(-0.5, 0.5),
        shake=(-0.6, 0.6),
        start_text=(
            "Joints at rest, links vibrating: every modal amplitude and rate uniform within 60 % "
            "of the peak that one period of bang-bang at full torque gives it. Joint angles: "
            "uniform within 0.5 rad of the home posture. Target: the same joint angles, still."
        ),
        reward="damp",
    ),
}


def find_task(name: str) -> Task:
    """The task of this name, or a sentence."""
    return TASKS[validate.known(name, "task", TASKS)]
