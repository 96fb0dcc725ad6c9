"""The plant of an environment: arm model, actuators, torque limits, integrator and step."""

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource, load_arm
from dynamics.simulation.statics import held, loaded
from dynamics.simulation.validity import LARGEST_RATE
from dynamics.types import Array
from flexarm_env import arguments
from flexarm_env.accuracy.certificates import find, fit, kept
from flexarm_env.compiled.actuation import Actuation
from flexarm_env.hardware.actuators import load_actuators, mounted, refuse_beside_actuators
from flexarm_env.scales import (
    BY_RULE,
    DEFLECTION_LIMIT,
    EXTENT,
    MOVE,
    Scales,
    integration,
    scales,
)

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
    control_dt: float  # [s]
    integrator: str
    substeps: int  # integration steps per control step
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
        if self.arm.foreshortening or not self.scales.locked:
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
    randomized: Collection[str],
    base_torque: float | None = None,
) -> Plant:
    """Check the keywords of `core.Core` that concern the plant, and choose what they leave open.

    `randomized` names the free parameters that are drawn at a reset.
    """
    described = load_arm(arm)
    actuators = load_actuators(actuator, described.n_joint)
    described = mounted(described, actuators)
    if actuators:
        refuse_beside_actuators(torque_limit=torque_limit, tolerance=tolerance)
    if randomized and tolerance is not None:
        raise ValueError(
            f"tolerance ({validate.shown(tolerance)} m) covers the arm as described, not "
            f"parameters drawn by randomize, got {sorted(randomized)}. Leave out one of the two, "
            "or choose with dynamics.choose_model for the arm at the ends of the ranges, and pass "
            "the richest choice as arm, integrator and substeps."
        )
    control_dt = arguments.within("control_dt", control_dt, *arguments.CONTROL_DT, "s")
    arguments.check_base(described, base_torque)
    fitted = fit(described, control_dt, fidelity, tolerance)
    if described.automatic and tolerance is None and (actuators or randomized):
        fitted = replace(fitted, integrator=None, substeps=None)  # measured without these keywords
    own = scales(described)  # torques and tasks do not depend on the fidelity of the model
    holding = np.array(own.holding)
    inertia = np.array(own.inertia)
    if actuators:
        actuation = Actuation(actuators, fitted.arm, own.torque_limit)
        limit = actuation.torque_limit
        full = np.minimum(limit, own.torque_limit)  # a strong motor may exceed what the arm bears
    else:
        actuation = None
        full = limit = arguments.torque_limits(torque_limit, own.torque_limit)
    _refuse_weak("actuator" if actuators else "torque_limit", limit, holding)
    name, count = _step(
        fitted.arm,
        control_dt,
        fitted.integrator if integrator is None else integrator,
        fitted.substeps if substeps is None else substeps,
        actuation,
        randomized,
    )
    if (name, count) == (fitted.integrator, fitted.substeps):
        certificate = fitted.certificate
    else:
        certificate = find(fitted.arm, control_dt, name, count)
    stronger = actuation is None and bool(np.any(limit > np.array(own.torque_limit)))
    uncertified = _uncertified(
        certificate is not None, bool(actuators), randomized, own.torque_limit if stronger else ()
    )
    fitted_arm = fitted.arm
    if base_torque is not None:
        limit = np.append(limit, base_torque)
        fitted_arm = replace(fitted_arm, base=replace(fitted_arm.base, driven=True))
        uncertified = uncertified or (
            "No certificate holds beside base_torque: errors were measured without it; measure a "
            "scene with torques on the base, with dynamics.accuracy.certificate.certify."
        )
    return Plant(
        arm=fitted_arm,
        scales=scales(fitted.arm),
        actuation=actuation,
        torque_limit=limit,
        full_acceleration=float(np.min((full - holding) / inertia)),
        control_dt=control_dt,
        integrator=name,
        substeps=count,
        certificate=None if uncertified else certificate,
        uncertified=uncertified,
    )


