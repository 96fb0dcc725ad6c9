"""The joint at the root of a link."""

from dataclasses import dataclass

from dynamics.description import validate
from dynamics.description.validate import IDENTITY
from dynamics.types import Matrix3, Vector3

TYPES = ("revolute", "prismatic")


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A joint turns about its local z, or slides along it.

    Units are those of a revolute joint. Of a prismatic one q is a length [m] and the rotor inertia
    a mass [kg]; the rest follows: [N s/m], [N], [m/s], [N/m].

    A parallel drive is a massless parallelogram along the link before: it grounds this joint's
    drive on what the joint before stands on. q is then the angle from there, whatever the joint
    before turns and the link before bends, and the torque reacts there; see parallel.py.
    """

    rotation: Matrix3 = IDENTITY  # (3, 3) [-] end frame of the link before -> joint frame at q = 0
    offset: Vector3 = (0.0, 0.0, 0.0)  # [m] from that end to the joint, in that end frame
    rotor_inertia: float = 0.0  # [kg m^2] turns with the joint rate (relative)
    hub_inertia: float = 0.0  # [kg m^2] about z, turns with the link's root (absolute)
    viscous: float = 0.0  # [N m s/rad] friction
    coulomb: float = 0.0  # [N m] friction, times tanh(rate / coulomb_speed)
    coulomb_speed: float = 0.05  # [rad/s]
    type: str = "revolute"  # | "prismatic"
    stiffness: float | None = None  # [N m/rad] of a spring between rotor and link; None: no spring
    spring_damping: float = 0.0  # [N m s/rad] beside that spring
    parallel: bool = False  # driven in parallel to the link before

    def __post_init__(self) -> None:
        positive, nonnegative = validate.positive, validate.nonnegative
        cleaned = {
            "rotation": validate.rotation(self.rotation, "Joint.rotation"),
            "offset": validate.vector(self.offset, "Joint.offset", "m"),
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

    def _check_spring(self) -> None:
        if self.stiffness is None and self.spring_damping > 0.0:
            raise ValueError(
                f"Joint.spring_damping ({self.spring_damping!r}) needs a spring; "
                "give Joint.stiffness."
            )
        if self.stiffness is not None and self.rotor_inertia == 0.0:
            raise ValueError(
                f"Joint.rotor_inertia must be positive with Joint.stiffness ({self.stiffness!r}), "
                "got 0.0: the spring leaves the rotor to itself."
            )

    @property
    def elastic(self) -> bool:
        """Whether a spring stands between rotor and link."""
        return self.stiffness is not None
