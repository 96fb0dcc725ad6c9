"""Mode shapes s(x) of one uniform link, 0 <= x <= l.

| kind               | conditions                          | raw                             |
|--------------------|-------------------------------------|---------------------------------|
| clamped-free       | s = s' = 0 at the root; tip free    | cosh - cos - sigma (sinh - sin) |
| clamped-tip-mass   | the link's own tip body at its tip  | the same                        |
| pinned-free        | s = s'' = 0 at the root; tip free   | sin + (sin b / sinh b) sinh     |
| poly               | none; enough for a clamped root     | (x/l)^(index + 1)               |
| torsion-fixed-free | twist 0 at the root; tip free       | sin                             |
| torsion-poly       | none; twist 0 at the root           | (x/l)^index                     |
| axial-fixed-free   | held at the root; tip free          | sin                             |
| axial-poly         | none; held at the root              | (x/l)^index                     |

Raw arguments are b x/l. Of pinned-free only the elastic modes count: the joint turns the rigid one.
The tip body of clamped-tip-mass is the link's tip mass and its tip inertia about the bending axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dynamics.description import validate
from dynamics.description.beam_shapes import BeamShape, PowerShape, Shape, clamped, clamped_root
from dynamics.types import Array, Matrix3

KINDS: dict[str, tuple[str, ...]] = {  # kind -> directions it may act in
    "clamped-free": ("y", "z"),
    "clamped-tip-mass": ("y", "z"),
    "pinned-free": ("y",),  # the joint turns about z: only bending along y can be pinned
    "poly": ("y", "z"),
    "torsion-fixed-free": ("x",),
    "torsion-poly": ("x",),
    "axial-fixed-free": ("axial",),
    "axial-poly": ("axial",),
}
# direction of a mode -> what resists it
STIFFNESS = {"x": "GJ", "y": "EIz", "z": "EIy", "axial": "EA"}
NORMS = ("tip-unit", "mass", "raw")
MAX_INDEX = 50
_HEAVIEST = 1e4  # [-] tip body over beam for which the shapes keep 11 digits
_DEPENDENT = 1e-12  # [-] smallest eigenvalue of the shapes' correlation matrix


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One assumed shape s(x) of a link; see the table above for the kinds."""

    kind: str
    index: int  # 1, 2, ... within its kind
    direction: str  # "y", "z": bending along that axis; "x": torsion; "axial": stretching
    norm: str = "tip-unit"  # s(l) = 1 | "mass": modal mass 1 | "raw": as in the formula

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


@dataclass(frozen=True, kw_only=True)
class Beam:
    """A uniform beam and the body at its tip: all of a link that its shapes depend on."""

    length: float  # [m]
    rho_A: float  # [kg/m]
    rho_Ip: float  # [kg m]
    tip_mass: float  # [kg]
    tip_inertia: Matrix3  # (3, 3) [kg m^2] about the tip


@lru_cache(maxsize=1024)
def shape(mode: Mode, beam: Beam) -> Shape:
    """A mode's shape on a beam, normalised as the mode says."""
    raw = _raw(mode, beam)
    if mode.norm == "raw":
        return raw
    if mode.norm == "tip-unit":
        return raw.scaled(1.0 / float(raw.value(beam.length)))
    return raw.scaled(_modal_mass(raw, mode, beam) ** -0.5)


def quadrature(length: float, modes: Sequence[Mode]) -> tuple[Array, Array]:
    """Gauss-Legendre points and weights, round-off exact for products of two of these shapes."""
    nodes, weights = _gauss_legendre(60 + 8 * max((mode.index for mode in modes), default=0))
    return 0.5 * length * (nodes + 1.0), 0.5 * length * weights


def are_independent(modes: Sequence[Mode], beam: Beam) -> bool:
    """Whether no shape is a combination of the others (to 1e-6 of its root mean square)."""
    if len(modes) < 2:
        return True
    x, weights = quadrature(beam.length, modes)
    values = np.array([shape(mode, beam).value(x) for mode in modes])
    gram = (values * weights) @ values.T
    size = np.sqrt(np.diag(gram))
    return bool(np.linalg.eigvalsh(gram / np.outer(size, size))[0] > _DEPENDENT)


def _raw(mode: Mode, beam: Beam) -> Shape:
    length, index = beam.length, mode.index
    if mode.kind == "poly":
        return PowerShape(length=length, power=index + 1)
    if mode.kind in ("torsion-poly", "axial-poly"):
        return PowerShape(length=length, power=index)
    if mode.kind in ("torsion-fixed-free", "axial-fixed-free"):
        return BeamShape(length=length, beta=(index - 0.5) * math.pi, sin=1.0)
    if mode.kind == "pinned-free":
        beta = clamped_root(index, math.inf, 0.0)  # tan = tanh, as for clamped-pinned
        ratio = math.sin(beta) / -math.expm1(-2.0 * beta)  # sin b / (2 sinh b e^-b)
        return BeamShape(
            length=length, beta=beta, grow=ratio, decay=-ratio * math.exp(-beta), sin=1.0
        )
    bare = mode.kind == "clamped-free"
    mass, inertia = (0.0, 0.0) if bare else _tip_ratios(mode, beam)
    return clamped(clamped_root(index, mass, inertia), mass, inertia, length)


def _tip_ratios(mode: Mode, beam: Beam) -> tuple[float, float]:
    """Tip mass and tip inertia over those of the beam [-]."""
    axis = {"y": 2, "z": 1}[mode.direction]
    mass = beam.rho_A * beam.length
    ratios = (beam.tip_mass / mass, beam.tip_inertia[axis][axis] / (mass * beam.length**2))
    if max(ratios) > _HEAVIEST:
        raise ValueError(
            f"Link.tip_mass or Link.tip_inertia is {max(ratios):.3g} times that of the link; above "
            f"{_HEAVIEST:g} clamped-tip-mass shapes lose their digits, use another kind."
        )
    return ratios


def _modal_mass(raw: Shape, mode: Mode, beam: Beam) -> float:
    """What norm "mass" makes one: the inertia the shape was made with.

    Bending, axial: int rho_A s^2; for clamped-tip-mass with tip_mass s(l)^2 + tip inertia s'(l)^2;
    torsion: int rho_Ip s^2 + tip_inertia_xx s(l)^2.
    """
    x, weights = quadrature(beam.length, (mode,))
    square = float(weights @ raw.value(x) ** 2)
    tip, slope = float(raw.value(beam.length)), float(raw.slope(beam.length))
    if mode.direction == "x":
        return beam.rho_Ip * square + beam.tip_inertia[0][0] * tip**2
    total = beam.rho_A * square
    if mode.kind == "clamped-tip-mass":
        axis = {"y": 2, "z": 1}[mode.direction]
        total += beam.tip_mass * tip**2 + beam.tip_inertia[axis][axis] * slope**2
    return total


@lru_cache(maxsize=64)
def _gauss_legendre(count: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights
