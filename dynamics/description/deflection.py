"""Displacement and strain of a link from its modal amplitudes."""

from collections.abc import Iterable

import numpy as np

from dynamics.description.link import Link
from dynamics.description.mode_shapes import shape
from dynamics.types import Array, Vector3

BENDING = ("y", "z")  # directions whose strain is s''; in the others it is s'
DISPLACEMENT: dict[str, Vector3] = {  # times s
    "x": (0, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "axial": (1, 0, 0),
}  # fmt: skip
TILT: dict[str, Vector3] = {  # times s'
    "x": (0, 0, 0), "y": (0, 0, 1), "z": (0, -1, 0), "axial": (0, 0, 0),
}  # fmt: skip
TWIST: dict[str, Vector3] = {  # times s
    "x": (1, 0, 0), "y": (0, 0, 0), "z": (0, 0, 0), "axial": (0, 0, 0),
}  # fmt: skip


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
    x = np.asarray(x, dtype=np.float64)
    result = np.zeros((x.size, 3))
    for mode, d in zip(link.modes, delta, strict=True):
        result += d * np.outer(shape(mode, link.beam).value(x), DISPLACEMENT[mode.direction])
    return result


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
    x = np.asarray(x, dtype=np.float64)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    inside = 0.5 * np.outer(x, nodes + 1.0)  # from the root to each point
    slopes = np.zeros((2, *inside.shape))
    for mode, d in zip(link.modes, delta, strict=True):
        if mode.direction in BENDING:
            slopes[BENDING.index(mode.direction)] += d * shape(mode, link.beam).slope(inside)
    result: Array = -0.25 * x * (np.sum(slopes**2, axis=0) @ weights)
    return result


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
