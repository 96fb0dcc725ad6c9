"""Mode shapes s(x) of a link, 0 <= x <= l.

| kind               | root         | tip                 | raw shape                       |
|--------------------|--------------|---------------------|---------------------------------|
| clamped-free       | s = s' = 0   | free                | cosh - cos - sigma (sinh - sin) |
| clamped-tip-mass   | s = s' = 0   | the link's tip body | cosh - cos - sigma (sinh - sin) |
| pinned-free        | s = s'' = 0  | free                | sin + (sin b / sinh b) sinh     |
| unconstrained      | s = s' = 0   | the link's tip body | see `beams.uniform.unconstrained` |
| poly               | s = s' = 0   | no condition        | (x/l)^(index + 1)               |
| hierarchical       | s = s' = 0   | no condition        | see `beams.uniform.hierarchical`  |
| torsion-fixed-free | s = 0        | free                | sin                             |
| torsion-poly       | s = 0        | no condition        | (x/l)^index                     |
| axial-fixed-free   | s = 0        | free                | sin                             |
| axial-poly         | s = 0        | no condition        | (x/l)^index                     |

Arguments of the raw functions are b x/l, with the wave number b/l. The index of pinned-free starts
at the first elastic mode: the rigid rotation is the joint's. The tip body of clamped-tip-mass is
the link's tip mass and its tip inertia about the bending axis. Unconstrained shapes are the natural
modes of the link with this body on a free joint, whose rotor and hub turn with the root.

These are the shapes of a uniform link. On a link of sections the first four kinds and those named
fixed-free are its own natural modes; the other kinds have the bending moment, torque or normal
force that they have on a uniform link (see `beams.piecewise`).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from dynamics.description import validate
from dynamics.description.beams import piecewise
from dynamics.description.beams.piecewise import PieceShape
from dynamics.description.beams.sections import Sections, at, edges, relative
from dynamics.description.beams.uniform import (
    BeamShape,
    LegendreShape,
    PowerShape,
    clamped,
    clamped_root,
    hierarchical,
    power,
    unconstrained,
)
from dynamics.types import Array, Matrix3

Shape = BeamShape | PowerShape | LegendreShape | PieceShape

KINDS: dict[str, tuple[str, ...]] = {  # kind -> directions it may act in
    "clamped-free": ("y", "z"),
    "clamped-tip-mass": ("y", "z"),
    "pinned-free": ("y",),  # the joint turns about z: only bending along y can be pinned
    "unconstrained": ("y",),
    "poly": ("y", "z"),
    "hierarchical": ("y", "z"),
    "torsion-fixed-free": ("x",),
    "torsion-poly": ("x",),
    "axial-fixed-free": ("axial",),
    "axial-poly": ("axial",),
}
FREE_ROOT = {"pinned-free", "unconstrained"}  # kinds whose root a joint lets turn
# direction of a mode -> rigidity of the link that resists it
STIFFNESS = {"x": "GJ", "y": "EIz", "z": "EIy", "axial": "EA"}
BENDING_AXIS = {"y": 2, "z": 1}  # direction of bending -> axis about which the tip turns
BENDING = tuple(BENDING_AXIS)  # directions whose strain is s''; in the others it is s'
NORMS = ("tip-unit", "mass", "raw")
MAX_INDEX = 50
_HEAVIEST = 1e4  # [-] ratio of tip body to beam up to which the shapes keep 11 digits
_DEPENDENT = 1e-12  # [-] least eigenvalue of the correlation matrix of independent shapes


@dataclass(frozen=True, kw_only=True)
class Mode:
    """Assumed mode shape s(x) of a link; the module docstring lists the kinds."""

    kind: str
    index: int  # 1, 2, ... within its kind
    direction: str  # "y", "z": bending along that axis; "x": torsion; "axial": stretching
    norm: str = "tip-unit"  # s(l) = 1 | "mass": modal mass 1 | "raw": as in the formula;
    # hierarchical shapes with s(l) = 0 stay raw under "tip-unit"

    def __post_init__(self) -> None:
        kind = validate.choice(self.kind, "Mode.kind", KINDS)
        index = validate.integer(self.index, "Mode.index", 1, MAX_INDEX)
        direction = validate.choice(self.direction, "Mode.direction", STIFFNESS)
        validate.choice(self.norm, "Mode.norm", NORMS)
        if direction not in KINDS[kind]:
            raise ValueError(
                f"Mode.direction {direction!r} does not fit kind {kind!r}; "
                f"possible: {list(KINDS[kind])}."
            )
        object.__setattr__(self, "index", index)


def in_direction(modes: Iterable[Mode], direction: str) -> tuple[Mode, ...]:
    """Modes along "x" (torsion), "y" or "z" (bending), or "axial"."""
    return tuple(mode for mode in modes if mode.direction == direction)


@dataclass(frozen=True, kw_only=True)
class Beam:
    """Beam with a body at its tip: the properties of a link that determine its shapes."""

    length: float  # [m]
    rho_A: float  # [kg/m] mean
    rho_Ip: float  # [kg m] mean
    tip_mass: float  # [kg]
    tip_inertia: Matrix3  # (3, 3) [kg m^2] about the tip
    root_inertia: float = 0.0  # [kg m^2] that a free joint turns with the root
    sections: Sections = ()  # none: uniform

    def rigidity(self, direction: str, x: Array) -> Array:
        """Rigidity of sections against bending, torsion or stretching; 1 of a uniform beam."""
        return at(self.sections, STIFFNESS[direction], x) if self.sections else np.ones(x.shape)

    def share(self, name: str, x: Array) -> Array:
        """A quantity of the link, such as "rho_A", over its mean."""
        return relative(self.sections, name, x)

    @property
    def line_mass(self) -> "LineMass":
        """Moments of the beam's mass about its root."""
        if not self.sections:
            mass = self.rho_A * self.length
            return LineMass(mass, mass * self.length / 2.0, mass * self.length**2 / 3.0)
        x, weights = piecewise.gauss(edges(self.sections), 2)
        loads = weights * at(self.sections, "rho_A", x)
        return LineMass(*(float(loads @ x**k) for k in range(3)))


