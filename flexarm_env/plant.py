"""The plant of an environment: arm model, actuators, torque limits, integrator and step."""

import inspect
import math
import warnings
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.description.parameters import with_parameters
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource, load_arm
from dynamics.simulation.statics import held
from dynamics.simulation.validity import LARGEST_RATE, loses_stiffness
from dynamics.types import Array
from flexarm_env import arguments
from flexarm_env.accuracy.certificates import Entry, alike, by_step, covering, entries, fit
from flexarm_env.accuracy.conditions import Conditions
from flexarm_env.compiled.actuation import Actuation, refuse_slopes
from flexarm_env.hardware.actuators import (
    Actuator,
    load_actuators,
    mounted,
    refuse_beside_actuators,
)
from flexarm_env.task.events import EVENTS, met
from flexarm_env.task.scales import (
    DEFLECTION_LIMIT,
    EXTENT,
    MOVE,
    SAFE,
    Scales,
    integration,
    scales,
)

Ranges = Mapping[str, tuple[float, float]]  # of the free parameters that are drawn at a reset
UNLIMITED_RATE = 1e12  # [rad/s] limit of the joint rate where the model has none


class GravityWarning(UserWarning):
    """Gravity keeps some targets of an environment out of its reach."""


@dataclass(frozen=True, kw_only=True)
class Plant:
    """An arm behind its actuators, and the step by which it is integrated."""

    arm: Arm  # the model that is stepped
    scales: Scales  # of this model
    actuation: Actuation | None  # None: ideal torque sources
    torque_limit: Array  # (n_torque,) [N m] torque at action 1
    full_acceleration: float  # [rad/s^2] smallest of the joints' at full torque
    impulse: float  # [N s] at the tip, of a rigid arm that turns by the rate scale about joint 1
    control_dt: float  # [s]
    integrator: str
    substeps: int  # integration steps per control step
    conditions: Conditions
    certificate: dict[str, Any] | None
    uncertified: str | None  # sentence that says why there is no certificate, and the remedy

    @property
    def dt(self) -> float:
        """Integration step [s]."""
        return self.control_dt / self.substeps

    @property
    def rate_scale(self) -> float:
        """Peak joint rate [rad/s] of a bang-bang move by MOVE at full torque."""
        return math.sqrt(self.full_acceleration * MOVE)

    @property
    def move_time(self) -> float:
        """Duration [s] of a bang-bang move by MOVE at full torque."""
        return 2.0 * math.sqrt(MOVE / self.full_acceleration)

    @property
    def rate_limit(self) -> float:
        """Joint rate [rad/s] beyond which linear modes lose much of their stiffness."""
        if not loses_stiffness(self.arm):
            return UNLIMITED_RATE
        return LARGEST_RATE * min(self.scales.locked)


