"""Arm description: links on a base, and a payload at the last tip. SI units.

Every description validates itself on construction.
"""

import math
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

import numpy as np

from dynamics.description import parallel_drive, validate
from dynamics.description.carried import tip_loads
from dynamics.description.link import Body, Link, Payload, about_origin
from dynamics.description.mode_rule import AUTO, ModesByRule
from dynamics.description.mode_shapes import BENDING_AXIS
from dynamics.description.rotations import Quaternion, to_rotation_vector
from dynamics.description.validate import ZEROS, clean
from dynamics.types import Matrix3, Vector3

ROTATIONS = {"exp": "exp", "linear": "linear", "skew": "linear"}  # accepted name -> stored name
MOST_LINKS = 1000
MOST_COORDINATES = 1000  # an arm of this size compiles in minutes
IN_LINE = 1.0 - 1e-12  # [-] cosine of the angle between links, from which they are in line
BASE_NAMES = {  # coordinates of a base by its type
    "fixed": (),
    "planar": ("base_px", "base_py", "base_rz"),
    "free": ("base_px", "base_py", "base_pz", "base_rx", "base_ry", "base_rz"),
}

FOURTH_ORDER = "fourth-order"


@dataclass(frozen=True, kw_only=True)
class Base:
    """Base of the first joint: fixed to the ground, or a free-flying rigid body.

    A "planar" base floats in the x-y plane of the world and turns about z, as on an air table; a
    "free" one moves and turns in space. The first joint's offset and rotation, and the base's
    centre of mass and inertia, are given in the base's frame. The description of a base that moves
    includes its initial state.
    """

    type: str = "fixed"  # | "planar" | "free"
    driven: bool = False  # an external torque turns a planar base: the arm's last torque
    mass: float = 0.0  # [kg]
    com: Vector3 = (0.0, 0.0, 0.0)  # [m] centre of mass
    inertia: Matrix3 = ZEROS  # (3, 3) [kg m^2] about the centre of mass
    position: Vector3 = (0.0, 0.0, 0.0)  # [m] origin of the base's frame in the world
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z: from the base's frame to the world
    velocity: Vector3 = (0.0, 0.0, 0.0)  # [m/s] of the origin, in the world
    angular_velocity_body: Vector3 = (0.0, 0.0, 0.0)  # [rad/s] in the base's frame

    def __post_init__(self) -> None:
        kind = validate.choice(self.type, "Base.type", BASE_NAMES)
        values: dict[str, object] = {
            "driven": validate.boolean(self.driven, "Base.driven"),
            "mass": validate.nonnegative(self.mass, "Base.mass", "kg"),
            "com": validate.vector(self.com, "Base.com", "m"),
            "inertia": validate.inertia(self.inertia, "Base.inertia"),
            "position": validate.vector(self.position, "Base.position", "m"),
            "quaternion": validate.quaternion(self.quaternion, "Base.quaternion"),
            "velocity": validate.vector(self.velocity, "Base.velocity", "m/s"),
            "angular_velocity_body": validate.vector(
                self.angular_velocity_body, "Base.angular_velocity_body", "rad/s"
            ),
        }
        clean(self, **values)
        if kind == "free":
            validate.positive(self.mass, "Base.mass", "kg")
            validate.solid(self.inertia, "Base.inertia")
            if self.driven:
                raise ValueError(
                    'Base.driven (True) needs Base.type "planar", got "free"; leave it out.'
                )
            return
        if kind == "planar":
            validate.positive(self.mass, "Base.mass", "kg")
            validate.positive(self.inertia[2][2], "Base.inertia[2][2]", "kg m^2")
            self._check_plane()
            return
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name != "type" and value != entry.default:
                raise ValueError(
                    f"Base.{entry.name} ({value!r}) needs a free base; set type to "
                    f'"{"planar" if entry.name == "driven" else "free"}", or leave it out.'
                )

    def _check_plane(self) -> None:
        """Refuse a start of a planar base outside the x-y plane."""
        outside = {
            "position": self.position[2:],
            "quaternion": self.quaternion[1:3],
            "velocity": self.velocity[2:],
            "angular_velocity_body": self.angular_velocity_body[:2],
        }
        for name, entries in outside.items():
            if any(entries):
                raise ValueError(
                    f"Base.{name} ({getattr(self, name)!r}) must lie in the x-y plane, in which a "
                    'planar base moves; set the other entries to 0, or type to "free".'
                )

    @property
    def n(self) -> int:
        """Number of coordinates: position and attitude."""
        return len(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """(n,) names of the coordinates."""
        return BASE_NAMES[self.type]

    @property
    def spatial(self) -> bool:
        """True if the base turns in space, so that its attitude is a quaternion."""
        return self.type == "free"

    @property
    def q(self) -> tuple[float, ...]:
        """(n,) [m], [rad] initial position and rotation vector."""
        return self._own((*self.position, *to_rotation_vector(self.quaternion)))

    @property
    def v(self) -> tuple[float, ...]:
        """(n,) [m/s], [rad/s] initial velocity in the world, angular velocity in base's frame."""
        return self._own((*self.velocity, *self.angular_velocity_body))

    def _own(self, six: tuple[float, ...]) -> tuple[float, ...]:
        """The entries of six numbers, as of a free base, that are this base's coordinates."""
        every = dict(zip(BASE_NAMES["free"], six, strict=True))
        return tuple(every[name] for name in self.names)


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Serial chain of links on a base."""

    links: tuple[Link, ...]
    name: str = ""
    description: str = ""
    gravity: Vector3 = (0.0, 0.0, 0.0)  # [m/s^2] in the world frame
    rotation: str = "exp"  # of a deflected tip: "exp" is a true rotation, "linear" is 1 + theta~
    # u = -1/2 int (y'^2 + z'^2): fast rotation stiffens links. FOURTH_ORDER: beams and joints bend
    # as the exact beam does, to fourth order of the energy
    foreshortening: bool | str = False
    base: Base = field(default_factory=Base)
    payload: Payload | None = None

    def __post_init__(self) -> None:
        links: tuple[Any, ...] = tuple(validate.sequence(self.links, "Arm.links", MOST_LINKS))
        grounded = not (isinstance(self.base, Base) and self.base.n)
        if not links and grounded:
            raise ValueError("Arm.links must hold at least one link on a fixed base, got [].")
        for i, link in enumerate(links):
            validate.instance(link, f"Arm.links[{i}]", Link)
        if self.payload is not None:
            validate.instance(self.payload, "Arm.payload", Payload)
        loads = tip_loads(links, self.payload)
        links = tuple(link.by_rule(load) for link, load in zip(links, loads, strict=True))
        count = sum(link.n for link in links)
        if count > MOST_COORDINATES:
            raise ValueError(
                f"Arm.links must have at most {MOST_COORDINATES} coordinates (joints, springs, "
                f"modes of every segment), got {count}; use fewer Link.segments or Link.modes."
            )
        if not count and grounded:
            raise ValueError(
                "Arm.links must have a coordinate on a fixed base, got only fixed joints and links "
                'without modes; give Joint.type another than "fixed", or Link.modes.'
            )
        if not (isinstance(self.foreshortening, str) and self.foreshortening == FOURTH_ORDER):
            validate.boolean(self.foreshortening, f"Arm.foreshortening (or {FOURTH_ORDER!r})")
        validate.instance(self.base, "Arm.base", Base)
        clean(
            self,
            links=links,
            name=validate.text(self.name, "Arm.name"),
            description=validate.text(self.description, "Arm.description"),
            gravity=validate.vector(self.gravity, "Arm.gravity", "m/s^2"),
            rotation=ROTATIONS[validate.choice(self.rotation, "Arm.rotation", ROTATIONS)],
        )
        parallel_drive.check(self.links)
        if not links:
            if self.payload is not None:
                raise ValueError(f"Arm.payload ({self.payload!r}) needs a link to be fixed to.")
            return
        self._check_inertia()

    def _check_inertia(self) -> None:
        """Refuse links that move without inertia: the mass matrix would be singular."""
        last = self.links[-1]
        if not _joint_inertia(self.links, self.payload) > 0.0:
            raise ValueError(
                "The last link has no inertia about its joint axis (the mass matrix would be "
                f"singular), got Link.body = {last.body!r}; give mass off the axis or inertia."
            )
        for i, link in enumerate(self.links):
            if link.in_direction("x") and not _twists_inertia(self.links[i:], self.payload):
                which = "The last link" if i == len(self.links) - 1 else f"Link {i + 1}"
                raise ValueError(
                    f"{which} has a torsion mode but no inertia about x, nor has what it carries "
                    "in line (the mass matrix would be singular), got Link.rho_Ip = 0.0 and "
                    "Link.tip_inertia[0][0] = 0.0; give rho_Ip [kg m], of a round bar "
                    "rho_A r^2 / 2, or leave torsion modes out."
                )
            for direction, axis in BENDING_AXIS.items():
                several = link.lumped and len(link.in_direction(direction)) > 1
                if several and not _bends_inertia(self.links[i:], self.payload, axis):
                    raise ValueError(
                        f"Link {i + 1} is lumped and has two modes along {direction!r}, but "
                        "nothing that its tip turns (the mass matrix would be singular), got "
                        f"Link.tip_inertia[{axis}][{axis}] = 0.0; give inertia, one mode, or leave "
                        "lumped out."
                    )

    @property
    def n(self) -> int:
        """Number of coordinates: base, joints, spring deflections and modal amplitudes."""
        return len(self.names)

    @property
    def n_joint(self) -> int:
        """Number of joints that move, one per link unless it is fixed to the link before."""
        return len(self.joints)

    @property
    def joints(self) -> tuple[int, ...]:
        """(n_joint,) index of the link behind each joint that moves."""
        return tuple(i for i, link in enumerate(self.links) if link.joint.moves)

    @property
    def n_torque(self) -> int:
        """Number of torques: those of the joints, then that of a driven base."""
        return self.n_joint + self.base.driven

    @property
    def names(self) -> tuple[str, ...]:
        """Coordinate names: those of the base, then per link "q1", "d1_1", "d1_2", ..., "q2", ...

        In an elastic joint q is the rotor; the spring deflection follows it: "q1", "s1", "d1_1".
        A fixed joint has no q, but an s where it gives.
        """
        names = list(self.base.names)
        for i, link in enumerate(self.links, 1):
            if link.joint.moves:
                names.append(f"q{i}")
            if link.joint.elastic:
                names.append(f"s{i}")
            names += [f"d{i}_{j}" for j in range(1, link.segments * len(link.modes) + 1)]
        return tuple(names)

    @property
    def joint_index(self) -> tuple[int, ...]:
        """(n_joint,) index of each joint coordinate."""
        return tuple(k for k, name in enumerate(self.names) if name.startswith("q"))

    @property
    def reach(self) -> float:
        """Length of the stretched arm with joint offsets [m]."""
        between = (x for link in self.links for x in (link.joint.offset, link.joint.root))
        return sum(link.length for link in self.links) + sum(math.hypot(*x) for x in between)

    @property
    def carried(self) -> tuple[Payload | None, ...]:
        """Payload per link: None except for the last link."""
        return (*len(self.links) * (None,), self.payload)[1:]

    @property
    def automatic(self) -> bool:
        """True if the modes of a link are those of the rule."""
        return any(isinstance(link.modes, ModesByRule) for link in self.links)

    def with_listed_modes(self) -> "Arm":
        """The arm as if the modes that `modes: auto` gives had been listed."""
        return replace(
            self, links=tuple(replace(link, modes=tuple(link.modes)) for link in self.links)
        )

    def to_dict(self) -> dict[str, Any]:
        """Description as plain lists, numbers and text without defaults; `load_arm` reads it."""
        return _plain(self)


def _joint_inertia(links: tuple[Link, ...], payload: Payload | None) -> float:
    """Positive if the last joint moves any inertia [kg m^2], or mass [kg] if prismatic.

    Off-axis mass is not weighted by its squared distance, so only the sign is meaningful. Of links
    fixed to the last that moves, any mass counts.
    """
    moving = [i for i, link in enumerate(links) if link.joint.moves or link.joint.elastic]
    if not moving:
        return 1.0  # nothing turns
    link, fixed = links[moving[-1]], links[moving[-1] + 1 :]
    bodies = [x.body for x in fixed if x.body]
    beyond = sum(x.beam.line_mass.mass + x.tip_mass for x in fixed)
    beyond += sum(x.mass + float(np.trace(about_origin(x))) for x in bodies)
    beyond += payload.mass if fixed and payload is not None else 0.0
    tip_mass, tip_inertia = link.tip_mass, link.tip_inertia[2][2]
    if payload is not None:
        tip_mass = tip_mass + payload.mass
        tip_inertia = tip_inertia + float(about_origin(payload)[2, 2])
    rotor = link.joint.rotor_inertia if link.joint.stiffness is None else 0.0
    body, beam = link.body or Body(mass=0.0), link.beam.line_mass.mass
    if link.joint.type == "prismatic":
        return rotor + beam + body.mass + tip_mass + beyond
    off_axis = beam + tip_mass  # [kg] off the axis if the link has a length
    root = math.hypot(*link.joint.root[:2])
    own = body.inertia[2][2] + body.mass * (math.hypot(*body.com[:2]) + root) + tip_inertia
    return rotor + link.joint.hub_inertia + own + off_axis * (link.length + root) + beyond


def _twists_inertia(links: tuple[Link, ...], payload: Payload | None) -> bool:
    """True if the first of the links, or anything beyond it in the straight arm, resists a twist.

    Links in line have their beams and tip masses on the axis; any other link resists.
    """
    for i, link in enumerate(links):
        joint = link.joint
        aside = any((*joint.offset[1:], *joint.root[1:])) or abs(joint.rotation[0][0]) < IN_LINE
        if i and aside:
            return True
        body = i and link.body is not None and float(about_origin(link.body)[0, 0])
        if link.mean("rho_Ip") or link.tip_inertia[0][0] or body:
            return True
    return payload is not None and float(about_origin(payload)[0, 0]) > 0.0


def _bends_inertia(links: tuple[Link, ...], payload: Payload | None, axis: int) -> bool:
    """True if the tip of the first of the links turns an inertia about its axis y (1) or z (2).

    A joint on that axis turns the next link as well as the tip does, and leaves it the rotor.
    """
    if links[0].tip_inertia[axis][axis]:
        return True
    if len(links) == 1:
        return payload is not None and float(about_origin(payload)[axis, axis]) > 0.0
    joint = links[1].joint
    on_axis = not any(x for k, x in enumerate(joint.offset) if k != axis)
    on_axis = on_axis and abs(joint.rotation[axis][2]) >= IN_LINE and joint.type != "prismatic"
    free = joint.elastic or (joint.moves and joint.rotor_inertia == 0.0)
    return not (joint.parallel or (on_axis and free))


def _plain(value: Any) -> Any:
    """Convert a description to JSON types."""
    if isinstance(value, ModesByRule):
        return AUTO
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if not hasattr(value, "__dataclass_fields__"):
        return value
    data = {
        entry.name: _plain(getattr(value, entry.name))
        for entry in fields(value)
        if getattr(value, entry.name) != _default(entry)
    }
    if isinstance(value, Link) and not value.modes and not value.stiffnesses:
        del data["modes"]  # it cannot bend: nothing to state
    return data


def _default(entry: Any) -> object:
    """Default of a dataclass field; MISSING, which equals no value, if there is none."""
    return entry.default if entry.default_factory is MISSING else entry.default_factory()
