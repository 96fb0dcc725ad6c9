"""Integrals over the mode shapes of one link, and over the foreshortening by pairs of them."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from dynamics.description.arm import FOURTH_ORDER
from dynamics.description.beams.sections import edges
from dynamics.description.deflection import DISPLACEMENT, TWIST
from dynamics.description.link import Link
from dynamics.description.mode_shapes import BENDING, STIFFNESS, Shape, points, shape
from dynamics.types import Array

_ROUND_OFF = 1e-12  # [-] integrals below this fraction of their natural size are set to zero
_E_X = np.array((1.0, 0.0, 0.0))


class BeamIntegrals(NamedTuple):
    """Integrals over 0 <= x <= l of m modal and p foreshortening shapes, and their end values."""

    pairs: tuple[tuple[int, int], ...]  # (p) modes of each foreshortening shape
    along: Array  # (m + p, 3) direction of displacement; zero for torsion
    twist: Array  # (m + p) 1 for torsion, else 0
    zeroth: Array  # (m + p) int r s_j, with r the inertia per length of s_j over its mean
    first: Array  # (m + p) int r x s_j
    square: Array  # (m + p, m + p) int r s_j s_k; to fourth order only of two modes
    share: float  # [m] int r g^2 / g(l)^2 of the foreshortening by first modes, mean of directions
    K_pairs: Array  # (p, p) stiffness of foreshortening
    tip: Array  # (m + p) s_j(l)
    tip_slope: Array  # (m) s_j'(l)
    root_slope: Array  # (m + p) s_j'(0) of pinned-free modes, else 0
    K: Array  # (m, m) stiffness


def beam_integrals(link: Link, foreshortening: bool | str) -> BeamIntegrals:
    """Integrals of a link in one piece."""
    l = link.length
    x, weights = points(link.beam, link.modes)
    shapes = [shape(mode, link.beam) for mode in link.modes]
    pairs, shortening, shortening_tip = _shortening(link, shapes, x, weights, bool(foreshortening))
    values = np.vstack([_table([s.value(x) for s in shapes], x.size), shortening])
    along = np.array([DISPLACEMENT[mode.direction] for mode in link.modes]).reshape(-1, 3)
    twist = np.array([TWIST[mode.direction][0] for mode in link.modes])
    root_slope = np.zeros(len(values))
    for j, mode in enumerate(link.modes):
        if mode.kind == "pinned-free":
            root_slope[j] = float(shapes[j].slope(0.0))
    heavy = values * _densities(link, x, len(pairs))
    square = (heavy * weights) @ values.T
    size = np.sqrt(np.diag(square))
    tip = np.array([*(float(s.value(l)) for s in shapes), *shortening_tip])
    share = _first_share(link, pairs, np.diag(square)[len(shapes) :], shortening_tip)
    if foreshortening == FOURTH_ORDER:
        square[len(shapes) :] = square[:, len(shapes) :] = 0.0
    tip_slope = np.array([float(s.slope(l)) for s in shapes])
    return BeamIntegrals(
        pairs=pairs,
        along=np.vstack([along, np.tile(_E_X, (len(pairs), 1))]),
        twist=np.append(twist, np.zeros(len(pairs))),
        zeroth=_snap(heavy @ weights, math.sqrt(l) * size),
        first=_snap(heavy @ (weights * x), l**1.5 * size),
        square=_snap(square, np.outer(size, size)),
        tip=_snap(tip, size / math.sqrt(l)),
        tip_slope=_snap(tip_slope, size[: len(shapes)] / l**1.5),
        root_slope=root_slope,
        K=_stiffness(link, shapes, x, weights),
        share=share,
        K_pairs=_pair_stiffness(link, shapes, pairs, x, weights),
    )


def _stiffness(link: Link, shapes: list[Shape], x: Array, weights: Array) -> Array:
    """(m, m) int GJ or EA s_j' s_k' (torsion, axial), int EI s_j'' s_k'' (bending).

    Modes in different directions are not coupled.
    """
    bent = _table(
        [
            s.curvature(x) if mode.direction in BENDING else s.slope(x)
            for s, mode in zip(shapes, link.modes, strict=True)
        ],
        x.size,
    )
    names = [STIFFNESS[mode.direction] for mode in link.modes]
    rigidity = np.array([link.mean(name) for name in names])
    along = _table([link.beam.share(name, x) for name in names], x.size)
    same = np.array([[j.direction == k.direction for k in link.modes] for j in link.modes])
    K = (bent * (weights * along)) @ bent.T * same.reshape(len(shapes), len(shapes))
    size = np.sqrt(np.diag(K))
    return rigidity.reshape(-1, 1) * _snap(K, np.outer(size, size))


def _pair_stiffness(
    link: Link, shapes: list[Shape], pairs: tuple[tuple[int, int], ...], x: Array, weights: Array
) -> Array:
    """(p, p) int EI g_a'' g_b'', g_jk'' = (s_j' s_k')'; of two directions with their mean EI.

    The curvature of a beam that keeps its length is y''^2 + z''^2 + u''^2, u' = -(y'^2 + z'^2)/2.
    """
    curved = _table(
        [
            shapes[j].curvature(x) * shapes[k].slope(x)
            + shapes[j].slope(x) * shapes[k].curvature(x)
            for j, k in pairs
        ],
        x.size,
    )
    names = [STIFFNESS[link.modes[j].direction] for j, _ in pairs]
    EI = np.array([link.mean(name) for name in names])
    if link.sections:
        along = _table([link.beam.share(name, x) for name in names], x.size)
        half = 0.5 * EI[:, None] * ((curved * (weights * along)) @ curved.T)
        size = np.sqrt(np.diag(half))
        return _snap(half + half.T, np.outer(size, size))
    K = (curved * weights) @ curved.T
    size = np.sqrt(np.diag(K))
    return 0.5 * (EI.reshape(-1, 1) + EI) * _snap(K, np.outer(size, size))


def _densities(link: Link, x: Array, count: int) -> Array:
    """(m + p, n) inertia per length of every shape over its mean; `count` is p."""
    names = ["rho_Ip" if TWIST[mode.direction][0] else "rho_A" for mode in link.modes]
    return _table([link.beam.share(name, x) for name in [*names, *count * ["rho_A"]]], x.size)


def _first_share(
    link: Link, pairs: tuple[tuple[int, int], ...], squares: Array, tips: list[float]
) -> float:
    """[m] int g^2 / g(l)^2 of each direction's first pair, on average."""
    first: dict[str, float] = {}
    for (j, _), square, tip in zip(pairs, squares, tips, strict=True):
        if link.modes[j].direction not in first:
            first[link.modes[j].direction] = float(square) / tip**2
    return sum(first.values()) / max(1, len(first))


