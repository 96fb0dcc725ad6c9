"""Shapes of beams of sections: polynomials in pieces, whose curvature may jump between them.

Natural modes are Ritz solutions in Legendre polynomials of the curvature in every piece. Other
shapes follow from their bending moment, torque or normal force, which is smooth across a step.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from dynamics.types import Array

Edges = tuple[float, ...]  # (n + 1) [m] ends of the pieces
Profile = Callable[[Array], Array]  # of positions [m]
_TERMS = 16  # beyond the index of a shape, spread over the pieces
_LEAST = 6  # in every piece, beyond that


@dataclass(frozen=True, kw_only=True)
class PieceShape:
    """s from a Legendre series in every piece: of s'' with s(0) = 0 and s'(0) = root, or of s'."""

    edges: Edges
    series: tuple[tuple[float, ...], ...]  # (n, terms)
    order: int  # of the derivative that the series is: 2 in bending, 1 in torsion and stretching
    root: float = 0.0  # [1/m] s'(0) in bending

    def value(self, x: Array | float) -> Array:
        """s(x)."""
        return self._derivative(x, 0)

    def slope(self, x: Array | float) -> Array:
        """s'(x)."""
        return self._derivative(x, 1)

    def curvature(self, x: Array | float) -> Array:
        """s''(x); at a step that of the outer piece."""
        return self._derivative(x, 2)

    def third(self, x: Array | float) -> Array:
        """Third derivative of s(x)."""
        return self._derivative(x, 3)

    def scaled(self, factor: float) -> "PieceShape":
        """Return factor times this shape."""
        rows = tuple(tuple(factor * c for c in row) for row in self.series)
        return replace(self, series=rows, root=factor * self.root)

    def _derivative(self, x: Array | float, order: int) -> Array:
        points = np.ravel(np.asarray(x, dtype=np.float64))
        series = np.array(self.series)[:, :, None]
        found = _integrated(self.edges, series, points, self.order - order, self.root)
        return found.reshape(np.shape(x))


def gauss(edges: Edges, count: int) -> tuple[Array, Array]:
    """Gauss-Legendre points [m] and weights, `count` in every piece."""
    nodes, weights = legendre.leggauss(count)
    begins, sizes = np.array(edges[:-1])[:, None], np.diff(edges)[:, None]
    return (begins + 0.5 * sizes * (nodes + 1.0)).ravel(), (0.5 * sizes * weights).ravel()


def natural(
    index: int, edges: Edges, rigidity: Profile, density: Profile, order: int,
    tip: tuple[float, float], hub: float | None,
) -> PieceShape:  # fmt: skip
    """Natural mode `index` of a beam that is clamped, or hinged to a hub, at its root.

    Parameters
    ----------
    rigidity, density : EI and rho_A of bending (order 2), or GJ and rho_Ip, EA and rho_A (order 1).
    tip : mass [kg] and rotary inertia [kg m^2] of the body at the tip.
    hub : inertia [kg m^2] that turns with a hinged root; None: clamped.
    """
    from scipy.linalg import eigh

    terms = _LEAST + -(-(index + _TERMS) // (len(edges) - 1))
    x, weights = gauss(edges, terms + 4)
    count = (len(edges) - 1) * terms
    basis = np.eye(count).reshape(-1, terms, count)
    bent, values = (_integrated(edges, basis, x, times) for times in (0, order))
    end = np.array(edges[-1:])
    ends = [_integrated(edges, basis, end, times)[0] for times in (order, order - 1)]
    loads = weights * density(x)
    K = (bent.T * (weights * rigidity(x))) @ bent
    M = (values.T * loads) @ values
    for mass, moved in zip(tip, ends, strict=True):
        M += mass * np.outer(moved, moved)
    turning = np.zeros(count)
    if hub is not None:  # an elastic mode has no angular momentum about the hinge
        inertia = float(loads @ x**2) + hub + tip[0] * edges[-1] ** 2 + tip[1]
        coupling = values.T @ (loads * x) + tip[0] * edges[-1] * ends[0] + tip[1] * ends[1]
        turning = -coupling / inertia
        M += np.outer(coupling, turning)
    _, found = eigh(M, K, subset_by_index=[count - index, count - index])
    found *= np.sign(ends[0] @ found)
    return _shape(edges, found.reshape(-1, terms), order, root=float(turning @ found[:, 0]))


def loaded(edges: Edges, load: Profile, rigidity: Profile, terms: int, order: int) -> PieceShape:
    """Shape of a clamped beam under a bending moment (order 2), torque or normal force (order 1).

    `terms` are those of the load; the rigidity has _TERMS more.
    """
    count = terms + _TERMS
    x, weights = gauss(edges, count)
    basis = legendre.legvander(legendre.leggauss(count)[0], count - 1)
    pieces = (weights * load(x) / rigidity(x)).reshape(-1, count)
    series = (pieces @ basis) * (2.0 * np.arange(count) + 1.0) / np.diff(edges)[:, None]
    return _shape(edges, series, order)


def hierarchical(index: int, edges: Edges, rigidity: Profile) -> PieceShape:
    """Shapes like `uniform.hierarchical` whose bending moments are polynomials, orthogonal by 1/EI.

    From the third on they move neither tip nor tip slope, and l^2 EI s'' begins with the harmonic
    mean of EI times P_(index - 1).
    """
    l = edges[-1]
    x, weights = gauss(edges, index + _TERMS)
    soft = weights / rigidity(x)
    if index > 2:
        root = np.sqrt(soft)[:, None] * legendre.legvander(2.0 * x / l - 1.0, index - 1)
        R = np.linalg.qr(root, mode="r")
        moment = np.linalg.solve(R, np.eye(index)[-1])
        moment /= moment[-1] * l * float(soft.sum())
    else:  # tip deflection and tip slope by the moments 1 and 2 x/l - 1
        moments = np.vstack([np.ones(x.size), 2.0 * x / l - 1.0]) * soft
        moved, turned = moments @ (l - x), l * moments.sum(axis=1)
        rows = np.array([(1.0, 1.0), moved] if index == 1 else [moved, turned])
        moment = np.linalg.solve(rows, np.array([0.0, 1.0]))

    def load(x: Array) -> Array:
        return np.asarray(legendre.legval(2.0 * x / l - 1.0, moment), dtype=np.float64)

    return loaded(edges, load, rigidity, index, 2)


def _shape(edges: Edges, series: Array, order: int, root: float = 0.0) -> PieceShape:
    rows = tuple(tuple(row) for row in series.tolist())
    return PieceShape(edges=edges, series=rows, order=order, root=root)


def _integrated(edges: Edges, series: Array, x: Array, times: int, root: float = 0.0) -> Array:
    """(N, columns) series (n, terms, columns) at x (N,), integrated once or twice from 0.

    `root` is the slope at 0, of series integrated twice or once; times < 0 are derivatives.
    """
    sizes = np.diff(edges)[:, None, None]
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(sizes) - 1)
    along = x - np.array(edges)[place]
    node = (2.0 * along / sizes[place, 0, 0] - 1.0)[:, None]

    def inside(pieces: Array) -> Array:
        return np.asarray(legendre.legval(node, np.moveaxis(pieces[place], 1, 0), tensor=False))

    if times <= 0:
        return inside(legendre.legder(series, -times, scl=2.0, axis=1) * sizes**times)
    once, twice = (
        legendre.legint(series, k, lbnd=-1.0, scl=0.5, axis=1) * sizes**k for k in (1, 2)
    )
    slopes = root + _begins(once.sum(axis=1))
    if times == 1:
        return inside(once) + slopes[place]
    values = _begins(twice.sum(axis=1) + sizes[:, 0] * slopes)
    return inside(twice) + along[:, None] * slopes[place] + values[place]


def _begins(steps: Array) -> Array:
    """Sums of all steps before each."""
    return np.cumsum(steps, axis=0) - steps
