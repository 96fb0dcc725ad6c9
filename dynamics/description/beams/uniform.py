"""Shape functions of beams: exponentials and sines of one wave number, powers, hierarchical.

A beam shape is s = a e^(b (x/l - 1)) + d e^(-b x/l) + c cos(b x/l) + s sin(b x/l): growing and
decaying exponentials that never exceed one, which avoids the cancellation of cosh - sigma sinh in
high modes.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.polynomial import legendre, polynomial

from dynamics.types import Array

_BRACKETS = {  # (tip mass, tip inertia) -> (low, high): root k is in (k + low) pi .. (k + high) pi
    (0.0, 0.0): (-1.0, 0.0),  # free
    (math.inf, 0.0): (0.0, 0.5),  # pinned
    (0.0, math.inf): (-0.5, 0.0),  # slope fixed
    (math.inf, math.inf): (0.0, 1.0),  # clamped
}


@dataclass(frozen=True, kw_only=True)
class BeamShape:
    """s(x) from exponentials and sines of one wave number; see the module docstring."""

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

    def third(self, x: Array | float) -> Array:
        """Third derivative of s(x)."""
        return self._terms(x, -1.0, -self.sin, self.cos) * (self.beta / self.length) ** 3

    def scaled(self, factor: float) -> "BeamShape":
        """Return factor times this shape."""
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
class Series(ABC):
    """s from a series in x/l."""

    length: float  # [m]
    coefficients: tuple[float, ...]  # [-]

    def value(self, x: Array | float) -> Array:
        """s(x)."""
        return self._derived(x, 0)

    def slope(self, x: Array | float) -> Array:
        """s'(x)."""
        return self._derived(x, 1) / self.length

    def curvature(self, x: Array | float) -> Array:
        """s''(x)."""
        return self._derived(x, 2) / self.length**2

    def scaled(self, factor: float) -> Self:
        """Return factor times this shape."""
        return replace(self, coefficients=tuple(factor * c for c in self.coefficients))

    @abstractmethod
    def _derived(self, x: Array | float, times: int) -> Array:
        """Derivatives by x/l."""


class PowerShape(Series):
    """s = sum of coefficients[k] (x/l)^k."""

    def _derived(self, x: Array | float, times: int) -> Array:
        coefficients = polynomial.polyder(self.coefficients, times)
        values = polynomial.polyval(np.asarray(x) / self.length, coefficients)
        return np.asarray(values, dtype=np.float64)


def power(exponent: int, length: float) -> PowerShape:
    """(x/l)^exponent."""
    return PowerShape(length=length, coefficients=(*exponent * (0.0,), 1.0))


class LegendreShape(Series):
    """s from l^2 s'', a Legendre series in 2 x/l - 1, with s = s' = 0 at the root."""

    def _derived(self, x: Array | float, times: int) -> Array:
        series = legendre.legint(self.coefficients, 2 - times, lbnd=-1.0, scl=0.5)
        values = legendre.legval(2.0 * np.asarray(x) / self.length - 1.0, series)
        return np.asarray(values, dtype=np.float64)


def hierarchical(index: int, length: float) -> PowerShape | LegendreShape:
    """Polynomials whose curvatures are orthogonal; their degrees are 3, 3, 4, 5, ....

    1: deflection under a tip force, s(l) = 1. 2: s(l) = 0 and l s'(l) = 1; the other shape of a
    beam without mass. From 3 on: l^2 s'' = P_(index - 1), which moves neither tip nor tip slope.
    """
    if index > 2:
        return LegendreShape(length=length, coefficients=(*(index - 1) * (0.0,), 1.0))
    square, cube = {1: (1.5, -0.5), 2: (-1.0, 1.0)}[index]
    return PowerShape(length=length, coefficients=(0.0, 0.0, square, cube))