class LineMass(NamedTuple):
    """Moments int rho_A x^k of a beam about its root, k = 0, 1, 2."""

    mass: float  # [kg]
    first: float  # [kg m]
    second: float  # [kg m^2]


@lru_cache(maxsize=1024)
def shape(mode: Mode, beam: Beam) -> Shape:
    """Shape of a mode on a beam, normalised according to `mode.norm`."""
    raw = _of_sections(mode, beam) if beam.sections else _raw(mode, beam)
    at_rest = mode.kind == "hierarchical" and mode.index > 1  # s(l) = 0
    if mode.norm == "raw" or (mode.norm == "tip-unit" and at_rest):
        return raw
    if mode.norm == "tip-unit":
        return raw.scaled(1.0 / float(raw.value(beam.length)))
    return raw.scaled(_modal_mass(raw, mode, beam) ** -0.5)


def quadrature(length: float, modes: Sequence[Mode]) -> tuple[Array, Array]:
    """Gauss-Legendre points [m] and weights, exact to round-off for products of two shapes."""
    nodes, weights = _gauss_legendre(60 + 8 * max((mode.index for mode in modes), default=0))
    return 0.5 * length * (nodes + 1.0), 0.5 * length * weights


def points(beam: Beam, modes: Sequence[Mode]) -> tuple[Array, Array]:
    """Points [m] and weights of a `quadrature` that knows the sections of a beam."""
    if not beam.sections:
        return quadrature(beam.length, modes)
    most = max((mode.index for mode in modes), default=0)
    return piecewise.gauss(edges(beam.sections), 44 + 2 * most)


def are_independent(modes: Sequence[Mode], beam: Beam) -> bool:
    """True if the shapes are linearly independent (to 1e-6 of their root mean squares)."""
    if len(modes) < 2:
        return True
    x, weights = points(beam, modes)
    values = np.array([shape(mode, beam).value(x) for mode in modes])
    gram = (values * weights) @ values.T
    size = np.sqrt(np.diag(gram))
    return bool(np.linalg.eigvalsh(gram / np.outer(size, size))[0] > _DEPENDENT)


