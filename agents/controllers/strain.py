"""Joint control that feeds the links' strain back, and joint PID.

- PID: joint PD with the integral of the joint error, held while a torque is at its limit.
- Strain feedback: the joint yields to the bending of its own link, at a rate proportional to the
  curvature at the root (direct strain feedback, Luo, IEEE Trans. Automatic Control 38, 1993).
- Positive position feedback: a second-order filter near the arm's first frequency takes the
  bending and adds a torque (Fanson and Caughey, AIAA Journal 28, 1990).
- Integral resonant control: the integral of the bending with a feed-through adds a torque (Aphale,
  Fleming and Moheimani, Smart Materials and Structures 16, 2007; for a flexible arm Pereira,
  Aphale, Feliu and Moheimani, IEEE/ASME Trans. Mechatronics 16, 2011).
"""

import math
from typing import Any

import numpy as np
from scipy.linalg import expm

from agents.controllers.models.memory import Remembering, resumed
from agents.controllers.models.reading import Reading
from agents.controllers.pd import JointPD, joint_pd
from dynamics.types import AnyArray, Array
from flexarm_env.task.observations import curvature_columns


class PID(Remembering):
    """Joint PD, and the integral of the joint error over a reset time, in move times."""

    def __init__(
        self, env: Any, *, frequency_ratio: float, damping_ratio: float, reset: float
    ) -> None:
        core = env.unwrapped.core
        self.read, self.pd = Reading.of(env), joint_pd(env, frequency_ratio, damping_ratio)
        self.share = core.control_dt / (reset * core.move_time)

    def act(self, x: AnyArray, memory: Array | None, fresh: AnyArray) -> tuple[AnyArray, Array]:
        """Actions; the memory (N, m) [rad] is the integral."""
        error = self.read(x, "joint_error")
        before = resumed(memory, fresh, error.shape)
        gain, moved = self.pd.stiffness / self.pd.torque_limit, before + self.share * error
        action = self.pd.of_joints(x)
        free = np.abs(action - gain * moved) < 1.0
        integral = np.where(free, moved, before)
        return self.pd.whole(action - gain * integral), integral


class StrainFeedback:
    """Joint PD whose joints yield towards the bent links, `yielding` times as fast as PD would.

    A negative share stiffens the joints against the links.
    """

    def __init__(
        self, env: Any, *, frequency_ratio: float, damping_ratio: float, yielding: float
    ) -> None:
        self.chords, self.pd = Chords(env, "strain"), joint_pd(env, frequency_ratio, damping_ratio)
        self.gain = yielding * self.pd.stiffness / self.pd.torque_limit

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions from angles, rates and curvatures."""
        action = self.pd.of_joints(observation) + self.gain * self.chords(observation)
        return self.pd.whole(action), state


class FilteredBending(Remembering):
    """Joint PD beside a filter of the bending that adds to the joints' reference.

    Its s states go to `step` (states, chord) at every control step; `gain` [1/rad] turns the first
    into actions.
    """

    chords: "Chords"
    pd: JointPD
    gain: Array  # (m,)
    step: Array  # (s, s + 1)

    def act(self, x: AnyArray, memory: Array | None, fresh: AnyArray) -> tuple[AnyArray, Array]:
        """Actions; the memory (N, s, m) is the filters' state."""
        chord = self.chords(x)
        before = resumed(memory, fresh, (len(x), len(self.step), chord.shape[1]))
        after = self.step @ np.concatenate([before, chord[:, None]], axis=1)
        return self.pd.whole(self.pd.of_joints(x) + self.gain * after[:, 0]), after


class PositivePosition(FilteredBending):
    """Joint PD beside a filter of the bending that adds `gain` times PD's stiffness.

    `filter_ratio` is the filter's frequency over the first one with locked joints.
    """

    def __init__(
        self,
        env: Any,
        *,
        frequency_ratio: float,
        damping_ratio: float,
        gain: float,
        filter_ratio: float,
        filter_damping: float,
    ) -> None:
        self.chords, self.pd = Chords(env, "ppf"), joint_pd(env, frequency_ratio, damping_ratio)
        self.gain = gain * self.pd.stiffness / self.pd.torque_limit
        w = filter_ratio * _first_frequency(env)
        flow = np.array([[0.0, 1.0, 0.0], [-(w**2), -2.0 * filter_damping * w, w**2], 3 * [0.0]])
        self.step = expm(flow * env.unwrapped.core.control_dt)[:2]


class IntegralResonant(FilteredBending):
    """Joint PD whose joints yield by the integral u of the bending with a feed-through.

    u' = k (chord - u / gain). `corner_ratio` is the corner k / gain over the first frequency with
    locked joints; `gain` is what is left of the chord at rest.
    """

    def __init__(
        self,
        env: Any,
        *,
        frequency_ratio: float,
        damping_ratio: float,
        gain: float,
        corner_ratio: float,
    ) -> None:
        self.chords, self.pd = Chords(env, "irc"), joint_pd(env, frequency_ratio, damping_ratio)
        self.gain = self.pd.stiffness / self.pd.torque_limit
        corner = corner_ratio * _first_frequency(env)
        kept = math.exp(-corner * env.unwrapped.core.control_dt)
        self.step = np.array([[kept, (1.0 - kept) * gain]])


def _first_frequency(env: Any) -> float:
    """First frequency [rad/s] with locked joints; of a rigid arm one over the move time."""
    core = env.unwrapped.core
    return float((core.scales.locked or (1.0 / core.move_time,))[0])


class Chords:
    """Angles between the roots of the bent links and their chords, one per joint, from gauges.

    A tip force that bends a link of length l to the curvature k at its root turns its chord by
    k l / 3, if it is uniform. A joint turns its own link along y; a link on a fixed joint counts
    for none.
    """

    def __init__(self, env: Any, name: str) -> None:
        core = env.unwrapped.core
        self.read = Reading.of(env)
        self.read.require(name, "joint_error", "root_curvature")
        columns = curvature_columns(core.arm)
        self.turn = np.zeros((len(columns), core.arm.n_joint))
        for row, column in enumerate(columns):
            link, across = divmod(column, 2)
            bent = core.arm.links[link]
            if not across and link in core.arm.joints:
                self.turn[row, core.arm.joints.index(link)] = bent.length / bent.root_curvature("y")

    def __call__(self, observation: AnyArray) -> Array:
        """(..., m) [rad]."""
        return np.asarray(self.read(observation, "root_curvature") @ self.turn)
