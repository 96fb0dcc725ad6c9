"""Link description: beam, joint, tip body and mode shapes."""

import logging
import warnings
from collections import Counter
from copy import copy
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any

import numpy as np

from dynamics.description import mode_rule, validate
from dynamics.description.beams import sections as along
from dynamics.description.beams.sections import Sections
from dynamics.description.joint import Joint
from dynamics.description.mode_rule import ModesByRule, RigidLinkWarning, TipLoad
from dynamics.description.mode_shapes import (
    BENDING,
    BENDING_AXIS,
    FREE_ROOT,
    STIFFNESS,
    Beam,
    Mode,
    are_independent,
    in_direction,
    points,
    shape,
)
from dynamics.description.validate import ZEROS, clean
from dynamics.description.welds import StiffSegmentsWarning, stiff_segments
from dynamics.types import Array, Matrix3, Vector3

MOST_MODES = 200
_ROUND_OFF = 1e-6  # [-] of the sum of the sections' lengths
_UNSTATED: Any = None
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Rigid body."""

    mass: float  # [kg]
    com: Vector3 = (0.0, 0.0, 0.0)  # [m] centre of mass
    inertia: Matrix3 = ZEROS  # (3, 3) [kg m^2] about the centre of mass

    def __post_init__(self) -> None:
        name = type(self).__name__
        clean(
            self,
            mass=validate.nonnegative(self.mass, f"{name}.mass", "kg"),
            com=validate.vector(self.com, f"{name}.com", "m"),
            inertia=validate.inertia(self.inertia, f"{name}.inertia"),
        )


class Body(Solid):
    """Rigid body fixed to the root of a link, in the frame of the link."""


class Payload(Solid):
    """Rigid body fixed to the last link's tip, in the deformed end frame.

    It is added to that link's tip mass and tip inertia. Mode shapes do not depend on it, but their
    family by rule does.
    """


def about_origin(body: Solid) -> Array:
    """(3, 3) [kg m^2] inertia of a body about the origin of its frame."""
    com = np.array(body.com)
    moved = body.mass * ((com @ com) * np.eye(3) - np.outer(com, com))
    return np.array(body.inertia) + moved


@dataclass(frozen=True, kw_only=True)
class Link:
    """Slender link behind a joint; flexible with modes, rigid without.

    A link with a stiffness states its modes: a list, () for a rigid link, or "auto" for those of
    `mode_rule`. If it states none it is rigid, with a RigidLinkWarning.

    A link that is not uniform has `sections` in place of rho_A, rigidities and rho_Ip. Its length
    is their sum.

    A rigid link may have a `body` in place of a mass per unit length, or both. With a body, the
    length may be zero. The body of a flexible link moves with its root, as the housing of a motor.
    """

    length: float = _UNSTATED  # [m] root to tip
    rho_A: float = 0.0  # [kg/m] mass per unit length
    EIz: float | None = None  # [N m^2] flexural rigidity for deflection along y
    EIy: float | None = None  # [N m^2] flexural rigidity for deflection along z
    GJ: float | None = None  # [N m^2] torsional rigidity
    EA: float | None = None  # [N] axial rigidity
    rho_Ip: float = 0.0  # [kg m] polar rotary inertia per unit length
    tip_mass: float = 0.0  # [kg] point mass at the tip
    tip_inertia: Matrix3 = ZEROS  # (3, 3) [kg m^2] about the tip, in the deformed end frame
    modes: tuple[Mode, ...] = _UNSTATED  # | "auto"
    damping_ratio: float = 0.0  # [-] of each natural mode of the link alone, clamped
    damping_beta: float = 0.0  # [s] damping matrix = beta * stiffness matrix
    damping_beta_torsion: float | None = None  # [s] the same for torsion; None: damping_beta
    segments: int = 1  # equal parts welded together, each with all modes: for large deflections
    lumped: bool = False  # deflection moves a quarter of the beam's mass, at the tip: heavy tips
    joint: Joint = field(default_factory=Joint)
    body: Body | None = None  # fixed to the root
    sections: Sections = ()  # from root to tip, of a link that is not uniform

    def __post_init__(self) -> None:
        given = self.modes
        self._check_sections()
        automatic = isinstance(given, str | ModesByRule)
        modes = mode_rule.stated(given)
        at_least = validate.positive if self.body is None else validate.nonnegative
        clean(
            self,
            length=at_least(self.length, "Link.length", "m"),
            rho_Ip=validate.nonnegative(self.rho_Ip, "Link.rho_Ip", "kg m"),
            tip_mass=validate.nonnegative(self.tip_mass, "Link.tip_mass", "kg"),
            tip_inertia=validate.inertia(self.tip_inertia, "Link.tip_inertia"),
            damping_ratio=validate.nonnegative(self.damping_ratio, "Link.damping_ratio", "-"),
            damping_beta=validate.nonnegative(self.damping_beta, "Link.damping_beta", "s"),
            segments=validate.integer(self.segments, "Link.segments", 1, 1000),
            modes=() if automatic else tuple(validate.sequence(modes, "Link.modes", MOST_MODES)),
            lumped=validate.boolean(self.lumped, "Link.lumped"),
        )
        if not self.sections:
            clean(self, rho_A=at_least(self.rho_A, "Link.rho_A", "kg/m"))
        if self.damping_beta_torsion is not None:
            name = "damping_beta_torsion"
            clean(self, **{name: validate.nonnegative(getattr(self, name), f"Link.{name}", "s")})
        for name in STIFFNESS.values():
            value = getattr(self, name)
            if value is not None:
                unit = along.UNITS[name]
                clean(self, **{name: validate.nonnegative(value, f"Link.{name}", unit)})
        validate.instance(self.joint, "Link.joint", Joint)
        if self.body is not None:
            validate.instance(self.body, "Link.body", Body)
        if automatic or self.modes:
            validate.positive(self.length, "Link.length", "m")
            validate.positive(self.mean("rho_A"), "Link.rho_A", "kg/m")
        if automatic:
            clean(self, modes=self._by_rule(TipLoad()))
        for name in ("damping_beta", "damping_beta_torsion"):
            if self.damping_ratio > 0.0 and getattr(self, name):
                raise ValueError(
                    f"Link.damping_ratio ({self.damping_ratio!r}) and Link.{name} "
                    f"({getattr(self, name)!r}) exclude each other; give one."
                )
        self._check_body()
        self._check_modes()
        if isinstance(given, str):
            words = mode_rule.in_words(self.modes, self.stiffnesses)
            _log.info('link of %.4g m with modes "auto": %s', self.length, words)
        name = f"A link of {self.length:g} m"
        if given is None and self.stiffnesses:
            sentence = mode_rule.rigid_in_silence(name, self.stiffnesses)
            warnings.warn(sentence, RigidLinkWarning, stacklevel=3)
        if isinstance(given, str) and not self.stiffnesses:
            warnings.warn(mode_rule.rigid_though_auto(name), RigidLinkWarning, stacklevel=3)
        stiff = stiff_segments(name, self.modes, self.beam, self.segments)
        if stiff:
            warnings.warn(stiff, StiffSegmentsWarning, stacklevel=3)

    def _check_sections(self) -> None:
        """Store checked sections and the length that they give."""
        clean(self, sections=along.checked(self.sections))
        if not self.sections:
            if self.length is None:
                raise ValueError(
                    "Link.length [m] must be a number, got None; only Link.sections replace it."
                )
            return
        for entry in fields(self):
            value = getattr(self, entry.name)
            zero = isinstance(value, Real) and value == entry.default
            if entry.name in along.UNITS and not (value is entry.default or zero):
                raise ValueError(
                    f"Link.{entry.name} ({validate.shown(value)}) and Link.sections exclude each "
                    f"other; give {entry.name} in every section."
                )
        total = along.total_length(self.sections)
        if self.length is not None:
            length = validate.number(self.length, "Link.length", "m")
            if abs(length - total) > _ROUND_OFF * total:
                raise ValueError(
                    f"Link.length ({length!r}) must be the sum of the lengths of Link.sections "
                    f"({total:.12g}); leave it out, or change a section."
                )
        clean(self, length=total)

    def _by_rule(self, load: TipLoad) -> ModesByRule:
        return mode_rule.modes_by_rule(
            self.beam,
            self.joint,
            self.stiffnesses,
            self.segments,
            self.body is None,
            load,
            self.lumped,
        )

    def by_rule(self, load: TipLoad) -> "Link":
        """The link, whose modes by rule suit the bodies beyond its tip."""
        by_rule = isinstance(self.modes, ModesByRule)
        modes = self._by_rule(load) if by_rule else self.modes
        if modes == self.modes:
            return self
        words = mode_rule.in_words(modes, self.stiffnesses)
        _log.info('link of %.4g m with modes "auto" in its arm: %s', self.length, words)
        result = copy(self)
        clean(result, modes=modes)
        return result

    def _check_body(self) -> None:
        if self.body is not None and self.segments > 1 and not self.modes:
            raise ValueError(
                f"Link.segments ({self.segments!r}) must be 1 for a rigid link with a body; leave "
                "it out."
            )

    def _check_modes(self) -> None:
        for j, mode in enumerate(self.modes):
            validate.instance(mode, f"Link.modes[{j}]", Mode)
            name = STIFFNESS[mode.direction]
            if not self.mean(name) > 0.0:
                raise ValueError(
                    f"Link.{name} must be positive for the mode along "
                    f"{mode.direction!r} ({mode.kind} {mode.index}), got {getattr(self, name)!r}"
                    f"{' in every section' * bool(self.sections)}. Unit: [{along.UNITS[name]}]."
                )
        self._check_roots()
        repeated = Counter((mode.kind, mode.index, mode.direction) for mode in self.modes)
        for (kind, index, direction), count in repeated.items():
            if count > 1:
                raise ValueError(
                    f"Link.modes holds {kind} {index} along {direction!r} {count} times; "
                    "list each mode once."
                )
        torsion = self.in_direction("x")
        if len(torsion) * self.segments > 1 and self.mean("rho_Ip") == 0.0:
            raise ValueError(
                f"Link.rho_Ip must be positive for {len(torsion) * self.segments} torsion modes in "
                "all segments, got 0.0: a tip inertia alone carries only one."
            )
        polar = self.mean("rho_Ip") + self.tip_inertia[0][0]
        if polar == 0.0 and any(mode.norm == "mass" for mode in torsion):
            raise ValueError(
                "Mode.norm 'mass' of a torsion mode needs Link.rho_Ip or Link.tip_inertia about x, "
                'got 0.0 for both; use "tip-unit".'
            )
        self._check_lumped()
        for mode in self.modes:
            shape(mode, self.beam)  # raises ValueError if the shape cannot be computed
        for direction in STIFFNESS:
            modes = self.in_direction(direction)
            if not are_independent(modes, self.beam):
                named = [f"{mode.kind} {mode.index}" for mode in modes]
                raise ValueError(
                    f"Link.modes along {direction!r} are linearly dependent ({', '.join(named)}); "
                    "leave out the shape that repeats another."
                )

    def _check_roots(self) -> None:
        loose = sorted(FREE_ROOT.intersection(mode.kind for mode in self.modes))
        if loose and self.segments > 1:
            raise ValueError(
                f"Link.segments ({self.segments!r}) must be 1 with {loose[0]} modes: "
                "inner segments are welded at their roots."
            )
        if loose and self.joint.type != "revolute":
            raise ValueError(
                f"Link.modes must not be {loose[0]} with a {self.joint.type} joint: it cannot "
                "rotate their root."
            )
        if loose and any(self.joint.root):
            raise ValueError(
                f"Link.modes must not be {loose[0]} with Joint.root ({self.joint.root!r}): their "
                "root is on the joint's axis; take clamped-free or clamped-tip-mass modes."
            )
        if "pinned-free" in loose and self.body is not None:
            raise ValueError(
                "Link.modes must not be pinned-free beside Link.body, which turns with the joint, "
                "not with their root; take clamped-free modes."
            )

    def _check_lumped(self) -> None:
        if not self.lumped:
            return
        if any(mode.kind == "pinned-free" for mode in self.modes):
            raise ValueError(
                "Link.lumped must be false with pinned-free modes, got True: the inner lump does "
                "not follow the turning of their root."
            )
        for direction in STIFFNESS:
            count, most = len(self.in_direction(direction)), 2 if direction in BENDING else 1
            if count > most:
                raise ValueError(
                    f"Link.modes of a lumped link may hold {most} along {direction!r}, got "
                    f"{count}: the tip body moves in no more; leave out modes or lumped."
                )
        for direction, axis in BENDING_AXIS.items():
            two = len(self.in_direction(direction)) > 1
            if self.damping_ratio and two and not self.tip_inertia[axis][axis]:
                raise ValueError(
                    f"Link.damping_ratio ({self.damping_ratio!r}) of a lumped link with two modes "
                    f"along {direction!r} needs Link.tip_inertia[{axis}][{axis}], got 0.0: without "
                    "it the link alone has one natural mode there. Give inertia, one mode, or "
                    "damping_beta."
                )

    @property
    def beam(self) -> Beam:
        """Beam, tip body and hub that determine the mode shapes."""
        rigid = self.joint.type == "revolute" and not self.joint.elastic
        root = self.joint.hub_inertia + (self.joint.rotor_inertia if rigid else 0.0)
        if self.body is not None:
            root += float(about_origin(self.body)[2, 2])
        return Beam(
            length=self.length,
            rho_A=self.mean("rho_A"),
            rho_Ip=self.mean("rho_Ip"),
            tip_mass=self.tip_mass,
            tip_inertia=self.tip_inertia,
            root_inertia=root,
            sections=self.sections,
        )

    def mean(self, name: str) -> float:
        """Mean along the link of a quantity such as "EIz"; 0 if it is not stated."""
        return along.mean(self.sections, name) if self.sections else getattr(self, name) or 0.0

    def at(self, name: str, x: Array) -> Array:
        """A quantity such as "EIz" at positions x [m]; 0 if it is not stated."""
        return self.mean(name) * self.beam.share(name, x)

    def tip_rigidity(self, direction: str) -> float:
        """[N m^2] EI of the uniform link that bends as far by a force at the tip; 0: rigid."""
        EI = self.mean(STIFFNESS[direction])
        if not self.sections or not EI:
            return EI
        x, weights = points(self.beam, ())
        lever = (self.length - x) ** 2 / self.beam.rigidity(direction, x)
        return self.length**3 / (3.0 * float(weights @ lever))

    def root_curvature(self, direction: str) -> float:
        """Curvature at the root times l^2 / s(l), under a force at the tip: 3 of a uniform link."""
        EI = self.tip_rigidity(direction)
        if not self.sections or not EI:
            return 3.0
        return 3.0 * EI / float(self.beam.rigidity(direction, np.zeros(1))[0])

    @property
    def n(self) -> int:
        """Number of coordinates: joint, spring and modes of all segments."""
        return self.joint.moves + self.joint.elastic + self.segments * len(self.modes)

    @property
    def stiffnesses(self) -> tuple[str, ...]:
        """Names of the rigidities that are positive, such as "EIz"."""
        return tuple(name for name in sorted(STIFFNESS.values()) if self.mean(name))

    def in_direction(self, direction: str) -> tuple[Mode, ...]:
        """Modes along "x" (torsion), "y" or "z" (bending), or "axial"."""
        return in_direction(self.modes, direction)