def _raw(mode: Mode, beam: Beam) -> Shape:
    length, index = beam.length, mode.index
    if mode.kind == "poly":
        return power(index + 1, length)
    if mode.kind == "hierarchical":
        return hierarchical(index, length)
    if mode.kind in ("torsion-poly", "axial-poly"):
        return power(index, length)
    if mode.kind in ("torsion-fixed-free", "axial-fixed-free"):
        return BeamShape(length=length, beta=(index - 0.5) * math.pi, sin=1.0)
    if mode.kind == "pinned-free":
        beta = clamped_root(index, math.inf, 0.0)  # root of tan b = tanh b, as for clamped-pinned
        ratio = math.sin(beta) / -math.expm1(-2.0 * beta)  # sin b / (2 sinh b e^-b)
        return BeamShape(
            length=length, beta=beta, grow=ratio, decay=-ratio * math.exp(-beta), sin=1.0
        )
    if mode.kind == "unconstrained":
        hub = beam.root_inertia / (beam.rho_A * length**3)
        return unconstrained(index, length, *_tip_ratios(mode, beam), hub)
    free = mode.kind == "clamped-free"
    mass, inertia = (0.0, 0.0) if free else _tip_ratios(mode, beam)
    return clamped(clamped_root(index, mass, inertia), mass, inertia, length)


def _of_sections(mode: Mode, beam: Beam) -> PieceShape:
    """A natural mode of the beam, or the shape under the load that a power has on a uniform one."""
    if mode.norm == "raw":
        raise ValueError(
            'Mode.norm "raw" needs a uniform link: shapes of Link.sections have no formula; take '
            '"tip-unit".'
        )
    ends, bending = edges(beam.sections), mode.direction in BENDING
    rigidity, order = partial(beam.rigidity, mode.direction), 2 if bending else 1
    if mode.kind == "hierarchical":
        return piecewise.hierarchical(mode.index, ends, rigidity)
    if mode.kind in ("poly", "torsion-poly", "axial-poly"):

        def load(x: Array) -> Array:
            return (x / beam.length) ** (mode.index - 1)

        return piecewise.loaded(ends, load, rigidity, mode.index, order)
    inertia = "rho_Ip" if mode.direction == "x" else "rho_A"
    stated = getattr(beam.sections[0], inertia) is not None
    density = partial(at, beam.sections, inertia) if stated else rigidity
    hub = {"pinned-free": 0.0, "unconstrained": beam.root_inertia}.get(mode.kind)
    tip = (0.0, 0.0)
    if mode.kind in ("clamped-tip-mass", "unconstrained"):
        size = beam.rho_A * beam.length
        mass, turning = _tip_ratios(mode, beam)
        tip = (mass * size, turning * size * beam.length**2)
    found = piecewise.natural(mode.index, ends, rigidity, density, order, tip, hub)
    return replace(found, root=0.0) if mode.kind == "unconstrained" else found


def _tip_ratios(mode: Mode, beam: Beam) -> tuple[float, float]:
    """Tip mass over rho_A l and tip inertia over rho_A l^3 [-]."""
    axis = BENDING_AXIS[mode.direction]
    mass = beam.rho_A * beam.length
    ratios = (beam.tip_mass / mass, beam.tip_inertia[axis][axis] / (mass * beam.length**2))
    if max(ratios) > _HEAVIEST:
        raise ValueError(
            f"Link.tip_mass or Link.tip_inertia is {max(ratios):.3g} times that of the link; above "
            f"{_HEAVIEST:g} {mode.kind} shapes lose precision; use another kind."
        )
    return ratios


def _modal_mass(raw: Shape, mode: Mode, beam: Beam) -> float:
    """Modal mass that norm "mass" sets to one, with the tip body that the shape depends on.

    Bending, axial: int rho_A s^2; for clamped-tip-mass with tip_mass s(l)^2 + tip inertia s'(l)^2;
    torsion: int rho_Ip s^2 + tip_inertia_xx s(l)^2.
    """
    x, weights = points(beam, (mode,))
    inertia = beam.share("rho_Ip" if mode.direction == "x" else "rho_A", x)
    square = float(weights @ (inertia * raw.value(x) ** 2))
    tip, slope = float(raw.value(beam.length)), float(raw.slope(beam.length))
    if mode.direction == "x":
        return beam.rho_Ip * square + beam.tip_inertia[0][0] * tip**2
    total = beam.rho_A * square
    if mode.kind == "clamped-tip-mass":
        axis = BENDING_AXIS[mode.direction]
        total += beam.tip_mass * tip**2 + beam.tip_inertia[axis][axis] * slope**2
    return total


@lru_cache(maxsize=64)
def _gauss_legendre(count: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights
