"""Linearized arm about rest with straight links: M a + C v + K q = B tau."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from dynamics.description.validate import double_precision
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.link_constants import LinkConstants
from dynamics.integrators.exponential import FrozenModes
from dynamics.integrators.newmark import EXPLICIT, FAST_BETA, SAFE
from dynamics.types import Array

_RIGID = 1e-9  # [-] squared frequencies below this fraction of the largest are rigid motions
_POSTURES = (0.0, 1.0)  # [rad] of all revolute joints, at which `explicit_steps` looks
_ROUND_OFF = 1e-13  # [-] modal entries below this fraction of their bound are set to zero


def inertia(chain: Chain, q: Array) -> Array:
    """(n, n) M at q."""
    return np.array(mass_matrix(chain, [float(x) for x in q]), dtype=np.float64)


def stiffness(chain: Chain) -> Array:
    """(n, n) stiffness K of modes and joint springs."""
    return _assemble(chain, lambda link: link.K, lambda link: link.spring)


def damping(chain: Chain) -> Array:
    """(n, n) damping C of modes and viscous joint friction."""
    return within_bodies(chain) + across_segments(chain)


def within_bodies(chain: Chain) -> Array:
    """(n, n) part of C that implicit methods take implicitly."""
    return _assemble(chain, lambda link: link.damping, lambda link: link.viscous)


def across_segments(chain: Chain) -> Array:
    """(n, n) part of C that couples the segments of links; implicit methods take it explicitly."""
    C = np.zeros((sum(len(link.K) + (not link.welded) for link in chain.links),) * 2)
    for damper in chain.dampers:
        rows = slice(damper.first, damper.first + len(damper.u))
        C[rows, rows] += damper.rate * np.outer(damper.u, damper.u)
    return C


def friction(chain: Chain) -> Array:
    """(n, n) damping by Coulomb friction at zero rate, where its slope is largest."""
    return _assemble(chain, lambda link: (), lambda link: link.coulomb / link.coulomb_speed)


def frequencies(M: Array, K: Array, elastic: int, locked: Sequence[int] = ()) -> Array:
    """(elastic,) [rad/s] highest natural frequencies of M and K; `locked` coordinates are fixed.

    Those below the geometric mean of the slowest and the fastest are the reciprocals of periods:
    round-off of the fastest, relative to its square, would hide the slow ones of a stiff arm.
    """
    from scipy.linalg import eigh

    moving = np.setdiff1d(np.arange(len(M)), locked)
    moving = moving[np.argsort(K[:, moving].any(axis=0), kind="stable")]  # rigid motions first
    M, K = M[np.ix_(moving, moving)], K[np.ix_(moving, moving)]
    bent = slice(len(moving) - elastic, None)
    with double_precision("The arm's frequencies"):
        root = np.linalg.cholesky(M)[bent, bent]
        M, K = root @ root.T, K[bent, bent]  # of the bending, rigid motions following freely
        fast = eigh(K, M, eigvals_only=True)
        slow = 1.0 / eigh(M, K, eigvals_only=True)[::-1]
        squares = np.where(fast * fast > slow[:1] * fast[-1:], fast, slow)
    return np.asarray(np.sqrt(squares))


def _assemble(
    chain: Chain, modal: Callable[[LinkConstants], object], joint: Callable[[LinkConstants], float]
) -> Array:
    """(n, n) from a block per link's modes and a coefficient per joint.

    The coefficient acts on the joint coordinate plus the modal rotation of the root.
    """
    sizes = [len(link.K) + (not link.welded) for link in chain.links]
    result, first = np.zeros((sum(sizes), sum(sizes))), 0
    for link, size in zip(chain.links, sizes, strict=True):
        m = len(link.K)
        block = np.reshape(np.array(modal(link), dtype=np.float64), (-1, m)) if m else np.zeros(0)
        modes = slice(first + size - m, first + size)
        if block.size:
            result[modes, modes] = block
        if not link.welded:
            slip = np.array([1.0, *link.root_slope])
            result[first : first + size, first : first + size] += joint(link) * np.outer(slip, slip)
        first += size
    return result


@dataclass(frozen=True)
class LinearArm:
    """Matrices (n, n) of the linearized arm at one posture."""

    M: Array
    K: Array
    C: Array  # modes and viscous joint friction: the damping that implicit methods include
    explicit: Array  # other damping: across segments, and Coulomb friction at zero joint rates
    aid: Callable[[str], Any]  # what an integrator knows of the arm, by `Integrator.aid`


def linear_arm(chain: Chain, q: Array) -> LinearArm:
    """Linearize the arm about rest at q (n,) with straight links."""
    known = lru_cache(lambda kind: aid(kind, chain))
    explicit = friction(chain) + across_segments(chain)
    return LinearArm(inertia(chain, q), stiffness(chain), within_bodies(chain), explicit, known)


def aid(kind: str, chain: Chain) -> FrozenModes | Array | None:
    """Constants of the arm that an integrator works with: `Integrator.aid` but for a Jacobian."""
    if kind == "modes":
        return frozen_modes(chain)
    return explicit_steps(chain) if kind == "explicit steps" else None


def frozen_modes(chain: Chain) -> FrozenModes:
    """Modes of the straight arm with free joints; damping between modes is neglected."""
    from scipy.linalg import eigh

    M = inertia(chain, np.zeros(len(stiffness(chain))))
    squares, S = eigh(stiffness(chain), M)
    elastic = squares > _RIGID * squares.max(initial=0.0)
    decays = np.einsum("ik,ij,jk->k", S, damping(chain), S)
    bounds = np.sqrt(np.diag(M)), np.linalg.norm(S, axis=1)  # of the entries, as S' M S = 1
    L, back = (
        x * (np.abs(x) > _ROUND_OFF * bound)
        for x, bound in zip((S.T @ M, S.T), bounds, strict=True)
    )
    return FrozenModes(squares * elastic, decays * elastic, L, back.T, back @ inputs(chain))


def inputs(chain: Chain) -> Array:
    """(n, n_torque) generalized forces B of unit torques: joints, then a driven base."""
    sizes = [len(link.K) + (not link.welded) for link in chain.links]
    columns, first = [], 0
    for link, size in zip(chain.links, sizes, strict=True):
        if link.driven:
            column = np.zeros(sum(sizes))
            column[first : first + size] = (1.0, *link.root_slope)
            columns.append(column)
        first += size
    if chain.driven_base:  # comes first in the chain
        columns = [*columns[1:], columns[0]]
    return np.array(columns).reshape(len(columns), sum(sizes)).T


def explicit_steps(chain: Chain) -> Array:
    """(n,) [s] longest step at which each coordinate can do with Numerov's beta; at most infinite.

    With one beta per coordinate a step is stable if M - h/3 C - h^2 sum (1/4 - beta) K is positive,
    C being the slow coordinates' damping. As h grows and this fails, the coordinate that takes the
    largest part in the failing motion gets FAST_BETA, with all that K or C couple it to. Steps are
    SAFE times the limits.
    """
    K, C = stiffness(chain), damping(chain)
    inertias = [inertia(chain, _posture(chain, angle)) for angle in _POSTURES]
    block, fast = _coupled(K, C), np.zeros(len(K), dtype=bool)
    steps = np.full(len(K), np.inf)
    while np.any((K + C) * ~fast):
        slow = np.diag(1.0 - fast)
        elastic, shape = _largest(
            (0.25 - EXPLICIT) * slow @ K - (FAST_BETA - 0.25) * K @ np.diag(fast), inertias
        )
        decay, motion = _largest(slow @ C / 3.0, inertias)
        limit = 2.0 / (decay + np.sqrt(decay**2 + 4.0 * elastic))  # h decay + h^2 elastic = 1
        if decay > limit * elastic:
            shares = motion * (slow @ C @ motion)
        else:
            shares = shape * (slow @ K @ shape)
        chosen = block == block[np.argmax(shares)]
        fast |= chosen
        steps[chosen] = SAFE * limit
    return steps


def _largest(A: Array, inertias: Sequence[Array]) -> tuple[float, Array]:
    """Largest eigenvalue, at least zero, of A x = w M x with any of the M, and its x (n,)."""
    from scipy.linalg import eigh

    last = [len(A) - 1, len(A) - 1]
    pairs = [eigh(A, M, subset_by_index=last) for M in inertias]
    value, vector = max(pairs, key=lambda pair: float(pair[0][0]))
    return max(float(value[0]), 0.0), vector[:, 0]


def _coupled(K: Array, C: Array) -> Array:
    """(n,) label of each coordinate, equal for those that K or C couple."""
    from scipy.sparse.csgraph import connected_components

    labels: Array = connected_components((K != 0.0) | (C != 0.0), directed=False)[1]
    return labels


def _posture(chain: Chain, angle: float) -> Array:
    """(n,) coordinates with all driven revolute joints at `angle` [rad]."""
    q: list[float] = []
    for link in chain.links:
        turns = link.driven and not link.prismatic
        q += ([] if link.welded else [angle * turns]) + [0.0] * len(link.K)
    return np.array(q)
