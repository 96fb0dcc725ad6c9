"""Tasks of an arm: Reach, Track, Damp.

A task is a joint reference; its target is the tip of the straight-link arm at these joint angles.
Every target can therefore be reached, and a joint controller has its reference.
"""

import math
from dataclasses import dataclass

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm, Base
from dynamics.types import Array
from flexarm_env.task.scales import MOVE, SLOW

Range = tuple[float, float]
SETTLED_BAND = 0.02  # [-] tip error over reach


@dataclass(frozen=True, kw_only=True)
class Task:
    """A task and the ranges of its episodes, drawn uniformly from an environment's own stream.

    Angle, rate and time scales are defined in `scales.MOVE` and `core.Core`.
    """

    title: str
    description: str
    start: Range  # [rad] joint angles at the start, about the home posture
    start_text: str
    reward: str  # name of its default reward
    moves: Range = (0.0, 0.0)  # [rad] joint angles from start to target, either sign
    share: Range = (0.0, 0.0)  # [-] acceleration of each sine over that at full torque
    tempo: Range = (0.0, 0.0)  # [-] frequency of the sines times move_time / pi
    shake: Range = (0.0, 0.0)  # [-] of `Scales.vibration` and `vibration_rate`

    @property
    def moving(self) -> bool:
        """True if the target moves."""
        return self.tempo[1] > 0.0

    def ranges(self, move_time: float) -> Array:
        """(5, 2) ranges for `compiled.episode.begin`, which names the rows."""
        base = math.pi / move_time  # [rad/s]
        tempo = (self.tempo[0] * base, self.tempo[1] * base)
        return np.array([self.start, self.moves, self.share, tempo, self.shake])


def _percent(shares: Range) -> str:
    return f"{100.0 * shares[0]:g} to {100.0 * shares[1]:g} %"


_NEAR, _CLOSE = (-0.5, 0.5), (-0.3, 0.3)  # [rad]
_MOVES = (0.3, 0.8)  # [rad]
_SHARE, _TEMPO, _SHAKE = (0.15, 0.35), (0.4, 1.2), (-0.6, 0.6)

TASKS = {
    "Reach": Task(
        title="rest to rest",
        description=(
            "Bring the tip from rest onto a resting target, as fast as the torques allow, and "
            "leave no vibration behind."
        ),
        start=_NEAR,
        moves=_MOVES,
        start_text=(
            f"At rest, links straight. Joint angles: uniform within {_NEAR[1]:g} rad of the home "
            f"posture. Target: every joint {_MOVES[0]:g} to {_MOVES[1]:g} rad away, either way."
        ),
        reward="reach",
    ),
    "Track": Task(
        title="follow a smooth fast path",
        description=(
            "Keep the tip on a target that moves along a smooth path at speeds that bend the arm; "
            "the observation holds the target half a move time and one move time ahead."
        ),
        start=_CLOSE,
        share=_SHARE,
        tempo=_TEMPO,
        start_text=(
            f"At rest on the target, links straight. Joint angles: uniform within {_CLOSE[1]:g} "
            "rad of the home posture. Path of every joint: two sines with random phases, faded in "
            f"over one move time. Angular frequency of a sine: {_TEMPO[0]:g} to {_TEMPO[1]:g} "
            f"times pi / move time. Acceleration amplitude: {_percent(_SHARE)} of the acceleration "
            f"at full torque. Angle amplitude: at most {MOVE} rad."
        ),
        reward="track",
    ),
    "Damp": Task(
        title="damp a vibrating arm",
        description="The links vibrate: bring the arm to rest at its initial joint angles.",
        start=_NEAR,
        shake=_SHAKE,
        start_text=(
            "Joints at rest, links vibrating in their slow natural modes (joints locked, up to "
            f"{SLOW:g} times the first frequency). Amplitudes and rates: uniform within "
            f"{100.0 * _SHAKE[1]:g} % of the modes' peaks in the bang-bang test. Joint angles: "
            f"uniform within {_NEAR[1]:g} rad of the home posture. Target: the same joint angles, "
            "at rest."
        ),
        reward="damp",
    ),
}


def base_poses(base: Base) -> Array:
    """(n_base, 2) ranges of a floating base's pose: the described place, any angle."""
    turn = np.array([math.pi * (name == "base_rz") for name in base.names])
    return np.stack([base.q - turn, base.q + turn], axis=1).reshape(-1, 2)


def refuse_floating(task: Task, arm: Arm) -> None:
    """Refuse a task that needs a fixed base: its start or target moves."""
    if arm.base.n and (task.moving or task.shake[1] > 0.0):
        raise ValueError(
            f"Base.type must be 'fixed' where the arm is to {task.title}, got "
            f"{arm.base.type!r}: joint angles alone do not place the tip of an arm that floats. "
            "Take task='Reach'."
        )


def find_task(name: str) -> Task:
    """Return the task of this name; a ValueError if there is none."""
    return TASKS[validate.known(name, "task", TASKS)]
