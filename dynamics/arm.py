"""What people write: an arm, its links, joints and modes. SI units; a description checks itself."""

import math
from collections import Counter
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

from dynamics import checks, parallel
from dynamics.attitude import Quaternion, to_rotation_vector
from dynamics.checks import ZEROS, Matrix, Vector
from dynamics.joint import Joint
from dynamics.shapes import KINDS, are_independent, shape

__all__ = ["Arm", "Base", "Body", "Joint", "Link", "Mode", "Payload"]

NORMS = ("tip-unit", "mass", "raw")
ROTATIONS = {"exp": "exp", "linear": "linear", "skew": "linear"}  # word in a file -> meaning
# direction of a mode -> what resists it
STIFFNESS = {"x": "GJ", "y": "EIz", "z": "EIy", "axial": "EA"}
MAX_INDEX = 50
MOST_LINKS, MOST_MODES = 1000, 200  # of an arm; of a link
MOST_COORDINATES = 1000  # of an arm: they compile in minutes
BASE_NAMES = ("base_px", "base_py", "base_pz", "base_rx", "base_ry", "base_rz")


def _clean(self: object, **values: object) -> None:
    """Store checked values in a frozen dataclass."""
    for name, value in values.items():
        object.__setattr__(self, name, value)


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One assumed shape s(x) of a link; see `dynamics.shapes` for the kinds."""

    kind: str
    index: int  # 1, 2, ... within its kind
    direction: str  # "y", "z": bending along that axis; "x": torsion; "axial": stretching
    norm: str = "tip-unit"  # s(l) = 1 | "mass": modal mass 1 | "raw": as in the formula

    def __post_init__(self) -> None:
        kind = checks.choice(self.kind, "Mode.kind", KINDS)
        index = checks.integer(self.index, "Mode.index", 1, MAX_INDEX)
        direction = checks.choice(self.direction, "Mode.direction", STIFFNESS)
        checks.choice(self.norm, "Mode.norm", NORMS)
        if direction not in KINDS[kind]:
            raise ValueError(
                f"Mode.direction {direction!r} does not fit kind {kind!r}; "
                f"possible: {list(KINDS[kind])}."
            )
        _clean(self, index=index)


@dataclass(frozen=True, kw_only=True)
class Body:
    """The mass of a rigid link of any form, in the frame of the link."""

    mass: float  # [kg]
    com: Vector = (0.0, 0.0, 0.0)  # [m] centre of mass
    inertia: Matrix = ZEROS  # (3, 3) [kg m^2] about the centre of mass

    def __post_init__(self) -> None:
        _clean(
            self,
            mass=checks.nonnegative(self.mass, "Body.mass", "kg"),
            com=checks.vector(self.com, "Body.com", "m"),
            inertia=checks.inertia(self.inertia, "Body.inertia"),
        )


@dataclass(frozen=True, kw_only=True)
class Link:
    """A slender link behind a joint; flexible if it has modes, rigid if it has none.

    A rigid link may have a `body` instead of a mass per unit length, or both, and with a body the
    length may be zero.
    """

    length: float  # [m] joint axis to tip
    rho_A: float = 0.0  # [kg/m] mass per unit length
    EIz: float | None = None  # [N m^2] flexural rigidity for deflection along y
    EIy: float | None = None  # [N m^2] flexural rigidity for deflection along z
    GJ: float | None = None  # [N m^2] torsional rigidity
    EA: float | None = None  # [N] axial rigidity
    rho_Ip: float = 0.0  # [kg m] polar rotary inertia per unit length
    tip_mass: float = 0.0  # [kg] point mass at the tip
    tip_inertia: Matrix = ZEROS  # (3, 3) [kg m^2] about the tip, in the deformed end frame
    modes: tuple[Mode, ...] = ()
    damping_ratio: float = 0.0  # [-] the same for every bending mode, of a segment's own
    damping_beta: float = 0.0  # [s] damping matrix = beta * stiffness matrix
    segments: int = 1  # equal welded parts, each with all the modes: for large deflections
    joint: Joint = field(default_factory=Joint)
    body: Body | None = None  # of a rigid link

    def __post_init__(self) -> None:
        at_least = checks.positive if self.body is None else checks.nonnegative
        _clean(
            self,
            length=at_least(self.length, "Link.length", "m"),
            rho_A=at_least(self.rho_A, "Link.rho_A", "kg/m"),
            rho_Ip=checks.nonnegative(self.rho_Ip, "Link.rho_Ip", "kg m"),
            tip_mass=checks.nonnegative(self.tip_mass, "Link.tip_mass", "kg"),
            tip_inertia=checks.inertia(self.tip_inertia, "Link.tip_inertia"),
            damping_ratio=checks.nonnegative(self.damping_ratio, "Link.damping_ratio", "-"),
            damping_beta=checks.nonnegative(self.damping_beta, "Link.damping_beta", "s"),
            segments=checks.integer(self.segments, "Link.segments", 1, 1000),
            modes=tuple(checks.sequence(self.modes, "Link.modes", MOST_MODES)),
        )
        for name in STIFFNESS.values():
            value = getattr(self, name)
            if value is not None:
                unit = "N" if name == "EA" else "N m^2"
                _clean(self, **{name: checks.nonnegative(value, f"Link.{name}", unit)})
        if self.segments > 1 and any(mode.kind == "pinned-free" for mode in self.modes):
            raise ValueError(
                f"Link.segments ({self.segments!r}) must be 1 with pinned-free modes: "
                "inner segments are welded at their roots."
            )
        if self.damping_ratio > 0.0 and self.damping_beta > 0.0:
            raise ValueError(
                f"Link.damping_ratio ({self.damping_ratio!r}) and Link.damping_beta "
                f"({self.damping_beta!r}) exclude each other; give one."
            )
        checks.instance(self.joint, "Link.joint", Joint)
        self._check_body()
        self._check_modes()

    def _check_body(self) -> None:
        if self.joint.type == "prismatic" and any(m.kind == "pinned-free" for m in self.modes):
            raise ValueError(
                "Link.modes must not hold pinned-free with a prismatic joint: it would not turn "
                "their root."
            )
        if self.body is None:
            return
        checks.instance(self.body, "Link.body", Body)
        if self.modes or self.segments > 1:
            raise ValueError(
                f"Link.body is for a rigid link in one piece, got {len(self.modes)} modes and "
                f"{self.segments} segments; use rho_A and tip_mass."
            )

    def _check_modes(self) -> None:
        for j, mode in enumerate(self.modes):
            checks.instance(mode, f"Link.modes[{j}]", Mode)
            stiffness = getattr(self, STIFFNESS[mode.direction])
            if stiffness is None or not stiffness > 0.0:
                raise ValueError(
                    f"Link.{STIFFNESS[mode.direction]} must be positive for the mode along "
                    f"{mode.direction!r} ({mode.kind} {mode.index}), got {stiffness!r}. "
                    f"Unit: [{'N' if mode.direction == 'axial' else 'N m^2'}]."
                )
        repeated = Counter((mode.kind, mode.index, mode.direction) for mode in self.modes)
        for (kind, index, direction), count in repeated.items():
            if count > 1:
                raise ValueError(
                    f"Link.modes holds {kind} {index} along {direction!r} {count} times; "
                    "list each mode once."
                )
        torsion = self.in_direction("x")
        if len(torsion) > 1 and self.rho_Ip == 0.0:
            raise ValueError(
                f"Link.rho_Ip must be positive for {len(torsion)} torsion modes, got 0.0: "
                "a tip inertia alone carries only one."
            )
        polar = self.rho_Ip + self.tip_inertia[0][0]
        if polar == 0.0 and any(mode.norm == "mass" for mode in torsion):
            raise ValueError(
                "Mode.norm 'mass' of a torsion mode needs Link.rho_Ip or Link.tip_inertia about x, "
                'got 0.0 for both; use "tip-unit".'
            )
        for mode in self.modes:
            shape(mode, self)  # refuses what it cannot shape
        for direction in STIFFNESS:
            modes = self.in_direction(direction)
            if not are_independent(modes, self):
                named = [f"{mode.kind} {mode.index}" for mode in modes]
                raise ValueError(
                    f"Link.modes along {direction!r} are linearly dependent ({', '.join(named)}); "
                    "leave out the shape that repeats another."
                )

    def in_direction(self, direction: str) -> tuple[Mode, ...]:
        """The link's modes along "x" (torsion), "y" or "z" (bending), or "axial"."""
        return tuple(mode for mode in self.modes if mode.direction == direction)