def _shortening(
    link: Link, shapes: list[Shape], x: Array, weights: Array, wanted: bool
) -> tuple[tuple[tuple[int, int], ...], Array, list[float]]:
    """Foreshortening: pairs j, k of modes, g_jk = int_0^x s_j' s_k' at the points x, and at l."""
    directions = [mode.direction for mode in link.modes]
    pairs = tuple(
        (j, k)
        for j in range(len(shapes))
        for k in range(j, len(shapes))
        if wanted and directions[j] == directions[k] in BENDING
    )
    if not pairs:
        return (), _table([], x.size), []
    slopes = [s.slope(x) for s in shapes]
    ends = edges(link.sections) if link.sections else (0.0, link.length)
    count = x.size // (len(ends) - 1)
    values, tips = np.empty((len(pairs), x.size)), np.zeros(len(pairs))
    for piece, (begin, end) in enumerate(pairwise(ends)):
        # integrate the Legendre interpolant through the nodes of the quadrature
        at, size = slice(piece * count, (piece + 1) * count), end - begin
        node = 2.0 * (x[at] - begin) / size - 1.0
        basis = legendre.legvander(node, count - 1)
        norms = (2.0 * np.arange(count) + 1.0) / size
        to_series = norms[:, None] * (basis * weights[at][:, None]).T
        for row, (j, k) in enumerate(pairs):
            inside = to_series @ (slopes[j][at] * slopes[k][at])
            series = legendre.legint(inside, lbnd=-1.0, scl=size / 2.0)
            values[row, at] = tips[row] + legendre.legval(node, series)
            tips[row] += float(legendre.legval(1.0, series))
    return pairs, values, tips.tolist()


def _table(rows: list[Array], columns: int) -> Array:
    return np.array(rows, dtype=np.float64).reshape(len(rows), columns)


def _snap(values: Array, size: Array) -> Array:
    """Set values that are round-off relative to their natural size to zero."""
    return np.where(np.abs(values) <= _ROUND_OFF * size, 0.0, values)
