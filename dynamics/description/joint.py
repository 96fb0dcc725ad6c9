"""The joint at the root of a link."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real

from dynamics.description import validate
from dynamics.description.rotations import from_euler, from_rotation_vector, rotation_matrix
from dynamics.description.validate import IDENTITY
from dynamics.types import Matrix3, Vector3

TYPES = ("revolute", "prismatic", "fixed")
MOVING = ("rotor_inertia", "hub_inertia", "viscous", "coulomb", "parallel")


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Joint that turns about its local z axis (revolute), slides along it (prismatic) or is fixed.

    A fixed joint welds the link to the tip before, at any angle; it has neither coordinate nor
    torque. With a stiffness it is a clamp that gives: the link turns about z against the spring.

    Units are those of a revolute joint. For a prismatic joint q is a length [m], rotor_inertia a
    mass [kg], and the other units are [N s/m], [N], [m/s], [N/m].

    With `parallel`, a massless parallelogram along the link before grounds this joint's drive on
    the base of the joint before. q is measured from that base, independent of the rotation of the
    joint before and of the bending of the link before, and the torque reacts on that base; see
    parallel_drive.py.

    A rotation is stored as a matrix. It may be given as {"rpy": (roll, pitch, yaw)}, turns [rad]
    about the fixed axes x, y and z in this order, as in URDF, or as {"axis": (x, y, z), "angle": a}
    [rad].
    """

    rotation: Matrix3 = IDENTITY  # (3, 3) [-] joint frame at q = 0 to end frame of the link before
    offset: Vector3 = (0.0, 0.0, 0.0)  # [m] from that link's tip to the joint, in its end frame
    root: Vector3 = (0.0, 0.0, 0.0)  # [m] from the joint to the link's root, in the link's frame
    rotor_inertia: float = 0.0  # [kg m^2] acts on the joint rate, relative to the joint's base
    hub_inertia: float = 0.0  # [kg m^2] about z; acts on the absolute rate of the link's root
    viscous: float = 0.0  # [N m s/rad] friction
    coulomb: float = 0.0  # [N m] friction torque, times tanh(rate / coulomb_speed)
    coulomb_speed: float = 0.05  # [rad/s]
    type: str = "revolute"  # | "prismatic" | "fixed"
    # [N m/rad] of a spring between rotor, or what the joint is fixed to, and link; None: no spring
    stiffness: float | None = None
    spring_damping: float = 0.0  # [N m s/rad] damper parallel to that spring
    parallel: bool = False  # driven through a parallelogram along the link before

    def __post_init__(self) -> None:
        positive, nonnegative = validate.positive, validate.nonnegative
        cleaned = {
            "rotation": _matrix(self.rotation, "Joint.rotation"),
            "offset": validate.vector(self.offset, "Joint.offset", "m"),
            "root": validate.vector(self.root, "Joint.root", "m"),
            "rotor_inertia": nonnegative(self.rotor_inertia, "Joint.rotor_inertia", "kg m^2"),
            "hub_inertia": nonnegative(self.hub_inertia, "Joint.hub_inertia", "kg m^2"),
            "viscous": nonnegative(self.viscous, "Joint.viscous", "N m s/rad"),
            "coulomb": nonnegative(self.coulomb, "Joint.coulomb", "N m"),
            "coulomb_speed": positive(self.coulomb_speed, "Joint.coulomb_speed", "rad/s"),
            "type": validate.choice(self.type, "Joint.type", TYPES),
            "spring_damping": nonnegative(self.spring_damping, "Joint.spring_damping", "N m s/rad"),
        }
        if self.stiffness is not None:
            cleaned["stiffness"] = positive(self.stiffness, "Joint.stiffness", "N m/rad")
        for name, value in cleaned.items():
            object.__setattr__(self, name, value)
        validate.boolean(self.parallel, "Joint.parallel")
        self._check_spring()
        if not self.moves:
            self._check_fixed()

    def _check_spring(self) -> None:
        if self.stiffness is None and self.spring_damping > 0.0:
            raise ValueError(
                f"Joint.spring_damping ({self.spring_damping!r}) needs a spring; "
                "give Joint.stiffness."
            )
        if self.stiffness is not None and self.rotor_inertia == 0.0 and self.moves:
            raise ValueError(
                f"Joint.rotor_inertia must be positive with Joint.stiffness ({self.stiffness!r}), "
                "got 0.0: the rotor is a separate body in front of the spring. A clamp that gives "
                'has no rotor: type "fixed".'
            )

    def _check_fixed(self) -> None:
        for name in MOVING:
            if getattr(self, name):
                raise ValueError(
                    f"Joint.{name} ({getattr(self, name)!r}) needs a joint that moves, got type "
                    f'"fixed"; leave {name} out, or give another type.'
                )

    @property
    def moves(self) -> bool:
        """True if the joint has a coordinate and a torque: it is not fixed."""
        return self.type != "fixed"

    @property
    def welds(self) -> bool:
        """True if the joint lets the link neither move nor give."""
        return not (self.moves or self.elastic)

    @property
    def elastic(self) -> bool:
        """True if there is a spring in front of the link."""
        return self.stiffness is not None


def _matrix(value: object, name: str) -> Matrix3:
    """(3, 3) rotation matrix from a matrix, angles, or an axis and an angle."""
    if isinstance(value, Mapping):
        return _turned(value, name)
    entries = list(value) if isinstance(value, list | tuple) else []
    if len(entries) == 3 and all(isinstance(x, Real) for x in entries):
        shown = ", ".join(f"{x:g}" for x in entries)
        raise ValueError(
            f"{name} must be a matrix of 3 rows, got three numbers; write {{rpy: [{shown}]}} if "
            "they are roll, pitch and yaw [rad], or {axis: [x, y, z], angle: a} for a turn [rad] "
            "about an axis."
        )
    return validate.rotation(value, name)


def _turned(value: Mapping[object, object], name: str) -> Matrix3:
    given = validate.mapping(value, name, ("rpy", "axis", "angle"))
    if set(given) == {"rpy"}:
        roll, pitch, yaw = validate.vector(given["rpy"], f"{name}.rpy", "rad")
        validate.radians((roll, pitch, yaw), f"{name}.rpy")
        turn = from_euler((yaw, pitch, roll))
    elif set(given) == {"axis", "angle"}:
        axis = validate.vector(given["axis"], f"{name}.axis", "-")
        length = math.hypot(*axis)
        if not length > 0.0:
            raise ValueError(f"{name}.axis must have a direction, got {validate.shown(axis)}.")
        angle = validate.number(given["angle"], f"{name}.angle", "rad")
        validate.radians((angle,), f"{name}.angle")
        turn = from_rotation_vector([angle * (x / length) for x in axis])
    else:
        raise ValueError(f"{name} must hold rpy, or axis and angle, got {sorted(map(str, given))}.")
    rows: Matrix3 = rotation_matrix(turn)
    return validate.rotation(rows, name)
