"""Observation layouts: signals, their order, units and bounds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.types import Array
from flexarm_env.task.scales import MOVE, Scales
from flexarm_env.task.tasks import Task

BOUND = 10.0  # [-] scaled elements are clipped to [-BOUND, BOUND]
MODES = ("state", "sensors", "goal")
GOALS = ("achieved_goal", "desired_goal")  # the last parts of a goal-conditioned observation
TIP_ERROR = "target minus tip, along the axes of the undeformed first link"
BASE_POSITION = "position of the base in the world, from the described one"
TARGET = "target, from a floating base and along its axes"
CURVATURE = "curvature at the root of a link, as a strain gauge measures it"
ACCELERATION = (
    "acceleration of the tip minus gravity, mean over the control step, along the axes of the last "
    "link's bent tip, as an accelerometer measures it"
)


def observation_mode(obs: str | None, sensing: bool) -> str:
    """One of MODES: as asked for, else "sensors" with imperfect hardware and "state" without."""
    return ("sensors" if sensing else "state") if obs is None else obs


@dataclass(frozen=True)
class Part:
    """Consecutive elements of an observation with one name."""

    name: str
    meaning: str
    unit: str
    entries: tuple[int, ...]  # indices into the signal of this name in compiled/signals.py
    scale: tuple[float, ...]  # physical quantity = observation * scale
    bound: float = BOUND


@dataclass(frozen=True)
class Layout:
    """Parts of an observation, in order."""

    parts: tuple[Part, ...]

    @cached_property
    def size(self) -> int:
        """Number of elements."""
        return self.bounds.size

    @property
    def factors(self) -> Array:
        """(n,) factors: observation = physical quantity * factor, then clipped."""
        return np.array([1.0 / scale for part in self.parts for scale in part.scale])

    @property
    def bounds(self) -> Array:
        """(n,) largest magnitude of each element."""
        return np.array([part.bound for part in self.parts for _ in part.scale])

    @property
    def slices(self) -> dict[str, slice]:
        """Slice of each part, by name."""
        stops = np.cumsum([len(part.entries) for part in self.parts]).tolist()
        return {
            part.name: slice(stop - len(part.entries), stop)
            for part, stop in zip(self.parts, stops, strict=True)
        }

    @cached_property
    def goal(self) -> int:
        """Number of elements of a goal; 0 without goals."""
        return next((len(part.entries) for part in self.parts if part.name in GOALS), 0)

    def observed(self, elements: Any) -> Any:
        """Observation of elements (..., size): the array itself, or a dict of views with goals."""
        if not self.goal:
            return elements
        first, second = self.size - 2 * self.goal, self.size - self.goal
        return {
            "observation": elements[..., :first],
            "achieved_goal": elements[..., first:second],
            "desired_goal": elements[..., second:],
        }

    @property
    def scales(self) -> dict[str, Array]:
        """Factors from observation to physical units, by part."""
        return {part.name: np.array(part.scale) for part in self.parts}


def curvature_columns(arm: Arm) -> tuple[int, ...]:
    """Columns of the model's "curvature" that are not always zero: one per strain gauge.

    Pinned-free shapes are straight at the root, where their gauge would read nothing.
    """
    return tuple(
        2 * i + k
        for i, link in enumerate(arm.links)
        for k, direction in enumerate("yz")
        if any(mode.kind != "pinned-free" for mode in link.in_direction(direction))
    )


def is_planar(arm: Arm) -> bool:
    """True if every point of the arm moves across its first joint's axis, along or against z.

    On a floating base that is also the plane in which the base moves.
    """
    turned = arm.links if arm.base.n else arm.links[1:]  # against what carries them
    parallel = all(abs(link.joint.rotation[2][2]) == 1.0 for link in turned)
    across = all(mode.direction in ("y", "axial") for link in arm.links for mode in link.modes)
    return parallel and across


def is_level(arm: Arm) -> bool:
    """True if every point of the arm moves along the x-y plane of the world."""
    return is_planar(arm) and abs(arm.links[0].joint.rotation[2][2]) == 1.0


def observation_layout(
    arm: Arm, task: Task, kind: str, scales: Scales, rate: float, torques: tuple[float, ...] = (),
    accelerometer: bool = False,
) -> Layout:  # fmt: skip
    """Observation layout of an arm with a task.

    `rate` [rad/s] is the rate scale. `torques` [N m] scale the joint torques; if empty, joint
    torques are not observed. `accelerometer` adds the acceleration of the tip to "sensors". Of a
    goal-conditioned observation only "desired_goal" depends on the target.
    """
    validate.choice(kind, "obs", MODES)
    if kind == "goal":
        return _goal_layout(arm, task, scales, rate, torques)
    joints, columns = range(arm.n_joint), curvature_columns(arm)
    modal, actions = _modal(arm), range(arm.n_torque)
    axes = [k for k in range(3) if (k or arm.n_joint > 1) and (k != 2 or not is_planar(arm))]
    # the first joint's angle matters only under gravity, or where what carries the joint can move
    turned = joints if any(arm.gravity) or arm.joint_index[0] else joints[1:]
    every = [
        _part("joint_error", "joint angle minus target joint angle", "rad", joints, MOVE),
        _part("joint_sin", "sine of the joint angle", "-", turned, 1.0, 1.0),
        _part("joint_cos", "cosine of the joint angle", "-", turned, 1.0, 1.0),
        _part("joint_rate", "joint rate", "rad/s", joints, rate),
        *_base(arm, scales, rate),
    ]
    if kind == "state":
        every += [
            _part("modal_amplitude", "modal amplitude", "m", modal, scales.modal_scale),
            _part("modal_rate", "modal rate", "m/s", modal, scales.modal_rate),
            _part("tip_error", TIP_ERROR, "m", axes, MOVE * arm.reach),
        ]
    else:
        scale = curvature_scale(arm, columns)
        every.append(_part("root_curvature", CURVATURE, "1/m", columns, scale))
        felt = sensed_axes(arm) if accelerometer else ()
        most = acceleration_scale(arm, scales, rate)
        every.append(_part("tip_acceleration", ACCELERATION, "m/s^2", felt, most))
        plane = range(2 if arm.base.n else 0)  # joint angles alone do not place the tip
        every.append(_part("target_position", TARGET, "m", plane, arm.reach))
    if task.moving:
        ahead = "target joint angle {} move time ahead, minus the present one"
        every += [
            _part("target_rate", "rate of the target joint angle", "rad/s", joints, rate),
            _part("target_near", ahead.format("half a"), "rad", joints, MOVE),
            _part("target_far", ahead.format("one"), "rad", joints, MOVE),
        ]
    sensed = joints if torques else ()
    every.append(_part("joint_torque", "torque at the joint", "N m", sensed, torques))
    every.append(_part("last_action", "action of the last step", "-", actions, 1.0, 1.0))
    return Layout(tuple(part for part in every if part.entries))


def _goal_layout(
    arm: Arm, task: Task, scales: Scales, rate: float, torques: tuple[float, ...]
) -> Layout:
    if task.moving:
        raise ValueError(f"obs must be 'state' or 'sensors' where the target moves ({task.title}).")
    joints, axes = range(arm.n_joint), range(2 if is_level(arm) else 3)
    modal, actions = _modal(arm), range(arm.n_torque)
    every = (
        _part("joint_sin", "sine of the joint angle", "-", joints, 1.0, 1.0),
        _part("joint_cos", "cosine of the joint angle", "-", joints, 1.0, 1.0),
        _part("joint_rate", "joint rate", "rad/s", joints, rate),
        *_base(arm, scales, rate),
        _part("modal_amplitude", "modal amplitude", "m", modal, scales.modal_scale),
        _part("modal_rate", "modal rate", "m/s", modal, scales.modal_rate),
        _part("joint_torque", "torque at the joint", "N m", joints if torques else (), torques),
        _part("last_action", "action of the last step", "-", actions, 1.0, 1.0),
        _part("achieved_goal", "position of the tip", "m", axes, arm.reach),
        _part("desired_goal", "position of the target", "m", axes, arm.reach),
    )
    return Layout(tuple(part for part in every if part.entries))


def _modal(arm: Arm) -> list[int]:
    """Coordinates that are neither joints nor of a floating base."""
    return [i for i in range(arm.base.n, arm.n) if i not in arm.joint_index]


def _base(arm: Arm, scales: Scales, rate: float) -> tuple[Part, ...]:
    """Pose and rates of a floating base, in the world."""
    if not scales.base:
        return ()
    (travel, turn), plane, angle = scales.base, range(2), range(1)
    return (
        _part("base_position", BASE_POSITION, "m", plane, 0.1 * arm.reach),
        _part("base_sin", "sine of the base's angle", "-", angle, 1.0, 1.0),
        _part("base_cos", "cosine of the base's angle", "-", angle, 1.0, 1.0),
        _part("base_velocity", "velocity of the base", "m/s", plane, rate * travel),
        _part("base_rate", "angular rate of the base", "rad/s", angle, rate * turn),
    )


def _part(
    name: str,
    meaning: str,
    unit: str,
    entries: Sequence[int],
    scale: float | tuple[float, ...],
    bound: float = BOUND,
) -> Part:
    scales = scale if isinstance(scale, tuple) else (scale,) * len(entries)
    return Part(name, meaning, unit, tuple(entries), scales, bound)


def curvature_scale(arm: Arm, columns: tuple[int, ...]) -> tuple[float, ...]:
    """[1/m] root curvature under a tip force that deflects the link by 10 % of its length."""
    bent = [(arm.links[c // 2], "yz"[c % 2]) for c in columns]
    return tuple(link.root_curvature(direction) * 0.1 / link.length for link, direction in bent)


def sensed_axes(arm: Arm) -> tuple[int, ...]:
    """Axes of the tip along which an accelerometer reads: those in which the arm can move."""
    return (0, 1) if is_planar(arm) else (0, 1, 2)


def acceleration_scale(arm: Arm, scales: Scales, rate: float) -> float:
    """[m/s^2] full joint acceleration times reach, plus vibration at 10 % deflection, plus gravity.

    The longest link vibrates at the first locked frequency.
    """
    vibration = 0.1 * max(link.length for link in arm.links) * min(scales.locked, default=0.0) ** 2
    return arm.reach * rate * rate / MOVE + vibration + math.hypot(*arm.gravity)
