"""A damping ratio that belongs to a link as a whole, and the rigidities that let a link yield.

A damping ratio is that of every natural mode of the link alone, clamped at its joint, with its tip
body and without a payload. Listed beam shapes and powers have it each for itself
(link_constants.py), which is the same for shapes that are natural modes. Hierarchical and
unconstrained shapes, more than one polynomial of torsion or stretching, lumped links and segments
get it from the natural modes phi that the link has in its own coordinates, with phi' M phi = 1:

    C = sum 2 zeta omega (M phi)(M phi)'

In segments this matrix couples all bodies of the link, so it is split. The first MODES modes along
each direction have a damper each, and a viscosity, C = beta K, acts in every segment. Both together
give these modes the ratio; the modes above have the viscosity alone, which damps them more.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynamics.description.arm import Arm
from dynamics.description.link import Link
from dynamics.description.mode_shapes import STIFFNESS
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.formulations.kinematics import Chain, Damper
from dynamics.formulations.link_constants import (
    LinkConstants,
    chain_constants,
    link_constants,
    parts,
)
from dynamics.types import Array

MODES = 5  # natural modes along a direction that have the damping ratio, of a link in segments
WHOLE = {"hierarchical", "unconstrained"}  # kinds that are damped together
SERIES = ("torsion-poly", "axial-poly")  # kinds of which several shapes are damped together
Bodies = tuple[LinkConstants, ...]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class NaturalModes:
    """Natural modes of the coordinates `rows` of a link, alone and clamped."""

    rows: IntArray  # (m,) indices
    omega: Array  # (m,) [rad/s] ascending
    forces: Array  # (m, m) M phi, a column per mode, with phi' M phi = 1


def damped_chain(arm: Arm) -> tuple[list[Bodies], tuple[Damper, ...]]:
    """Bodies of every link, and the dampers across the segments of links."""
    links: list[Bodies] = []
    dampers: list[Damper] = []
    stop = arm.base.n
    for link, bodies in zip(arm.links, chain_constants(arm), strict=True):
        stop += link.n
        if link.segments > 1 and link.damping_ratio and link.modes:
            before, own = bodies[: -link.segments], bodies[-link.segments :]
            betas, across = _split(link, stop - link.segments * len(link.modes))
            viscous = [_with(body, beta) for body, beta in zip(own, betas, strict=True)]
            bodies, dampers = (*before, *viscous), dampers + across
        elif link.damping_ratio and _as_a_whole(link):
            bodies = (*bodies[:-1], replace(bodies[-1], damping=_matrix(link)))
        links.append(bodies)
    return links, tuple(dampers)


def natural_modes(link: Link) -> list[NaturalModes]:
    """Natural modes of a link alone, clamped at its joint, for each set of coupled coordinates.

    Coordinates that move no mass are left out.
    """
    listed = replace(link, damping_ratio=0.0, modes=tuple(link.modes))
    chain = Chain(tuple(link_constants(part, welded=True) for part in parts(listed)))
    n, m = len(chain.links) * len(link.modes), len(link.modes)
    M, K = np.array(mass_matrix(chain, n * [0.0]), dtype=np.float64), np.zeros((n, n))
    for k, body in enumerate(chain.links):
        K[k * m : (k + 1) * m, k * m : (k + 1) * m] = body.K
    result = []
    for rows in _coupled(M, K):
        root = np.linalg.cholesky(M[np.ix_(rows, rows)])
        inverse = np.linalg.inv(root)
        squares, turned = np.linalg.eigh(inverse @ K[np.ix_(rows, rows)] @ inverse.T)
        result.append(NaturalModes(rows, np.sqrt(squares), root @ turned))
    return result


def yields(link: Link, direction: str) -> bool:
    """True if a link has a rigidity in a direction, with or without modes in it.

    A link with a body and no modes at all is rigid.
    """
    bends = link.body is None or bool(link.modes)
    return bends and bool(link.mean(STIFFNESS[direction]))


def _as_a_whole(link: Link) -> bool:
    """True if the ratio of a link in one piece is that of its natural modes, not of its shapes."""
    kinds = [mode.kind for mode in link.modes]
    several = any(kinds.count(kind) > 1 for kind in SERIES)
    return link.lumped or several or bool(WHOLE.intersection(kinds))


def _matrix(link: Link) -> tuple[tuple[float, ...], ...]:
    """(m, m) damping matrix of a link in one piece."""
    C = np.zeros((len(link.modes), len(link.modes)))
    for found in natural_modes(link):
        damped = 2.0 * link.damping_ratio * (found.forces * found.omega) @ found.forces.T
        C[np.ix_(found.rows, found.rows)] = damped
    return tuple(map(tuple, C.tolist()))


def _split(link: Link, first: int) -> tuple[Array, list[Damper]]:
    """Viscosity [s] per segment and mode, and dampers over the coordinates from `first` on."""
    n = link.segments * len(link.modes)
    betas, dampers = np.zeros(n), []
    for found in natural_modes(link):
        exact = min(MODES, found.omega.size)
        beta = betas[found.rows] = 2.0 * link.damping_ratio / found.omega[exact - 1]
        rates = 2.0 * link.damping_ratio * found.omega - beta * found.omega**2
        for k in range(exact - 1):
            push = np.zeros(n)
            push[found.rows] = found.forces[:, k]
            dampers.append(Damper(first, float(rates[k]), tuple(push.tolist())))
    return betas.reshape(link.segments, -1), dampers


def _with(body: LinkConstants, betas: Array) -> LinkConstants:
    """A body with the viscosity of each of its modes."""
    C = betas[:, None] * np.array(body.K)
    return replace(body, damping=tuple(map(tuple, C.tolist())))


def _coupled(M: Array, K: Array) -> list[IntArray]:
    """Indices of each set of coordinates that M or K couple, without those that move no mass."""
    linked = (M != 0.0) | (K != 0.0)
    for _ in range(len(M).bit_length()):
        linked = linked @ linked
    sets = {tuple(np.flatnonzero(row)) for row, own in zip(linked, M, strict=True) if own.any()}
    return [np.array(rows) for rows in sorted(sets)]
