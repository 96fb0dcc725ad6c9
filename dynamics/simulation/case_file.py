"""Case files: an arm, states at which to evaluate it, and a motion to simulate.

A case is an arm file with any of: `states` [{q, qd, tau}], `initial` {q, qd} with `t_end`, `n_out`
and `torque`. Without `states`, the states under `expected` are taken, so that a reference case
evaluates itself. The whole file is checked before any computation.

The six coordinates of a free base may be left out of q and qd; they then follow from the
description of the base. If given, the rotation in q is a rotation vector from the attitude
`base_quaternion` beside q, or else from the described attitude. The `State` and `Motion` read here
hold the rotation vector from the world, as `Model` takes it.
"""

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.description.arm_file import ARM_KEYS, CASE_KEYS, arm_from_dict
from dynamics.description.data_file import read_mapping
from dynamics.description.rotations import from_rotation_vector, product, to_rotation_vector
from dynamics.types import Array

Numbers = tuple[float, ...]

N_OUT = 101  # default number of output times of a motion, both ends included
MAX_N_OUT = 1_000_001


@dataclass(frozen=True, kw_only=True)
class PiecewiseConstant:
    """A joint torque that jumps to `values[k]` at `times[k]` and is zero before `times[0]`."""

    times: Numbers  # (k,) [s] strictly increasing
    values: Numbers  # (k,) [N m]

    def __call__(self, t: float) -> float:
        k = bisect_right(self.times, t)
        return self.values[k - 1] if k else 0.0


@dataclass(frozen=True, kw_only=True)
class Sine:
    """A joint torque amplitude sin(omega t + phase)."""

    amplitude: float  # [N m]
    omega: float  # [rad/s]
    phase: float  # [rad]

    def __call__(self, t: float) -> float:
        return self.amplitude * math.sin(self.omega * t + self.phase)


@dataclass(frozen=True, kw_only=True)
class Torque:
    """Joint torques over time; a joint without a signal has none."""

    signals: tuple[PiecewiseConstant | Sine | None, ...]  # (n_joint,)

    def __call__(self, t: float) -> Array:
        """Torques (n_joint,) [N m] at time t [s]; at a jump, the value after it."""
        return np.array([0.0 if signal is None else signal(t) for signal in self.signals])

    @property
    def breakpoints(self) -> Numbers:
        """Increasing times [s] of the torque jumps."""
        steps = [signal for signal in self.signals if isinstance(signal, PiecewiseConstant)]
        return tuple(sorted({time for step in steps for time in step.times}))


def jump_times(torque: object) -> Numbers:
    """Increasing times [s] of the jumps that a torque lists in its attribute `breakpoints`."""
    listed = getattr(torque, "breakpoints", ())
    return tuple(sorted(set(validate.numbers(listed, "torque.breakpoints", unit="s"))))


@dataclass(frozen=True, kw_only=True)
class State:
    """A state at which M, h and the accelerations are evaluated."""

    q: Numbers  # (n,) [rad, m]
    qd: Numbers  # (n,) [rad/s, m/s]
    tau: Numbers  # (n_joint,) [N m]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A simulation from an initial state."""

    q: Numbers  # (n,) [rad, m]
    qd: Numbers  # (n,) [rad/s, m/s]
    torque: Torque | None
    t_end: float  # [s]
    n_out: int  # output times, both ends included

    @property
    def times(self) -> Array:
        """(n_out,) [s] equally spaced from zero."""
        return np.linspace(0.0, self.t_end, self.n_out)


@dataclass(frozen=True, kw_only=True)
class Case:
    """An arm, the states to evaluate and the motion to simulate."""

    arm: Arm
    states: tuple[State, ...] = ()
    motion: Motion | None = None
    joint_angles: Numbers  # (n_joint,) [rad] for the natural frequencies


def load_case(path: Path) -> Case:
    """Read a case from a JSON or YAML file."""
    try:
        return case_from_dict(read_mapping(path))
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def case_from_dict(data: Mapping[str, object]) -> Case:
    """Read a case from plain lists, numbers and text; unknown keys are refused."""
    validate.mapping(data, "the case", (*ARM_KEYS, *CASE_KEYS))
    arm = arm_from_dict(data)
    expected = data.get("expected", {})
    if not isinstance(expected, Mapping):
        raise ValueError(f"expected must be a mapping, got {type(expected).__name__}.")
    motion = _motion(data, arm)
    if motion is not None:
        joint_angles = tuple(motion.q[k] for k in arm.joint_index)
    else:
        joint_angles = _expected_angles(expected, arm)
    return Case(
        arm=arm, states=_states(data, expected, arm), motion=motion, joint_angles=joint_angles
    )


def _states(
    data: Mapping[str, object], expected: Mapping[str, object], arm: Arm
) -> tuple[State, ...]:
    own = data.get("states") is not None
    name = "states" if own else "expected.states"
    entries = validate.sequence(data["states"] if own else expected.get("states", []), name)
    return tuple(_state(entry, f"{name}[{k}]", arm, own) for k, entry in enumerate(entries))


def _state(entry: object, name: str, arm: Arm, own: bool) -> State:
    keys = (*_state_keys(arm), "tau")
    if not own and isinstance(entry, Mapping):  # an expected state also holds its results
        entry = {key: entry[key] for key in keys if key in entry}
    values = _required(entry, name, ("q", "qd"), keys)
    q, qd = _coordinates(values, name, arm)
    tau = values.get("tau", [0.0] * arm.n_torque)
    return State(q=q, qd=qd, tau=validate.numbers(tau, f"{name}.tau", arm.n_torque, "N m"))


def _motion(data: Mapping[str, object], arm: Arm) -> Motion | None:
    if data.get("initial") is None:
        for key in ("t_end", "torque"):
            if data.get(key) is not None:
                raise ValueError(f"{key} needs an initial state: give initial {{q, qd}}.")
        return None
    initial = _required(data["initial"], "initial", ("q", "qd"), _state_keys(arm))
    q, qd = _coordinates(initial, "initial", arm)
    if data.get("t_end") is None:
        raise ValueError("t_end is missing: an initial state needs an end time [s].")
    return Motion(
        q=q,
        qd=qd,
        torque=_torque(data["torque"], arm) if data.get("torque") is not None else None,
        t_end=validate.positive(data["t_end"], "t_end", "s"),
        n_out=validate.integer(data.get("n_out", N_OUT), "n_out", 2, MAX_N_OUT),
    )


def _torque(data: object, arm: Arm) -> Torque:
    entries = validate.sequence(data, "torque")
    if len(entries) != arm.n_torque:
        raise ValueError(
            f"torque must have one entry per joint, and one of a driven base ({arm.n_torque}, null "
            f"for none), got {len(entries)}."
        )
    return Torque(signals=tuple(_signal(e, f"torque[{k}]") for k, e in enumerate(entries)))


def _signal(data: object, name: str) -> PiecewiseConstant | Sine | None:
    if data is None:
        return None
    kind = None
    if isinstance(data, Mapping) and "type" in data:
        kind = validate.choice(data["type"], f"{name}.type", ("piecewise-constant", "sine"))
    if kind == "sine":
        values = _required(
            data, name, ("type", "amplitude", "omega"), ("type", "amplitude", "omega", "phase")
        )
        return Sine(
            amplitude=validate.number(values["amplitude"], f"{name}.amplitude", "N m"),
            omega=validate.number(values["omega"], f"{name}.omega", "rad/s"),
            phase=validate.number(values.get("phase", 0.0), f"{name}.phase", "rad"),
        )
    values = _required(data, name, ("type", "t", "v"), ("type", "t", "v"))
    times = validate.numbers(values["t"], f"{name}.t", unit="s")
    torques = validate.numbers(values["v"], f"{name}.v", len(times), "N m")
    if not times:
        raise ValueError(f"{name}.t must hold at least one time, got [].")
    if times[0] < 0.0:
        raise ValueError(f"{name}.t must not be negative, got {times[0]!r} s.")
    for k, (before, after) in enumerate(pairwise(times), 1):
        if not before < after:
            raise ValueError(
                f"{name}.t must increase, got t[{k}] = {after!r} s after {before!r} s."
            )
    return PiecewiseConstant(times=times, values=torques)


def _state_keys(arm: Arm) -> tuple[str, ...]:
    return ("q", "qd", "base_quaternion") if arm.base.spatial else ("q", "qd")


def _coordinates(values: Mapping[str, object], name: str, arm: Arm) -> tuple[Numbers, Numbers]:
    unturned = arm.base.position + (0.0,) * 3 if arm.base.spatial else arm.base.q
    q = _completed(values["q"], unturned, f"{name}.q", arm)
    qd = _completed(values["qd"], arm.base.v, f"{name}.qd", arm)
    if not arm.base.spatial:
        return q, qd
    attitude = arm.base.quaternion
    if "base_quaternion" in values:
        attitude = validate.quaternion(values["base_quaternion"], f"{name}.base_quaternion")
    turned = product(attitude, from_rotation_vector(q[3:6]))
    return (*q[:3], *to_rotation_vector(turned), *q[6:]), qd


def _completed(data: object, base: Numbers, name: str, arm: Arm) -> Numbers:
    """(n,) numbers; `base` supplies the coordinates of a free base that the data leave out."""
    entries = validate.sequence(data, name)
    if len(entries) == arm.n - arm.base.n:
        return base[: arm.base.n] + validate.numbers(entries, name, len(entries))
    return validate.numbers(entries, name, arm.n)


def _expected_angles(expected: Mapping[str, object], arm: Arm) -> Numbers:
    """Joint angles [rad] of the expected frequencies; zero if there are none."""
    frequencies = expected.get("frequencies_rad_s")
    name = "at_joint_angles"
    if not isinstance(frequencies, Mapping) or name not in frequencies:
        return (0.0,) * arm.n_joint
    where = f"expected.frequencies_rad_s.{name}"
    return validate.numbers(frequencies[name], where, arm.n_joint, "rad")


def _required(
    data: object, name: str, required: tuple[str, ...], known: tuple[str, ...]
) -> dict[str, object]:
    """Validate a mapping: all required keys and no unknown one."""
    values = validate.mapping(data, name, known)
    for key in required:
        if key not in values:
            raise ValueError(f"{name}.{key} is missing.")
    return values