def plan(
    *,
    arm: ArmSource,
    control_dt: float,
    integrator: str | None,
    substeps: int | None,
    torque_limit: float | Sequence[float] | None,
    fidelity: str,
    tolerance: float | None,
    actuator: Any,
    ranges: Ranges,
    deflection_limit: float,
    base_torque: float | None = None,
    event: str | None = None,
) -> Plant:
    """Check the keywords of `core.Core` that concern the plant, and choose what they leave open.

    `ranges` are those of the free parameters that are drawn at a reset.
    """
    described = load_arm(arm)
    actuators = load_actuators(actuator, described.n_joint)
    described = mounted(described, actuators)
    if actuators:
        refuse_beside_actuators(torque_limit=torque_limit, tolerance=tolerance)
    if ranges and tolerance is not None:
        raise ValueError(
            f"tolerance ({validate.shown(tolerance)} m) covers the arm as described, not "
            f"parameters that randomize, hardware or event draws, got {sorted(ranges)}. Leave out "
            "tolerance or what draws them, or choose with dynamics.choose_model for the arm at the "
            "ends of the ranges, and pass the richest choice as arm, integrator and substeps."
        )
    control_dt = arguments.within("control_dt", control_dt, *arguments.CONTROL_DT, "s")
    arguments.check_base(described, base_torque)
    fitted = fit(described, control_dt, fidelity, tolerance)
    own = scales(described)  # torques and tasks do not depend on the fidelity of the model
    holding, inertia = np.array(own.holding), np.array(own.inertia)
    actuation, limit, full = _drive(actuators, fitted.arm, own.torque_limit, torque_limit)
    _refuse_weak("actuator" if actuators else "torque_limit", limit, holding)
    limits = limit if base_torque is None else np.append(limit, base_torque)
    acceleration = float(np.min((full - holding) / inertia))
    impulse = float(inertia[0]) * math.sqrt(acceleration * MOVE) / described.reach
    conditions = Conditions(
        torque_limit=tuple(limits.tolist()),
        deflection_limit=deflection_limit,
        ranges=met(event, ranges),
        actuators=repr(actuators) if actuators else "",
        push=impulse * EVENTS[event].size[1] if event == "push" else 0.0,
        drop=event == "drop",
    )
    measured = [fitted.entry] if fitted.entry else []
    if tolerance is None:  # first what `flexarm certify` measured of a model for `modes: auto`
        measured = entries(fitted.arm, control_dt) + measured
    entry = covering(measured, conditions)
    if event == "push":
        refuse_slopes(integrator, "a push does")
    name, count = _step(
        fitted.arm,
        control_dt,
        fitted.integrator if integrator is None else integrator,
        substeps,
        entry or alike(measured, conditions),
        actuation,
        fastest_drawn(fitted.arm, conditions.ranges)
        if entry is None or integrator is not None
        else fitted.arm,
    )
    uncertified = _uncertified(
        measured, conditions, entry, control_dt, name, count, fidelity, tolerance is not None
    )
    model = fitted.arm
    if base_torque is not None:
        model = replace(model, base=replace(model.base, driven=True))
    return Plant(
        arm=model,
        scales=scales(fitted.arm),
        actuation=actuation,
        torque_limit=limits,
        full_acceleration=acceleration,
        impulse=impulse,
        control_dt=control_dt,
        integrator=name,
        substeps=count,
        conditions=conditions,
        certificate=deepcopy(entry["certificate"]) if entry and not uncertified else None,
        uncertified=uncertified,
    )


KEYWORDS = tuple(name for name in inspect.signature(plan).parameters if name != "ranges")


def planned(given: Mapping[str, Any], ranges: Ranges) -> Plant:
    """Plant of the keywords of `core.Core`, with a warning of what gravity prevents."""
    plant = _of_keywords(given, ranges)
    warn_of_gravity(plant, ranges, given["deflection_limit"])
    return plant


def planned_again(
    given: Mapping[str, Any], ranges: Ranges, integrator: str, substeps: int
) -> Plant:
    """Plant of keywords that have changed, stepped by the compiled `integrator`.

    It has no fewer than `substeps`: episodes that go on have plants of the former ranges.
    """
    plant = planned(given, ranges)
    if plant.integrator != integrator:
        plant = _of_keywords({**given, "integrator": integrator}, ranges)
    if plant.substeps < substeps:
        step = {"integrator": integrator, "substeps": substeps}
        plant = _of_keywords({**given, **step}, ranges)
    return plant


def _of_keywords(given: Mapping[str, Any], ranges: Ranges) -> Plant:
    return plan(**{name: given[name] for name in KEYWORDS}, ranges=ranges)


def _drive(
    actuators: tuple[Actuator, ...],
    arm: Arm,
    usual: tuple[float, ...],
    torque_limit: float | Sequence[float] | None,
) -> tuple[Actuation | None, Array, Array]:
    """Actuation, torque limits (n_joint,) [N m], and what of them an arm of `usual` limits bears.

    A strong motor may exceed that.
    """
    if not actuators:
        limit = arguments.torque_limits(torque_limit, usual)
        return None, limit, limit
    actuation = Actuation(actuators, arm, usual)
    return actuation, actuation.torque_limit, np.minimum(actuation.torque_limit, usual)


def _refuse_weak(name: str, limit: Array, holding: Array) -> None:
    """Refuse torque limits (n_joint,) [N m] that hold no target against gravity."""
    for i in np.flatnonzero(limit <= holding):
        raise ValueError(
            f"{name} of joint {i + 1} must exceed the {holding[i]:.3g} N m that hold it against "
            f"gravity in the postures of the tasks, got {limit[i]:.3g} N m; give more torque, or "
            "an arm that is lighter or without gravity."
        )


