"""Linearized arm about rest with straight links: M a + C v + K q = B tau."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.description.validate import double_precision
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.link_constants import LinkConstants
from dynamics.integrators.exponential import FrozenModes
from dynamics.types import Array

_RIGID = 1e-9  # [-] squared frequencies below this fraction of the largest are rigid motions
_ROUND_OFF = 1e-13  # [-] modal entries below this fraction of their bound are set to zero


def inertia(chain: Chain, q: Array) -> Array:
    """(n, n) M at q."""
    return np.array(mass_matrix(chain, [float(x) for x in q]), dtype=np.float64)


def stiffness(chain: Chain) -> Array:
    """(n, n) stiffness K of modes and joint springs."""
    return _assemble(chain, lambda link: link.K, lambda link: link.spring)


def damping(chain: Chain) -> Array:
    """(n, n) damping C of modes and viscous joint friction."""
    return _assemble(chain, lambda link: link.damping, lambda link: link.viscous)


def friction(chain: Chain) -> Array:
    """(n, n) damping by Coulomb friction at zero rate, where its slope is largest."""
    return _assemble(chain, lambda link: (), lambda link: link.coulomb / link.coulomb_speed)


def frequencies(M: Array, K: Array, elastic: int, locked: Sequence[int] = ()) -> Array:
    """(elastic,) [rad/s] highest natural frequencies of M and K; `locked` coordinates are fixed."""
    from scipy.linalg import eigh

    moving = np.setdiff1d(np.arange(len(M)), locked)
    M, K = M[np.ix_(moving, moving)], K[np.ix_(moving, moving)]
    with double_precision("The arm's frequencies"):
        squares = eigh(K, M, eigvals_only=True)
    return np.asarray(np.sqrt(np.abs(squares[squares.size - elastic :])))


def _assemble(
    chain: Chain,
    modal: Callable[[LinkConstants], object],
    joint: Callable[[LinkConstants], float],
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
    """Matrices (n, n) of the linearized arm at one posture, and the straight arm's modes."""

    M: Array
    K: Array
    C: Array  # modes and viscous joint friction: the damping that implicit methods include
    friction: Array  # Coulomb friction at zero joint rates
    frozen: FrozenModes


def linear_arm(chain: Chain, q: Array) -> LinearArm:
    """Linearize the arm about rest at q (n,) with straight links."""
    modes = frozen_modes(chain)
    return LinearArm(inertia(chain, q), stiffness(chain), damping(chain), friction(chain), modes)


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
    return FrozenModes(squares * elastic, decays * elastic, L, back.T)
