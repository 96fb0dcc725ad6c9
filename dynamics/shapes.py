"""Mode shapes s(x) of one uniform link, 0 <= x <= l.

A beam shape is s = a e^(b (x/l - 1)) + d e^(-b x/l) + c cos(b x/l) + s sin(b x/l): growing and
decaying exponentials that never exceed one, so that high modes do not cancel as they would
in cosh - sigma sinh.

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from dynamics.arm import Link, Mode

Array = NDArray[np.float64]

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
_BRACKETS = {  # (tip mass, tip inertia) -> root k lies between (k + these) pi
    (0.0, 0.0): (-1.0, 0.0),  # free
    (math.inf, 0.0): (0.0, 0.5),  # pinned
    (0.0, math.inf): (-0.5, 0.0),  # slope held
    (math.inf, math.inf): (0.0, 1.0),  # clamped
}
_HEAVIEST = 1e4  # [-] tip body over beam for which the shapes keep 11 digits
_DEPENDENT = 1e-12  # [-] smallest eigenvalue of the shapes' correlation matrix


@dataclass(frozen=True, kw_only=True)
class BeamShape:
    """Exponentials and sines of one wave number."""

    length: float  # [m]
    beta: float  # [-] wave number times length
    grow: float = 0.0  # coefficient of e^(beta (x/l - 1))
    decay: float = 0.0  # coefficient of e^(-beta x/l)
    cos: float = 0.0
    sin: float = 0.0

    def value(self, x: Array | float) -> Array:
        """s(x)."""
        return self._terms(x, 1.0, self.cos, self.sin)

    def slope(self, x: Array | float) -> Array:
        """s'(x)."""
        return self._terms(x, -1.0, self.sin, -self.cos) * (self.beta / self.length)

    def curvature(self, x: Array | float) -> Array:
        """s''(x)."""
        return self._terms(x, 1.0, -self.cos, -self.sin) * (self.beta / self.length) ** 2

    def scaled(self, factor: float) -> "BeamShape":
        """The same shape, larger."""
        return replace(
            self,
            grow=factor * self.grow,
            decay=factor * self.decay,
            cos=factor * self.cos,
            sin=factor * self.sin,
        )

    def _terms(self, x: Array | float, sign: float, cos: float, sin: float) -> Array:
        phase = self.beta * (np.asarray(x, dtype=np.float64) / self.length)
        result: Array = (
            self.grow * np.exp(phase - self.beta)
            + sign * self.decay * np.exp(-phase)
            + cos * np.cos(phase)
            + sin * np.sin(phase)
        )
        return result


@dataclass(frozen=True, kw_only=True)
class PowerShape:
    """s = factor (x/l)^power."""

    length: float  # [m]
    power: int
    factor: float = 1.0

    def value(self, x: Array | float) -> Array:
        """s(x)."""
        return self._term(x, 1.0, 0)

    def slope(self, x: Array | float) -> Array:
        """s'(x)."""
        return self._term(x, self.power / self.length, 1)

    def curvature(self, x: Array | float) -> Array:
        """s''(x)."""
        return self._term(x, self.power * (self.power - 1) / self.length**2, 2)

    def scaled(self, factor: float) -> "PowerShape":
        """The same shape, larger."""
        return replace(self, factor=factor * self.factor)

    def _term(self, x: Array | float, coefficient: float, order: int) -> Array:
        xi = np.asarray(x, dtype=np.float64) / self.length
        result: Array = self.factor * coefficient * xi ** max(self.power - order, 0)
        return result


Shape = BeamShape | PowerShape


@lru_cache(maxsize=1024)
def shape(mode: "Mode", link: "Link") -> Shape:
    """A mode's shape on a link, normalised as the mode says."""
    raw = _raw(mode, link)
    if mode.norm == "raw":
        return raw
    if mode.norm == "tip-unit":
        return raw.scaled(1.0 / float(raw.value(link.length)))
    return raw.scaled(_modal_mass(raw, mode, link) ** -0.5)


def quadrature(length: float, modes: Sequence["Mode"]) -> tuple[Array, Array]:
    """Gauss-Legendre points and weights, round-off exact for products of two of these shapes."""
    nodes, weights = _gauss_legendre(60 + 8 * max((mode.index for mode in modes), default=0))
    return 0.5 * length * (nodes + 1.0), 0.5 * length * weights


def are_independent(modes: Sequence["Mode"], link: "Link") -> bool:
    """Whether no shape is a combination of the others (to 1e-6 of its root mean square)."""
    if len(modes) < 2:
        return True
    x, weights = quadrature(link.length, modes)
    values = np.array([shape(mode, link).value(x) for mode in modes])
    gram = (values * weights) @ values.T
    size = np.sqrt(np.diag(gram))
    return bool(np.linalg.eigvalsh(gram / np.outer(size, size))[0] > _DEPENDENT)


