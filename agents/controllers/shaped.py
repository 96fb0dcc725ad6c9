"""Joint PD behind an input shaper: the reference moves so that the closed loop is left still.

The reference of every joint runs smoothly from its first reading to the target and is convolved
with impulses that cancel the least damped oscillations of the linear closed loop: ZV and ZVD of
Singer and Seering, J. Dyn. Sys. Meas. Control 112 (1990), and EI of Singhose, Seering and Singer,
J. Mech. Design 116 (1994). Shapers of several modes are convolved (Hyde and Seering, IEEE Int.
Conf. Robotics and Automation, 1991).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.controllers.models.linear_model import KEPT, LinearModel, LinearModels
from agents.controllers.models.memory import Remembering, kept
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import posture_of, smooth_way
from agents.controllers.pd import joint_pd
from dynamics.types import AnyArray, Array

Impulses = tuple[Array, Array]  # amplitudes, which add up to 1, and times [s]
TOLERATED = 0.05  # [-] residual vibration that EI allows at the modelled frequency
DAMPED = 0.7  # [-] damping ratio above which an oscillation is not shaped
SLOWEST = 1e-3  # [rad/s] slower poles are rigid motions


def zv(frequency: float, damping: float) -> Impulses:
    """Zero vibration at one frequency [rad/s] and damping ratio."""
    decay, half = _decay(frequency, damping)
    return np.array([1.0, decay]) / (1.0 + decay), np.array([0.0, half])


def zvd(frequency: float, damping: float) -> Impulses:
    """Zero vibration, and zero slope over the frequency."""
    decay, half = _decay(frequency, damping)
    amplitudes = np.array([1.0, 2.0 * decay, decay**2])
    return amplitudes / amplitudes.sum(), half * np.arange(3.0)


def ei(frequency: float, damping: float) -> Impulses:
    """Extra-insensitive: TOLERATED vibration at the frequency, none on both sides."""
    decay, half = _decay(frequency, damping)
    undamped = np.array([1.0 + TOLERATED, 2.0 * (1.0 - TOLERATED), 1.0 + TOLERATED]) / 4.0
    amplitudes = undamped * decay ** np.arange(3.0)
    return amplitudes / amplitudes.sum(), half * np.arange(3.0)


def _decay(frequency: float, damping: float) -> tuple[float, float]:
    """Ratio of two successive extremes, and half the damped period [s]."""
    root = math.sqrt(1.0 - damping**2)
    return math.exp(-damping * math.pi / root), math.pi / (frequency * root)


def convolved(a: Impulses, b: Impulses) -> Impulses:
    """Impulses of two shapers in a row."""
    return np.outer(a[0], b[0]).ravel(), np.add.outer(a[1], b[1]).ravel()


@dataclass
class _Run:
    """Knowledge of a shaped controller of its episodes."""

    steps: Array  # (N,) control steps since the start
    start: Array  # (N, m) [rad] first reading of the joint error
    impulses: list[Impulses]  # per environment


class ShapedPD(Remembering):
    """Joint PD whose reference is shaped for the `modes` least damped oscillations."""

    def __init__(
        self,
        env: Any,
        shaper: Callable[[float, float], Impulses],
        *,
        frequency_ratio: float,
        damping_ratio: float,
        rise: float,
        modes: int,
    ) -> None:
        core = env.unwrapped.core
        self.read, self.shaper, self.modes = Reading.of(env), shaper, modes
        self.pd = joint_pd(env, frequency_ratio, damping_ratio)
        self.models, self.rise = LinearModels.of(env), rise * core.move_time
        self._impulses = kept(self._shaped, KEPT)

    def act(self, x: AnyArray, memory: _Run | None, fresh: AnyArray) -> tuple[AnyArray, _Run]:
        """Actions; the memory holds the episodes' times and references."""
        error, rate = self.read(x, "joint_error"), self.read(x, "joint_rate")
        run = self._started(x, error, memory, fresh)
        way, slope = np.array(
            [
                self._reference(step * self.models.control_dt, *impulses)
                for step, impulses in zip(run.steps, run.impulses, strict=True)
            ]
        ).T
        off = run.start * (1.0 - way)[:, None]
        moving = -run.start * slope[:, None]
        torque = -self.pd.stiffness * (error - off) - self.pd.damping * (rate - moving)
        run.steps += 1
        return np.clip(torque / self.pd.torque_limit, -1.0, 1.0), run

    def _started(self, x: AnyArray, error: Array, run: _Run | None, fresh: AnyArray) -> _Run:
        if run is None:
            run = _Run(np.zeros(len(x)), np.zeros_like(error), [self._none] * len(x))
        postures = posture_of(self.read, x)
        run.steps[fresh], run.start[fresh] = 0.0, error[fresh]
        for i in np.flatnonzero(fresh):
            run.impulses[i] = self._impulses(self.models.at(postures[i]))
        return run

    _none: Impulses = (np.ones(1), np.zeros(1))

    def _reference(self, t: float, amplitudes: Array, times: Array) -> tuple[float, float]:
        """Share of the way [-] and its rate [1/s] at time t [s]."""
        way, slope = smooth_way((t - times) / self.rise)
        return float(amplitudes @ way), float(amplitudes @ slope) / self.rise

    def _shaped(self, model: LinearModel) -> Impulses:
        """Shaper of the least damped oscillations of the closed loop at a posture."""
        result = self._none
        for frequency, damping in oscillations(model, self.pd, self.models)[: self.modes]:
            result = convolved(result, self.shaper(frequency, damping))
        return result


def oscillations(model: LinearModel, pd: Any, models: LinearModels) -> list[tuple[float, float]]:
    """Frequencies [rad/s], damping ratios of the loop closed by joint PD; slowest decay first."""
    joints = model.shapes[models.joints]
    gain = np.hstack([pd.stiffness[:, None] * joints, pd.damping[:, None] * joints])
    poles = np.log(np.linalg.eigvals(model.A - model.B @ gain).astype(complex)) / models.control_dt
    found = sorted(((-p.real, abs(p)) for p in poles if p.imag > SLOWEST), key=lambda x: x[0])
    return [(w, decay / w) for decay, w in found if 0.0 <= decay / w < DAMPED]