@dataclass(frozen=True, kw_only=True)
class Payload:
    """A rigid body held at the last link's tip; it joins that link's tip mass and inertia.

    It does not change the assumed shapes, so one arm can carry many payloads.
    """

    mass: float  # [kg]
    inertia: Matrix = ZEROS  # (3, 3) [kg m^2] about the tip, in the deformed end frame

    def __post_init__(self) -> None:
        _clean(
            self,
            mass=checks.nonnegative(self.mass, "Payload.mass", "kg"),
            inertia=checks.inertia(self.inertia, "Payload.inertia"),
        )


@dataclass(frozen=True, kw_only=True)
class Base:
    """What the first joint stands on: the ground, or a rigid body that flies freely.

    A free base has its own frame: the first joint's offset and rotation, centre of mass and
    inertia are given in it. Where it starts is part of the description.
    """

    type: str = "fixed"  # | "free"
    mass: float = 0.0  # [kg]
    com: Vector = (0.0, 0.0, 0.0)  # [m] centre of mass
    inertia: Matrix = ZEROS  # (3, 3) [kg m^2] about the centre of mass
    position: Vector = (0.0, 0.0, 0.0)  # [m] of the frame's origin in the world
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z: from the frame to the world
    velocity: Vector = (0.0, 0.0, 0.0)  # [m/s] of the origin in the world
    angular_velocity_body: Vector = (0.0, 0.0, 0.0)  # [rad/s] in the frame

    def __post_init__(self) -> None:
        kind = checks.choice(self.type, "Base.type", ("fixed", "free"))
        values: dict[str, object] = {
            "mass": checks.nonnegative(self.mass, "Base.mass", "kg"),
            "com": checks.vector(self.com, "Base.com", "m"),
            "inertia": checks.inertia(self.inertia, "Base.inertia"),
            "position": checks.vector(self.position, "Base.position", "m"),
            "quaternion": checks.quaternion(self.quaternion, "Base.quaternion"),
            "velocity": checks.vector(self.velocity, "Base.velocity", "m/s"),
            "angular_velocity_body": checks.vector(
                self.angular_velocity_body, "Base.angular_velocity_body", "rad/s"
            ),
        }
        _clean(self, **values)
        if kind == "free":
            checks.positive(self.mass, "Base.mass", "kg")
            checks.solid(self.inertia, "Base.inertia")
            return
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name != "type" and value != entry.default:
                raise ValueError(
                    f'Base.{entry.name} ({value!r}) is of a free base; give type "free", or '
                    "leave it out."
                )

    @property
    def n(self) -> int:
        """Number of coordinates: position and attitude."""
        return len(BASE_NAMES) if self.type == "free" else 0

    @property
    def q(self) -> tuple[float, ...]:
        """(n,) [m], [rad] position and rotation vector at the start."""
        return (*self.position, *to_rotation_vector(self.quaternion))[: self.n]

    @property
    def v(self) -> tuple[float, ...]:
        """(n,) [m/s], [rad/s] velocity in the world, angular velocity in the base's own frame."""
        return (*self.velocity, *self.angular_velocity_body)[: self.n]


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A serial chain of links on a base."""

    links: tuple[Link, ...]
    name: str = ""
    description: str = ""
    gravity: Vector = (0.0, 0.0, 0.0)  # [m/s^2] in the world frame
    rotation: str = "exp"  # of a bent end: "exp" is a true rotation, "linear" is 1 + theta~
    foreshortening: bool = False  # u = -1/2 int (y'^2 + z'^2): fast spins stiffen
    base: Base = field(default_factory=Base)
    payload: Payload | None = None

    def __post_init__(self) -> None:
        links: tuple[Any, ...] = tuple(checks.sequence(self.links, "Arm.links", MOST_LINKS))
        if not links and not (isinstance(self.base, Base) and self.base.n):
            raise ValueError("Arm.links must hold at least one link on a fixed base, got [].")
        for i, link in enumerate(links):
            checks.instance(link, f"Arm.links[{i}]", Link)
        count = sum(1 + link.joint.elastic + link.segments * len(link.modes) for link in links)
        if count > MOST_COORDINATES:
            raise ValueError(
                f"Arm.links must have at most {MOST_COORDINATES} coordinates (joints, springs, "
                f"modes of every segment), got {count}; use fewer Link.segments or Link.modes."
            )
        checks.boolean(self.foreshortening, "Arm.foreshortening")
        checks.instance(self.base, "Arm.base", Base)
        if self.payload is not None:
            checks.instance(self.payload, "Arm.payload", Payload)
        _clean(
            self,
            links=links,
            name=checks.text(self.name, "Arm.name"),
            description=checks.text(self.description, "Arm.description"),
            gravity=checks.vector(self.gravity, "Arm.gravity", "m/s^2"),
            rotation=ROTATIONS[checks.choice(self.rotation, "Arm.rotation", ROTATIONS)],
        )
        parallel.check(self.links)
        if not links:
            if self.payload is not None:
                raise ValueError(f"Arm.payload ({self.payload!r}) needs a link that holds it.")
            return
        last = self.links[-1]
        if not _moved(last, self.payload) > 0.0:
            raise ValueError(
                "The last link has no inertia that its joint could move (the mass matrix would be "
                f"singular), got Link.body = {last.body!r}; give mass off the axis or inertia."
            )
        polar = last.rho_Ip + last.tip_inertia[0][0]
        polar += self.payload.inertia[0][0] if self.payload else 0.0
        if last.in_direction("x") and polar == 0.0:
            raise ValueError(
                "The last link has a torsion mode but no inertia about x (the mass matrix would be "
                "singular), got Link.rho_Ip = 0.0 and Link.tip_inertia[0][0] = 0.0; give one."
            )

    @property
    def n(self) -> int:
        """Number of coordinates: base, joint angles, twists of joint springs, modal amplitudes."""
        return len(self.names)

    @property
    def n_joint(self) -> int:
        """Number of joints, one per link."""
        return len(self.links)

    @property
    def names(self) -> tuple[str, ...]:
        """A free base's six, then link by link, inside out: "q1", "d1_1", "d1_2", ..., "q2", ...

        q is the rotor of an elastic joint; the twist of its spring follows it: "q1", "s1", "d1_1".
        """
        return BASE_NAMES[: self.base.n] + tuple(
            name
            for i, link in enumerate(self.links, 1)
            for modes in [range(1, link.segments * len(link.modes) + 1)]
            for twist in [() if not link.joint.elastic else (f"s{i}",)]
            for name in (f"q{i}", *twist, *(f"d{i}_{j}" for j in modes))
        )

    @property
    def joint_index(self) -> tuple[int, ...]:
        """(n_joint,) place of each joint angle among the coordinates."""
        return tuple(k for k, name in enumerate(self.names) if name.startswith("q"))

    @property
    def reach(self) -> float:
        """Length of the stretched arm, joint offsets included [m]."""
        return sum(link.length + math.hypot(*link.joint.offset) for link in self.links)

    @property
    def carried(self) -> tuple[Payload | None, ...]:
        """(n_joint,) what each link carries beyond its own tip mass: the last one the payload."""
        return (*len(self.links) * (None,), self.payload)[1:]

    def to_dict(self) -> dict[str, Any]:
        """The arm as plain lists, numbers and text, defaults left out; `load_arm` reads it back."""
        return _plain(self)


def _moved(link: Link, payload: Payload | None) -> float:
    """Inertia about the joint axis, or mass, that a last link's joint moves [kg m^2 or kg]."""
    tip_mass, tip_inertia = link.tip_mass, link.tip_inertia[2][2]
    if payload is not None:
        tip_mass, tip_inertia = tip_mass + payload.mass, tip_inertia + payload.inertia[2][2]
    rotor = link.joint.rotor_inertia if link.joint.stiffness is None else 0.0
    body = link.body or Body(mass=0.0)
    if link.joint.type == "prismatic":
        return rotor + link.rho_A * link.length + body.mass + tip_mass
    turned = link.rho_A * link.length + tip_mass  # at a distance, if the link has a length
    own = body.inertia[2][2] + body.mass * math.hypot(*body.com[:2]) + tip_inertia
    return rotor + link.joint.hub_inertia + own + turned * link.length


def _plain(value: Any) -> Any:
    """A description as JSON would hold it."""
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if not hasattr(value, "__dataclass_fields__"):
        return value
    return {
        entry.name: _plain(getattr(value, entry.name))
        for entry in fields(value)
        if getattr(value, entry.name) != _default(entry)
    }


def _default(entry: Any) -> object:
    """Default of a dataclass field; MISSING equals no value."""
    return entry.default if entry.default_factory is MISSING else entry.default_factory()