def _refuse_weak(name: str, limit: Array, holding: Array) -> None:
    """Refuse torque limits (n_joint,) [N m] that hold no target against gravity."""
    for i in np.flatnonzero(limit <= holding):
        raise ValueError(
            f"{name} of joint {i + 1} must exceed the {holding[i]:.3g} N m that hold it against "
            f"gravity in the postures of the tasks, got {limit[i]:.3g} N m; give more torque, or "
            "an arm that is lighter or without gravity."
        )


def warn_of_gravity(
    plant: Plant, ranges: Mapping[str, tuple[float, float]], deflection_limit: float
) -> None:
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
            GravityWarning, stacklevel=4,
        )  # fmt: skip
    mass = ranges.get("payload_mass", (0.0, 0.0))[1]
    needed = held(loaded(plant.arm, mass), np.array(plant.scales.home), EXTENT).torque
    for i in np.flatnonzero(plant.torque_limit[: needed.size] <= needed):
        warnings.warn(
            f"A payload_mass of {mass:g} kg, which randomize may draw, needs {needed[i]:.3g} N m "
            f"at joint {i + 1} in some targets, but torque_limit is {plant.torque_limit[i]:.3g} "
            "N m; draw lighter payloads, or give more torque.",
            GravityWarning, stacklevel=4,
        )  # fmt: skip


def _uncertified(
    measured: bool, actuated: bool, randomized: Collection[str], exceeded: Sequence[float]
) -> str | None:
    """Sentence that says why no certificate holds for an environment; None if one does.

    `exceeded` [N m] are the torque limits at which errors were measured, if the environment's are
    larger.
    """
    remedy = "with dynamics.accuracy.certificate.certify"
    if actuated:
        return (
            "No certificate holds beside actuator: errors were measured for ideal torque sources; "
            f"measure a scene with the torques that the actuators deliver, {remedy}."
        )
    if randomized:
        return (
            f"No certificate holds for parameters drawn by randomize ({sorted(randomized)}): "
            "errors were measured for the arm as described; measure the arm at both ends of "
            f"each range, {remedy}."
        )
    if exceeded:
        return (
            f"No certificate holds for torques above {', '.join(f'{x:g}' for x in exceeded)} N m, "
            f"at which errors were measured; measure a scene with larger torques {remedy}."
        )
    if not measured:
        return (
            "No certificate holds: errors of this arm, control_dt, integrator and substeps were "
            f"never measured; measure them {remedy}, or give a tolerance."
        )
    return None


def _step(
    arm: Arm,
    control_dt: float,
    integrator: str | None,
    substeps: int | None,
    actuation: Actuation | None,
    randomized: Collection[str],
) -> tuple[str, int]:
    """Integrator and substeps: those given, else the measured ones, else those of the rule."""
    if integrator is not None:
        validate.known(integrator, "integrator", INTEGRATORS)
    entry = kept(arm, control_dt) if integrator is None else None
    if entry is not None:
        usable = (x for x in entry["steps"] if _keeps_error(x["integrator"], actuation, randomized))
        best = next(usable)
        name, count = best["integrator"], best["substeps"]
    else:
        name, count = integration(arm, control_dt, integrator)
    if actuation:
        count = max(count, actuation.substeps(control_dt, name))
    if substeps is not None:
        return name, validate.integer(substeps, "substeps", 1, arguments.MOST_SUBSTEPS)
    if count > arguments.MOST_BY_RULE:
        raise ValueError(
            f"control_dt ({control_dt:g} s) would take {count} steps of {name!r}, more "
            f"than {arguments.MOST_BY_RULE}, for an arm of {scales(arm).fastest:.3g} rad/s; "
            "leave out modes of its stiffest links, take fidelity='rigid', or set substeps."
        )
    return name, count


def _keeps_error(integrator: str, actuation: Actuation | None, randomized: Collection[str]) -> bool:
    """True if a method keeps the error that was measured for the arm without these keywords.

    Behind actuators every substep restarts the method, so a multistep method loses its accuracy.
    Frozen modes belong to the arm as described, not to one with other parameters.
    """
    if actuation:
        return integrator in BY_RULE
    return not randomized or INTEGRATORS[integrator].aid != "modes"