def unconstrained(
    index: int, length: float, mass: float, inertia: float, root_inertia: float
) -> LegendreShape:
    """Mode `index` of a beam on a free hinge, as a deflection from the tangent at its root.

    Bellezza, Lanari and Ulivi, "Exact modeling of the flexible slewing link" (1990). A Ritz
    solution in Legendre polynomials of the curvature, exact to round-off.

    Parameters
    ----------
    mass : [-] tip mass over beam mass.
    inertia, root_inertia : [-] of the tip and of the hub at the hinge, over rho_A l^3.
    """
    count = index + 14
    nodes, weights = legendre.leggauss(2 * count)
    series = np.eye(count)
    x, tip = 0.5 * (nodes + 1.0), 1.0
    bent = [LegendreShape(length=1.0, coefficients=tuple(row)) for row in series.tolist()]
    values = np.array([x, *(s.value(x) for s in bent)])
    ends = np.array([[tip, *(float(s.value(1.0)) for s in bent)],
                     [1.0, *(float(s.slope(1.0)) for s in bent)]])  # fmt: skip
    M = 0.5 * (values * weights) @ values.T
    M += mass * np.outer(ends[0], ends[0]) + inertia * np.outer(ends[1], ends[1])
    M[0, 0] += root_inertia
    K = np.diag([0.0, *(1.0 / (2.0 * k + 1.0) for k in range(count))])
    inverse = np.linalg.inv(np.linalg.cholesky(M))
    _, turned = np.linalg.eigh(inverse @ K @ inverse.T)
    amplitudes = inverse.T @ turned[:, index]  # column 0 is the rigid rotation
    return LegendreShape(length=length, coefficients=tuple(amplitudes[1:].tolist()))


def clamped_root(index: int, mass: float, inertia: float) -> float:
    """Wave number times length of mode `index` of a cantilever with a body at its tip.

    A tip mass lowers every root, but not below the preceding root of the beam with a pinned tip
    (infinite mass). The same holds for the rotary inertia and a fixed tip slope. These bounds
    bracket exactly one root each.

    Parameters
    ----------
    mass : [-] tip mass over beam mass; infinite: tip pinned.
    inertia : [-] tip inertia over (rho_A l^3); infinite: tip slope fixed.
    """
    if (mass, inertia) in _BRACKETS:
        low, high = ((index + bound) * math.pi for bound in _BRACKETS[mass, inertia])
    elif inertia in (0.0, math.inf):
        low = clamped_root(index - 1, math.inf, inertia) if index > 1 else 0.0
        high = clamped_root(index, 0.0, inertia)
    else:
        low = clamped_root(index - 1, mass, math.inf) if index > 1 else 0.0
        high = clamped_root(index, mass, 0.0)
    if low == 0.0 and mass < math.inf:  # Dunkerley's lower bound
        alone = mass / 3.0 + inertia if inertia < math.inf else mass / 12.0
        low = 0.99 * (1.0 / 1.85**4 + alone) ** -0.25
    return _bisect(lambda beta: _clamped_determinant(beta, mass, inertia), low, high)


def clamped(beta: float, mass: float, inertia: float, length: float) -> BeamShape:
    """Shape cosh - cos - sigma (sinh - sin), clamped at the root, with the tip body's sigma."""
    moment, force = _tip_conditions(beta, mass, inertia)
    # Either condition gives the ratio grow : decay; the larger one has no cancellation.
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
    """Residuals of the moment and force balance at the tip, for two functions clamped at the root.

    f = e^(b(xi - 1)) - e^-b (cos b xi + sin b xi),   g = e^(-b xi) - cos b xi + sin b xi;
    moment: s'' - inertia b^4 s' = 0, force: s''' + mass b^4 s = 0, derivatives in xi.
    """
    end, c, s = math.exp(-beta), math.cos(beta), math.sin(beta)
    f = (1.0 - end * (c + s), 1.0 + end * (s - c), 1.0 + end * (c + s), 1.0 - end * (s - c))
    g = (end - c + s, -end + s + c, end + c - s, -end - s - c)
    p, q = _shares(inertia * beta**3)
    u, w = _shares(mass * beta)
    return ((p * f[2] - q * f[1], p * g[2] - q * g[1]), (u * f[3] + w * f[0], u * g[3] + w * g[0]))


def _shares(ratio: float) -> tuple[float, float]:
    """(1, ratio) scaled to sum one; the ratio may be infinite."""
    return (0.0, 1.0) if ratio == math.inf else (1.0 / (1.0 + ratio), ratio / (1.0 + ratio))


def _clamped_determinant(beta: float, mass: float, inertia: float) -> float:
    moment, force = _tip_conditions(beta, mass, inertia)
    return moment[0] * force[1] - moment[1] * force[0]


def _bisect(function: Callable[[float], float], low: float, high: float) -> float:
    """Root in a bracket to the last bit; without a sign change, the end nearest to a root."""
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
