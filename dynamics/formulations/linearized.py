"""The linear arm, links straight and at rest: M a + C v + K q = B tau."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.description.validate import double_precision
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.link_constants import LinkConstants
from dynamics.integrators.exponential import FrozenModes
from dynamics.types import Array

ELASTIC = 1e-9  # of the largest squared frequency: what is less belongs to a free joint
NOISE = 1e-13  # of the most that a share can be: what is less is round-off, and costs operations


def inertia(chain: Chain, q: Array) -> Array:
    """(n, n) M at q."""
    return np.array(mass_matrix(chain, [float(x) for x in q]), dtype=np.float64)


def stiffness(chain: Chain) -> Array:
    """(n, n) K of the modes and joint springs."""
    return _assemble(chain, lambda link: link.K, lambda link: link.spring)


def damping(chain: Chain) -> Array:
    """(n, n) C of the modes, and viscous joint friction."""
    return _assemble(chain, lambda link: link.damping, lambda link: link.viscous)


def friction(chain: Chain) -> Array:
    """(n, n) Coulomb's friction at its steepest: about a resting joint."""
    return _assemble(chain, lambda link: (), lambda link: link.coulomb / link.coulomb_speed)


def frequencies(M: Array, K: Array, elastic: int, held: Sequence[int] = ()) -> Array:
    """(elastic,) [rad/s] highest natural frequencies of M and K; `held` coordinates do not move."""
    from scipy.linalg import eigh

    moving = np.setdiff1d(np.arange(len(M)), held)
    M, K = M[np.ix_(moving, moving)], K[np.ix_(moving, moving)]
    with double_precision("The arm's frequencies"):
        squares = eigh(K, M, eigvals_only=True)
    return np.asarray(np.sqrt(np.abs(squares[squares.size - elastic :])))


def _assemble(
    chain: Chain,
    modal: Callable[[LinkConstants], object],
    joint: Callable[[LinkConstants], float],
) -> Array:
    """Blocks of the modes, and a number that acts on the slip between a link's root and its hub."""
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
    """One posture's matrices, each (n, n), and its modes."""

    M: Array
    K: Array
    C: Array  # of the modes, and viscous joint friction: what implicit methods know
    friction: Array  # Coulomb's at its steepest, about resting joints
    frozen: FrozenModes


def linear_arm(chain: Chain, q: Array) -> LinearArm:
    """The arm about rest at q (n,), links straight."""
    modes = frozen_modes(chain)
    return LinearArm(inertia(chain, q), stiffness(chain), damping(chain), friction(chain), modes)


def frozen_modes(chain: Chain) -> FrozenModes:
    """Modes of the straight arm, joints free; damping that couples them is left out."""
    from scipy.linalg import eigh

    M = inertia(chain, np.zeros(len(stiffness(chain))))
    squares, S = eigh(stiffness(chain), M)
    elastic = squares > ELASTIC * squares.max(initial=0.0)
    decays = np.einsum("ik,ij,jk->k", S, damping(chain), S)
    most = np.sqrt(np.diag(M)), np.linalg.norm(S, axis=1)  # as S' M S = 1
    L, back = (x * (np.abs(x) > NOISE * size) for x, size in zip((S.T @ M, S.T), most, strict=True))
    return FrozenModes(squares * elastic, decays * elastic, L, back.T)