def warn_of_gravity(plant: Plant, ranges: Ranges, deflection_limit: float) -> None:
    """Warn where gravity bends links beyond their limit, or a drawn payload is too heavy to hold.

    `ranges` are those of the free parameters that are drawn at a reset.
    """
    if not any(plant.arm.gravity):
        return
    sag = DEFLECTION_LIMIT * plant.scales.sag
    if sag > deflection_limit:
        warnings.warn(
            f"Gravity alone bends a link by {sag:.2g} of its length in postures of the tasks; "
            f"episodes end there as invalid, since deflection_limit is {deflection_limit:g}. Give "
            "a larger deflection_limit, a stiffer or a lighter arm.",
            GravityWarning, stacklevel=5,
        )  # fmt: skip
    mass = ranges.get("payload_mass", (0.0, 0.0))[1]
    needed = held(
        with_parameters(plant.arm, {"payload_mass": mass}), np.array(plant.scales.home), EXTENT
    ).torque
    for i in np.flatnonzero(plant.torque_limit[: needed.size] <= needed):
        warnings.warn(
            f"A payload_mass of {mass:g} kg, which randomize may draw, needs {needed[i]:.3g} N m "
            f"at joint {i + 1} in some targets, but torque_limit is {plant.torque_limit[i]:.3g} "
            "N m; draw lighter payloads, or give more torque.",
            GravityWarning, stacklevel=5,
        )  # fmt: skip


def _uncertified(
    measured: Sequence[Entry],
    conditions: Conditions,
    entry: Entry | None,
    control_dt: float,
    integrator: str,
    substeps: int,
    fidelity: str,
    chosen: bool,
) -> str | None:
    """Sentence that says why no certificate holds, and the remedy; None if that of `entry` does.

    A model `chosen` for a tolerance has none but that of its choice.
    """
    part = conditions.part(Conditions.from_dict(entry["certificate"]["holds"])) if entry else None
    if entry and not part and by_step(entry["certificate"], control_dt, integrator, substeps):
        return None
    measure = f"{'leave out tolerance and ' if chosen else ''}measure them with `flexarm certify`"
    if not measured and fidelity != "auto":
        return (
            f"No certificate holds for fidelity={fidelity!r}: `flexarm certify` measures the model "
            "that an environment has without this keyword."
        )
    if not measured:
        return (
            f"No certificate holds: errors of this arm at a control_dt of {control_dt:g} s were "
            f"never measured; measure them with `flexarm certify ARM --control-dt {control_dt:g}`, "
            "or give a tolerance."
        )
    if entry and not part:
        return (
            "No certificate holds for this integrator and substeps: errors were measured for "
            f"{entry['certificate']['integrator']!r}; leave both out, or {measure}."
        )
    nearest = alike(measured, conditions) or measured[0]
    beyond = conditions.beyond(Conditions.from_dict(nearest["certificate"]["holds"]))
    return (
        f"No certificate holds for {part or beyond}, which errors were not measured with; "
        f"{measure} and the keywords of the environment."
    )


def fastest_drawn(arm: Arm, ranges: Ranges) -> Arm:
    """The stiffest, lightest and most damped of the plants that may be drawn."""
    ends = {name: low if name == "payload_mass" else high for name, (low, high) in ranges.items()}
    return with_parameters(arm, ends)


def _step(
    arm: Arm,
    control_dt: float,
    integrator: str | None,
    substeps: int | None,
    entry: Entry | None,
    actuation: Actuation | None,
    fastest: Arm,
) -> tuple[str, int]:
    """Integrator and substeps: those given, else the measured ones, else those of the rule.

    The rule is for the `fastest` plant that may be drawn; if it is faster than measured steps of
    the arm bear, there are more of them.
    """
    if integrator is not None:
        validate.known(integrator, "integrator", INTEGRATORS)
    if entry is not None and integrator is None:
        best = entry["steps"][0]
        name, count = best["integrator"], best["substeps"]
        bearable = scales(arm).fastest / SAFE or math.inf
        count = math.ceil(count * max(1.0, scales(fastest).fastest / bearable) - 1e-9)
    else:
        name, count = integration(fastest, control_dt, integrator)
    if actuation:
        count = max(count, actuation.substeps(control_dt, name))
    if substeps is not None:
        return name, validate.integer(substeps, "substeps", 1, arguments.MOST_SUBSTEPS)
    if count > arguments.MOST_BY_RULE:
        other = "give another integrator, " if integrator else ""
        raise ValueError(
            f"control_dt ({control_dt:g} s) would take {count} steps of {name!r}, more "
            f"than {arguments.MOST_BY_RULE}, for an arm of {scales(fastest).fastest:.3g} rad/s; "
            f"{other}leave out modes of its stiffest links, take fidelity='rigid', raise "
            "coulomb_speed of its joints if they have friction, or set substeps."
        )
    return name, count
