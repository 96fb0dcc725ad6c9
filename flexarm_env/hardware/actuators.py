"""Actuators from an action to the torque at a joint: the table of types, and presets.

An actuator is a linear law followed by limits. With the action u in [-1, 1], and the rate w and
angle q of the joint,

    x' = A x + B u + E w,    torque = C x + D u - damping w - stiffness q.

The torque is clipped to a torque limit, then its rate of change is limited. `compiled/actuation.py`
compiles the law into the control step. The rotor inertia and friction of a motor are added to those
of the joint.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, ClassVar, Protocol

from dynamics import Arm
from dynamics.description import validate

Vector = tuple[float, ...]
_INCH, _POUND = 0.0254, 4.4482216  # [m], [N]


@dataclass(frozen=True, kw_only=True)
class Law:
    """Law of one joint's actuator, in the symbols of the module's docstring; k states."""

    unit: str  # of the command
    command: float  # at action 1
    A: tuple[Vector, ...] = ()  # (k, k)
    B: Vector = ()  # (k,)
    E: Vector = ()  # (k,)
    C: Vector = ()  # (k,)
    D: float = 0.0  # [N m]
    damping: float = 0.0  # [N m s/rad]
    stiffness: float = 0.0  # [N m/rad]
    torque_limit: float = math.inf  # [N m]
    rate_limit: float = math.inf  # [N m/s]
    rest: Vector = ()  # (k,) states at zero torque, per radian of the joint angle
    stall: float | None = None  # [N m] torque at action 1 and rest; None: it grows with time


class Actuator(Protocol):
    """Interface of the types in ACTUATORS."""

    def law(self, usual: float) -> Law:
        """Return the law; `usual` [N m] is the joint's torque limit with an ideal torque source."""


def _clean(actuator: Any, **units: str) -> None:
    """Check that the named fields are positive or None, and store them as floats."""
    for name, unit in units.items():
        value = getattr(actuator, name)
        if value is not None:
            what = f"actuator {actuator.type}.{name}"
            object.__setattr__(actuator, name, validate.positive(value, what, unit))


@dataclass(frozen=True, kw_only=True)
class Limited:
    """Torque source with a limited rate of change."""

    type: ClassVar = "limited"
    torque_limit: float | None = None  # [N m] at action 1; None: the environment's default
    rate_limit: float | None = None  # [N m/s]

    def __post_init__(self) -> None:
        _clean(self, torque_limit="N m", rate_limit="N m/s")

    def law(self, usual: float) -> Law:
        """torque = D u."""
        most = self.torque_limit or usual
        return Law(
            unit="N m", command=most, D=most, stall=most, rate_limit=self.rate_limit or math.inf
        )


@dataclass(frozen=True, kw_only=True)
class DCMotor:
    """Voltage-driven motor with permanent magnets and a gear.

    L i' = V - R i - k_e N w,   torque = efficiency N k_t i; without `inductance`, L = 0. The
    efficiency is the same when the load drives the motor.
    """

    type: ClassVar = "dc-motor"
    resistance: float  # [ohm]
    torque_constant: float  # [N m/A]
    back_emf: float  # [V s/rad]
    voltage_limit: float  # [V] at action 1
    inductance: float | None = None  # [H]
    gear: float = 1.0  # [-] turns of the motor per turn of the joint
    efficiency: float = 1.0  # [-]
    rotor_inertia: float = 0.0  # [kg m^2] on the motor's shaft; times gear^2 at the joint
    viscous: float = 0.0  # [N m s/rad] friction at the joint, gear included
    coulomb: float = 0.0  # [N m] friction at the joint, gear included
    torque_limit: float | None = None  # [N m] at the joint, on the motor's torque
    rate_limit: float | None = None  # [N m/s] at the joint

    def __post_init__(self) -> None:
        _clean(
            self, resistance="ohm", torque_constant="N m/A", back_emf="V s/rad",
            voltage_limit="V", inductance="H", gear="-", efficiency="-", torque_limit="N m",
            rate_limit="N m/s",
        )  # fmt: skip
        for name, unit in (
            ("rotor_inertia", "kg m^2"), ("viscous", "N m s/rad"), ("coulomb", "N m"),
        ):  # fmt: skip
            value = validate.nonnegative(getattr(self, name), f"actuator {self.type}.{name}", unit)
            object.__setattr__(self, name, value)
        if self.efficiency > 1.0:
            raise ValueError(
                f"actuator dc-motor.efficiency must be at most 1, got {self.efficiency!r}."
            )

    @property
    def no_load_speed(self) -> float:
        """Joint rate [rad/s] at full voltage, without load and friction."""
        return self.voltage_limit / (self.back_emf * self.gear)

    def law(self, usual: float) -> Law:
        """The state is the current; without inductance there is none."""
        per_ampere = self.efficiency * self.gear * self.torque_constant  # [N m/A] at the joint
        free = per_ampere * self.voltage_limit / self.resistance  # [N m] at rest, before the limit
        most = self.torque_limit or math.inf
        result = Law(
            unit="V",
            command=self.voltage_limit,
            torque_limit=most,
            rate_limit=self.rate_limit or math.inf,
            stall=min(free, most),
        )
        if self.inductance is None:
            return replace(result, D=free, damping=free / self.no_load_speed)
        L = self.inductance
        return replace(
            result,
            A=((-self.resistance / L,),),
            B=(self.voltage_limit / L,),
            E=(-self.back_emf * self.gear / L,),
            C=(per_ampere,),
            rest=(0.0,),
        )


@dataclass(frozen=True, kw_only=True)
class Hydraulic:
    """Valve-controlled piston that turns the joint through the spring of its oil.

    Transfer function from valve voltage to piston position as in Yuan, Book and Huggins (1993),
    (7.1): x_p / V = velocity_gain w^2 / [s (s^2 + 2 z w s + w^2)]. The load does not act back on
    the piston. torque = r k (x_p - r q), with the lever arm r and the stiffness k of oil and
    mounting.
    """

    type: ClassVar = "hydraulic"
    natural_frequency: float  # [rad/s] w
    damping: float  # [-] z
    velocity_gain: float  # [m/s per V] of the piston at a steady voltage
    voltage_limit: float  # [V] at action 1
    stiffness: float  # [N/m] k
    lever_arm: float  # [m] r
    torque_limit: float | None = None  # [N m] by relief valves
    rate_limit: float | None = None  # [N m/s]

    def __post_init__(self) -> None:
        _clean(
            self, natural_frequency="rad/s", damping="-", velocity_gain="m/s/V", voltage_limit="V",
            stiffness="N/m", lever_arm="m", torque_limit="N m", rate_limit="N m/s",
        )  # fmt: skip

    def law(self, usual: float) -> Law:
        """The states are the piston position over the lever arm [rad], its rate, acceleration."""
        w = self.natural_frequency
        spring = self.stiffness * self.lever_arm**2
        return Law(
            unit="V",
            command=self.voltage_limit,
            A=((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, -w * w, -2.0 * self.damping * w)),
            B=(0.0, 0.0, w * w * self.velocity_gain * self.voltage_limit / self.lever_arm),
            E=(0.0, 0.0, 0.0),
            C=(spring, 0.0, 0.0),
            stiffness=spring,
            torque_limit=self.torque_limit or math.inf,
            rate_limit=self.rate_limit or math.inf,
            rest=(1.0, 0.0, 0.0),
        )


ACTUATORS: dict[str, Any] = {entry.type: entry for entry in (Limited, DCMotor, Hydraulic)}