def clamped_root(index: int, mass: float, inertia: float) -> float:
    """Wave number beta l of a cantilever with a body at its tip.

    Adding a mass lowers every root, but not below the root before it of the beam held there
    (infinite mass); likewise for the rotary inertia. These bounds leave one root in each bracket.

    Parameters
    ----------
    mass : [-] tip mass over beam mass; infinite: tip pinned.
    inertia : [-] tip inertia over (rho_A l^3); infinite: tip slope held.
    """
    if (mass, inertia) in _BRACKETS:
        low, high = ((index + bound) * math.pi for bound in _BRACKETS[mass, inertia])
    elif inertia in (0.0, math.inf):
        low = clamped_root(index - 1, math.inf, inertia) if index > 1 else 0.0
        high = clamped_root(index, 0.0, inertia)
    else:
        low = clamped_root(index - 1, mass, math.inf) if index > 1 else 0.0
        high = clamped_root(index, mass, 0.0)
    if low == 0.0 and mass < math.inf:  # Dunkerley's bound from below
        alone = mass / 3.0 + inertia if inertia < math.inf else mass / 12.0
        low = 0.99 * (1.0 / 1.85**4 + alone) ** -0.25
    return _bisect(lambda beta: _clamped_determinant(beta, mass, inertia), low, high)


def _raw(mode: "Mode", link: "Link") -> Shape:
    length, index = link.length, mode.index
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
    mass, inertia = (0.0, 0.0) if bare else _tip_ratios(mode, link)
    return _clamped(clamped_root(index, mass, inertia), mass, inertia, length)


def _tip_ratios(mode: "Mode", link: "Link") -> tuple[float, float]:
    """Tip mass and tip inertia over those of the beam [-]."""
    axis = {"y": 2, "z": 1}[mode.direction]
    beam = link.rho_A * link.length
    ratios = (link.tip_mass / beam, link.tip_inertia[axis][axis] / (beam * link.length**2))
    if max(ratios) > _HEAVIEST:
        raise ValueError(
            f"Link.tip_mass or Link.tip_inertia is {max(ratios):.3g} times that of the link; above "
            f"{_HEAVIEST:g} clamped-tip-mass shapes lose their digits, use another kind."
        )
    return ratios


def _clamped(beta: float, mass: float, inertia: float, length: float) -> BeamShape:
    """s = s' = 0 at the root, s = cosh - cos - sigma (sinh - sin)."""
    moment, force = _tip_conditions(beta, mass, inertia)
    # Either condition fixes the ratio; the larger one does so without cancelling.
    row = max((moment, force), key=lambda pair: abs(pair[0]) + abs(pair[1]))
    grow, decay = -row[1], row[0]
    end = math.exp(-beta)
    size = decay + grow * end  # the coefficient of -cos becomes one
    grow, decay = grow / size, decay / size
    return BeamShape(
        length=length, beta=beta, grow=grow, decay=decay, cos=-1.0, sin=decay - grow * end
    )


def _tip_conditions(
    beta: float, mass: float, inertia: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Moment and force at the tip of the two functions that are clamped at the root.

    f = e^(b(xi - 1)) - e^-b (cos b xi + sin b xi),   g = e^(-b xi) - cos b xi + sin b xi;
    moment: s'' - inertia b^4 s' = 0, force: s''' + mass b^4 s = 0, derivatives in xi.
    """
    end, c, s = math.exp(-beta), math.cos(beta), math.sin(beta)
    f = (1.0 - end * (c + s), 1.0 + end * (s - c), 1.0 + end * (c + s), 1.0 - end * (s - c))
    g = (end - c + s, -end + s + c, end + c - s, -end - s - c)
    p, q = _shares(inertia * beta**3)
    u, w = _shares(mass * beta)
    return (
        (p * f[2] - q * f[1], p * g[2] - q * g[1]),
        (u * f[3] + w * f[0], u * g[3] + w * g[0]),
    )


def _shares(ratio: float) -> tuple[float, float]:
    """(1, ratio), scaled to sum one; also for an infinite ratio."""
    return (0.0, 1.0) if ratio == math.inf else (1.0 / (1.0 + ratio), ratio / (1.0 + ratio))


def _clamped_determinant(beta: float, mass: float, inertia: float) -> float:
    moment, force = _tip_conditions(beta, mass, inertia)
    return moment[0] * force[1] - moment[1] * force[0]


def _bisect(function: Callable[[float], float], low: float, high: float) -> float:
    """The one root in a bracket, to the last bit; an end that is a root to round-off counts."""
    low, high = low * (1.0 - 1e-12), high * (1.0 + 1e-12)
    at_low, at_high = function(low), function(high)
    if (at_low > 0.0) == (at_high > 0.0):
        return low if abs(at_low) < abs(at_high) else high
    while low < (middle := 0.5 * (low + high)) < high:
        if (function(middle) > 0.0) == (at_low > 0.0):
            low = middle
        else:
            high = middle
    return high


def _modal_mass(raw: Shape, mode: "Mode", link: "Link") -> float:
    """What norm "mass" makes one: the inertia the shape was made with.

    Bending, axial: int rho_A s^2; for clamped-tip-mass with tip_mass s(l)^2 + tip inertia s'(l)^2;
    torsion: int rho_Ip s^2 + tip_inertia_xx s(l)^2.
    """
    x, weights = quadrature(link.length, (mode,))
    square = float(weights @ raw.value(x) ** 2)
    tip, slope = float(raw.value(link.length)), float(raw.slope(link.length))
    if mode.direction == "x":
        return link.rho_Ip * square + link.tip_inertia[0][0] * tip**2
    total = link.rho_A * square
    if mode.kind == "clamped-tip-mass":
        axis = {"y": 2, "z": 1}[mode.direction]
        total += link.tip_mass * tip**2 + link.tip_inertia[axis][axis] * slope**2
    return total


@lru_cache(maxsize=64)
def _gauss_legendre(count: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights
