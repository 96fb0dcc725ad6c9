"""Scenario files: an arm, its start, joint torques and a duration in one YAML file.

    title: Two links hanging, one mode
    about: Purpose, and chosen parameters.
    arm: korayem-two-link        # a preset, or an arm file's mapping
    keep: [1, 2]                 # links of the arm, in order; default all
    flexible: {modes: [...]}     # changes of every link with modes
    links: {2: {length: 1.5}}    # changes of single links, numbered after `keep`
    payload: {mass: 1.0}         # replaces the arm's payload
    initial: {q: {q1: -1.57}, qd: {}}   # by coordinate; zero by default
    torque: {type: step, values: {q1: 5.0}}
    t_end: 2.0
    n_out: 401

A torque is a "step" (constant `values`), a "ramp" (`rates` times t) or "nominal": the rigid arm's
inverse dynamics along a cycloid from the initial joint angles to `goal` within `duration`. Units
are SI and radians.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from dynamics import Arm, load_arm
from dynamics.description import validate
from dynamics.description.data_file import read_mapping
from dynamics.formulations.newton_euler import inverse_dynamics
from dynamics.simulation.nominal_motion import Cycloidal, NominalTorque
from dynamics.types import Array

KEYS = (
    "title", "about", "arm", "keep", "flexible", "links", "payload", "initial", "torque", "t_end",
    "n_out",
)  # fmt: skip
TORQUES = {  # type -> keys
    "step": ("values",),
    "ramp": ("rates",),
    "nominal": ("goal", "duration"),
}
N_OUT = 401  # default


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A scenario as read from its file."""

    title: str
    about: str
    arm: Arm
    q: dict[str, float]  # initial values by coordinate [rad, m]; zero if not named
    qd: dict[str, float]  # [rad/s, m/s]
    torque: Callable[[float], Array] | None  # (n_joint,) [N m]
    t_end: float  # [s]
    n_out: int

    @property
    def times(self) -> Array:
        """(n_out,) [s] output times, equally spaced from zero."""
        return np.linspace(0.0, self.t_end, self.n_out)

    def start(self, arm: Arm) -> tuple[Array, Array]:
        """Initial coordinates and rates of the arm or its rigid twin, without a free base's."""
        names = arm.names[arm.base.n :]
        q, qd = (np.array([x.get(name, 0.0) for name in names]) for x in (self.q, self.qd))
        return q, qd


class Nominal:
    """`NominalTorque` traced once, which evaluates more than ten times faster."""

    def __init__(self, nominal: NominalTorque) -> None:
        self.motion, self.breakpoints = nominal.motion, nominal.breakpoints
        x = ca.SX.sym("x", 3 * len(nominal.links))
        torques = inverse_dynamics(
            nominal.links, *(ca.vertsplit(y) for y in ca.vertsplit(x, len(nominal.links))),
            gravity=nominal.gravity,
        )  # fmt: skip
        self._torques = ca.Function("torques", [x], [ca.cse(ca.vertcat(*torques))])

    def __call__(self, t: float) -> Array:
        return np.array(self._torques(np.concatenate(self.motion(t)))).ravel()


def load_scenario(path: Path) -> Scenario:
    """The scenario in a YAML file."""
    try:
        return scenario_from_dict(read_mapping(path))
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def scenario_from_dict(data: Mapping[str, object]) -> Scenario:
    """A scenario from plain lists, numbers and text; unknown keys are refused."""
    values = validate.mapping(data, "the scenario", KEYS)
    for key in ("title", "about", "arm", "t_end"):
        if key not in values:
            raise ValueError(f"{key} is missing.")
    arm = _arm(values)
    initial = validate.mapping(values.get("initial", {}), "initial", ("q", "qd"))
    coordinates = arm.names[arm.base.n :]
    q, qd = (_named(initial.get(key, {}), f"initial.{key}", coordinates) for key in ("q", "qd"))
    return Scenario(
        title=validate.text(values["title"], "title"),
        about=validate.text(values["about"], "about"),
        arm=arm,
        q=q,
        qd=qd,
        torque=None if values.get("torque") is None else _torque(values["torque"], arm, q, qd),
        t_end=validate.positive(values["t_end"], "t_end", "s"),
        n_out=validate.integer(values.get("n_out", N_OUT), "n_out", 2, 100_001),
    )


def _arm(values: Mapping[str, object]) -> Arm:
    """The named or described arm with the file's changes."""
    source = values["arm"]
    if not isinstance(source, str | Mapping):
        raise ValueError(f"arm must be a preset's name or an arm file's mapping, got {source!r}.")
    data = load_arm(source).to_dict()
    links = data.get("links", [])
    kept = validate.sequence(values.get("keep", list(range(1, len(links) + 1))), "keep")
    links = [links[validate.integer(k, "keep", 1, len(links)) - 1] for k in kept]
    flexible = _mapping(values.get("flexible", {}), "flexible")
    links = [merged(link, flexible) if link.get("modes") else link for link in links]
    for number, change in _mapping(values.get("links", {}), "links").items():
        k = validate.integer(number, "a key of links", 1, len(links)) - 1
        links[k] = merged(links[k], _mapping(change, f"links.{number}"))
    if "payload" in values:
        data["payload"] = values["payload"]
    return load_arm(data | {"links": links})


def merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """`old` with the entries of `new`; nested mappings are merged too."""
    result = dict(old)
    for key, value in new.items():
        both = isinstance(value, Mapping) and isinstance(old.get(key), Mapping)
        result[key] = merged(old[key], value) if both else value
    return result


def _mapping(value: object, name: str) -> Mapping[Any, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping of keys to values, got {value!r}.")
    return value


def _named(data: object, name: str, known: tuple[str, ...]) -> dict[str, float]:
    """Numbers by coordinate."""
    values = _mapping(data, name)
    if not known and values:
        raise ValueError(f"{name} must be empty for an arm without joints, got {dict(values)!r}.")
    named = validate.mapping(values, name, known) if known else {}
    return {key: validate.number(value, f"{name}.{key}") for key, value in named.items()}


def _torque(
    data: object, arm: Arm, q: Mapping[str, float], qd: Mapping[str, float]
) -> Callable[[float], Array]:
    """The torque signal of a type in TORQUES."""
    kind = validate.choice(_mapping(data, "torque").get("type"), "torque.type", TORQUES)
    values = validate.mapping(data, "torque", ("type", *TORQUES[kind]))
    for key in TORQUES[kind]:
        if key not in values:
            raise ValueError(f"torque.{key} is missing.")
    joints = tuple(arm.names[k] for k in arm.joint_index)
    if kind == "nominal":
        return _nominal(values, arm, joints, q, qd)
    (key,) = TORQUES[kind]
    named = _named(values[key], f"torque.{key}", joints)
    entries = np.array([named.get(joint, 0.0) for joint in joints])
    return (lambda t: entries) if kind == "step" else (lambda t: entries * t)


def _nominal(
    values: Mapping[str, object],
    arm: Arm,
    joints: tuple[str, ...],
    q: Mapping[str, float],
    qd: Mapping[str, float],
) -> Nominal:
    if arm.base.n or any(qd.values()):
        raise ValueError(
            "torque.type 'nominal' needs a fixed base and a start at rest, got "
            f"base {arm.base.type!r} and initial.qd {dict(qd)!r}; use 'step' or 'ramp'."
        )
    goal = _named(values["goal"], "torque.goal", joints)
    start = tuple(q.get(joint, 0.0) for joint in joints)
    end = tuple(goal.get(joint, begin) for joint, begin in zip(joints, start, strict=True))
    duration = validate.positive(values["duration"], "torque.duration", "s")
    return Nominal(NominalTorque(arm, Cycloidal(start=start, goal=end, duration=duration)))