_LEVER = 0.5  # [m]
PRESETS: dict[str, Actuator] = {
    # Quanser set-up script config_servo_exp: SRV02 in high gear, +-10 V, 5 A of the amplifier.
    # The arm quanser-rotary-flexible-link has its inertia and friction already.
    "quanser-servo": DCMotor(
        resistance=2.6, torque_constant=7.67e-3, back_emf=7.67e-3, gear=70.0,
        efficiency=0.90 * 0.69, voltage_limit=10.0, torque_limit=0.90 * 0.69 * 70.0 * 7.67e-3 * 5.0,
    ),
    # (7.1a), (7.1b) and hydraulic springs of Yuan, Book and Huggins (1993). A digit of the first
    # damping is illegible in print (0.700 or 0.709). The gains have no unit; inches are assumed, as
    # for the springs. Lever arms and voltages are not in the source: 0.5 m and 10 V are chosen.
    "ralf-1": Hydraulic(
        natural_frequency=math.sqrt(7.509e4), damping=0.700, velocity_gain=0.0695 * _INCH,
        voltage_limit=10.0, stiffness=1.54e3 * _POUND / _INCH, lever_arm=_LEVER,
    ),
    "ralf-2": Hydraulic(
        natural_frequency=math.sqrt(9.869e4), damping=0.770, velocity_gain=0.0342 * _INCH,
        voltage_limit=10.0, stiffness=6.03e3 * _POUND / _INCH, lever_arm=_LEVER,
    ),
}  # fmt: skip


def load_actuators(source: object, n_joint: int) -> tuple[Actuator, ...]:
    """One actuator per joint from a preset's name, a dict, or a list of these; () for None."""
    if source is None:
        return ()
    if isinstance(source, str | Mapping):
        return (_load(source),) * n_joint
    if not isinstance(source, Sequence) or len(source) != n_joint:
        raise ValueError(
            f"actuator must be a name, a dict, or a list of {n_joint} (one per joint), "
            f"got {validate.shown(source)}."
        )
    return tuple(_load(entry) for entry in source)


def _load(source: object) -> Actuator:
    if isinstance(source, str):
        if source not in PRESETS:
            raise ValueError(
                f"Unknown actuator {validate.shown(source)}. Known: {sorted(PRESETS)}; or give a "
                f'dict with a "type" of {sorted(ACTUATORS)}.'
            )
        return PRESETS[source]
    if not isinstance(source, Mapping):
        raise ValueError(f"An actuator must be a name or a dict, got {validate.shown(source)}.")
    kind = validate.choice(source.get("type"), 'actuator["type"]', ACTUATORS)
    known = fields(ACTUATORS[kind])
    data = validate.mapping(source, f"actuator {kind}", ["type", *(f.name for f in known)])
    missing = [f.name for f in known if f.default is MISSING and f.name not in data]
    if missing:
        raise ValueError(f"actuator {kind} needs {missing}; got {sorted(data)}.")
    del data["type"]
    actuator: Actuator = ACTUATORS[kind](**data)
    return actuator


def mounted(arm: Arm, actuators: tuple[Actuator, ...]) -> Arm:
    """The arm with its motors' rotor inertia and friction added to the joints."""
    links = list(arm.links)
    for i, motor in zip(arm.joints, actuators, strict=False):
        if isinstance(motor, DCMotor):
            joint = links[i].joint
            joint = replace(
                joint,
                rotor_inertia=joint.rotor_inertia + motor.gear**2 * motor.rotor_inertia,
                viscous=joint.viscous + motor.viscous,
                coulomb=joint.coulomb + motor.coulomb,
            )
            links[i] = replace(links[i], joint=joint)
    return replace(arm, links=tuple(links))


def refuse_beside_actuators(**keywords: Any) -> None:
    """Raise a ValueError for a keyword that only applies to ideal torque sources."""
    for name, value in keywords.items():
        if value is not None:
            raise ValueError(
                f"{name} ({validate.shown(value)}) is for ideal torque sources; leave it out "
                "beside actuator, which has limits of its own."
            )
