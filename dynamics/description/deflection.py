"""Displacement and strain of a link from its modal amplitudes."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from dynamics.description.link import Link
from dynamics.description.mode_shapes import BENDING, shape
from dynamics.types import Array, Vector3

DISPLACEMENT: dict[str, Vector3] = {  # times s
    "x": (0, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "axial": (1, 0, 0),
}  # fmt: skip
TILT: dict[str, Vector3] = {  # times s'
    "x": (0, 0, 0), "y": (0, 0, 1), "z": (0, -1, 0), "axial": (0, 0, 0),
}  # fmt: skip
TWIST: dict[str, Vector3] = {  # times s
    "x": (1, 0, 0), "y": (0, 0, 0), "z": (0, 0, 0), "axial": (0, 0, 0),
}  # fmt: skip
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


def deflection(link: Link, delta: Iterable[float], x: Array) -> Array:
    """Elastic displacement of a link at the points x, in the link's frame.

    Parameters
    ----------
    delta : (m,) [m] modal amplitudes.
    x : (n,) [m] positions along the undeformed link.

    Returns
    -------
    (n, 3) [m]
    """
    displacements, _ = _shapes(link, tuple(x.tolist()))
    return _combined(delta, displacements)


def shortening(link: Link, delta: Iterable[float], x: Array) -> Array:
    """Displacement along the link by foreshortening, u = -1/2 int_0^x (y'^2 + z'^2).

    Parameters
    ----------
    delta : (m,) [m] modal amplitudes.
    x : (n,) [m] positions along the undeformed link.

    Returns
    -------
    (n,) [m]
    """
    _, slopes = _shapes(link, tuple(x.tolist()))
    result: Array = -0.25 * x * (np.sum(_combined(delta, slopes) ** 2, axis=0) @ WEIGHTS)
    return result


@lru_cache(maxsize=256)
def _shapes(link: Link, x: tuple[float, ...]) -> tuple[Array, Array]:
    """Displacements (m, n, 3) [-] and slopes (m, 2, n, 24) [1/m] per unit amplitude of each mode.

    Slopes are those towards y and z at the nodes between the root and each point. A picture of
    an arm is drawn many times at the same points.
    """
    inside = 0.5 * np.outer(x, NODES + 1.0)
    displacements = np.zeros((len(link.modes), len(x), 3))
    slopes = np.zeros((len(link.modes), 2, *inside.shape))
    for k, mode in enumerate(link.modes):
        s = shape(mode, link.beam)
        displacements[k] = np.outer(s.value(np.array(x)), DISPLACEMENT[mode.direction])
        if mode.direction in BENDING:
            slopes[k, BENDING.index(mode.direction)] = s.slope(inside)
    return displacements, slopes


def _combined(delta: Iterable[float], each: Array) -> Array:
    """Sum of (m, ...) times the amplitudes delta (m,)."""
    return np.tensordot(np.fromiter(delta, np.float64, len(each)), each, axes=1)


def curvature(link: Link, x: float) -> Array:
    """Twist per length and curvatures at x, per unit amplitude of each mode.

    Returns
    -------
    (m, 3) [1/m^2] about x: s' of a torsion mode; about y: -s'' of a "z" mode; about z: s'' of a
    "y" mode.
    """
    rows = []
    for mode in link.modes:
        s = shape(mode, link.beam)
        about = TWIST if mode.direction == "x" else TILT
        rate = s.curvature(x) if mode.direction in BENDING else s.slope(x)
        rows.append(float(rate) * np.array(about[mode.direction]))
    return np.array(rows).reshape(-1, 3)
