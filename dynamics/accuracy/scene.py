"""Scenes: motions in joint space that any model of an arm can follow.

A scene gives joint angles, joint rates and joint torques, and no modal amplitudes: every link
starts without modal rates, and straight or as gravity bends it. A free base starts as `Base`
describes it, and the tip is in the world. Sliding joints have m, m/s and N. `choose_model` compares
models of an arm on a scene.
"""

import math
from dataclasses import dataclass

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.simulation.case_file import Numbers, PiecewiseConstant, Torque, jump_times
from dynamics.types import TorqueSignal


@dataclass(frozen=True, kw_only=True)
class JointMotion:
    """One motion: initial joint angles and rates, torques and duration."""

    joint_angles: Numbers  # (n_joint,) [rad], of sliding joints [m]
    joint_rates: Numbers  # (n_joint,) [rad/s], [m/s]
    t_end: float  # [s]
    torque: TorqueSignal | None = None  # None: no torque
    hold: float | None = None  # [s] torque is held, a method starts anew after it; None: each step
    settled: bool = False  # links of a fixed base start as gravity bends them, else straight

    def __post_init__(self) -> None:
        angles = validate.numbers(self.joint_angles, "JointMotion.joint_angles", unit="rad or m")
        rates = validate.numbers(
            self.joint_rates, "JointMotion.joint_rates", len(angles), "rad/s or m/s"
        )
        t_end = validate.positive(self.t_end, "JointMotion.t_end", "s")
        if not angles:
            raise ValueError("JointMotion.joint_angles must hold one angle per joint, got [].")
        if self.torque is not None and not callable(self.torque):
            raise ValueError(
                "JointMotion.torque must be a function of time or None, "
                f"got {validate.shown(self.torque)}."
            )
        jump_times(self.torque)  # raises ValueError if they are no list of times
        validate.boolean(self.settled, "JointMotion.settled")
        if self.hold is not None:
            hold = validate.positive(self.hold, "JointMotion.hold", "s")
            for t in (*self.knots[1:-1], t_end):
                if abs(t / hold - round(t / hold)) > 1e-6:
                    raise ValueError(
                        f"JointMotion.hold ({hold:g} s) must divide the duration and the times at "
                        f"which the torque jumps, got {t:g} s."
                    )
        for name, value in (("joint_angles", angles), ("joint_rates", rates), ("t_end", t_end)):
            object.__setattr__(self, name, value)

    @property
    def knots(self) -> Numbers:
        """Start, torque jumps and end [s]; the torque is smooth between them."""
        jumps = jump_times(self.torque)
        return (0.0, *(t for t in jumps if 0.0 < t < self.t_end), self.t_end)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Motions on which a model of an arm has to be accurate."""

    motions: tuple[JointMotion, ...]
    name: str = ""

    def __post_init__(self) -> None:
        motions = tuple(validate.sequence(self.motions, "Scene.motions"))
        if not motions:
            raise ValueError("Scene.motions must hold at least one motion, got [].")
        for k, motion in enumerate(motions):
            validate.instance(motion, f"Scene.motions[{k}]", JointMotion)
        object.__setattr__(self, "motions", motions)
        object.__setattr__(self, "name", validate.text(self.name, "Scene.name"))

    def check(self, arm: Arm) -> None:
        """Refuse an arm with another number of joints or torques."""
        for k, motion in enumerate(self.motions):
            shapes = {"joint_angles": ((len(motion.joint_angles),), arm.n_joint)}
            if motion.torque is not None:
                shapes["torque"] = (np.shape(motion.torque(0.0)), arm.n_torque)
            for name, (shape, count) in shapes.items():
                if shape != (count,):
                    raise ValueError(
                        f"Scene.motions[{k}].{name} must have shape ({count},), one number "
                        f"per joint of the arm, got {shape}."
                    )


@dataclass(frozen=True, kw_only=True)
class Cycloid:
    """Torques amplitude sin(2 pi t / duration), zero after `duration`: a smooth move and stop."""

    amplitude: Numbers  # (n_joint,) [N m]
    duration: float  # [s]

    def __call__(self, t: float) -> np.ndarray:
        wave = math.sin(2.0 * math.pi * t / self.duration) if t < self.duration else 0.0
        return wave * np.array(self.amplitude)

    @property
    def breakpoints(self) -> Numbers:
        """Time [s] at which the torque ends."""
        return (self.duration,)


def bang_bang(torques: Numbers, pulse: float, t_end: float) -> JointMotion:
    """Straight arm at rest: torques [N m] for `pulse` [s], reversed for `pulse` [s], then zero."""
    pulse = validate.positive(pulse, "pulse", "s")
    torques = validate.numbers(torques, "torques", unit="N m")
    signals = tuple(
        PiecewiseConstant(times=(0.0, pulse, 2.0 * pulse), values=(u, -u, 0.0)) for u in torques
    )
    rest = (0.0,) * len(torques)
    return JointMotion(
        joint_angles=rest, joint_rates=rest, t_end=t_end, torque=Torque(signals=signals)
    )


def cycloid(torques: Numbers, duration: float, t_end: float) -> JointMotion:
    """Straight arm at rest: torques [N m] over one sine wave of `duration` [s], then zero."""
    duration = validate.positive(duration, "duration", "s")
    torques = validate.numbers(torques, "torques", unit="N m")
    rest = (0.0,) * len(torques)
    torque = Cycloid(amplitude=torques, duration=duration)
    return JointMotion(joint_angles=rest, joint_rates=rest, t_end=t_end, torque=torque)


def release(joint_angles: Numbers, t_end: float) -> JointMotion:
    """Motion without torque from rest at `joint_angles` [rad]."""
    joint_angles = validate.numbers(joint_angles, "joint_angles", unit="rad")
    rest = (0.0,) * len(joint_angles)
    return JointMotion(joint_angles=joint_angles, joint_rates=rest, t_end=t_end)
