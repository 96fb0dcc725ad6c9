"""Accelerations by an L D L' factorization of the whole mass matrix, over any scalar type.

Formulations without an O(n) solver use it. Elastic, damping and friction forces and joint rotors
depend on one link only, so all formulations of the equations of motion share them.
"""

from collections.abc import Sequence
from typing import Protocol

from dynamics.formulations.algebra import Scalar, dot, is_zero, minus, mul, plus
from dynamics.formulations.articulated_body import Implicit, add_implicit
from dynamics.formulations.gibbs_appell import friction_torque
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.link_constants import LinkConstants


class Equations(Protocol):
    """Functions that a formulation's module must provide: M and h of M qdd + h = B tau."""

    def mass_matrix(self, chain: Chain, q: Sequence[Scalar]) -> list[list[Scalar]]:
        """(n, n) M."""

    def bias(self, chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar]) -> list[Scalar]:
        """(n,) h."""


def resistance(
    link: LinkConstants, rate: Scalar, delta: Sequence[Scalar], rates: Sequence[Scalar]
) -> tuple[list[Scalar], Scalar]:
    """Elastic, damping and friction forces of one link: (m) on its modes, and on its joint."""
    friction = friction_torque(link, plus(rate, dot(link.root_slope, rates)))
    modal = [
        plus(dot(K, delta), dot(C, rates), mul(slope, friction))
        for K, C, slope in zip(link.K, link.damping, link.root_slope, strict=True)
    ]
    return modal, friction


def add_rotor(chain: Chain, M: list[list[Scalar]]) -> None:
    """Add the joints' rotors, which turn at the relative joint rates, to a mass matrix."""
    start = 0
    for link in chain.links:
        if not link.welded:
            slip = (1.0, *link.root_slope)
            for j, s_j in enumerate(slip, start):
                for k, s_k in enumerate(slip, start):
                    M[j][k] = plus(M[j][k], mul(link.rotor_inertia, mul(s_j, s_k)))
        start += len(link.K) + (not link.welded)


def accelerations(
    equations: Equations,
    chain: Chain,
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    tau: Sequence[Scalar],
    implicit: Implicit | None = None,
) -> list[Scalar]:
    """(n,) accelerations under joint torques tau, from M factored as L D L'."""
    M = [list(row) for row in equations.mass_matrix(chain, q)]
    residual = [minus(0.0, h) for h in equations.bias(chain, q, v)]
    torques, start = iter(tau), 0
    parts = implicit.split(chain) if implicit else [None] * len(chain.links)
    for link, part in zip(chain.links, parts, strict=True):
        stop = start + len(link.K) + (not link.welded)
        indices = list(range(start, stop))  # coordinates of the link: modes, then any joint
        if not link.welded:
            indices = [*indices[1:], start]
            torque = next(torques)
            for index, slope in zip(indices, (*link.root_slope, 1.0), strict=True):
                residual[index] = plus(residual[index], mul(slope, torque))
        if part:
            block = [[M[j][k] for k in indices] for j in indices]
            forces = [residual[j] for j in indices]
            add_implicit(link, block, forces, part)
            for j, row, force in zip(indices, block, forces, strict=True):
                residual[j] = force
                for k, value in zip(indices, row, strict=True):
                    M[j][k] = value
        start = stop
    return solve(M, residual)


def solve(M: list[list[Scalar]], b: list[Scalar]) -> list[Scalar]:
    """Solve M x = b by root-free Cholesky, M = L D L'; M is symmetric positive definite.

    Overwrites the lower triangle of M.
    """
    n, x = len(b), list(b)
    pivots, L = [], [[0.0] * n for _ in range(n)]
    for k in range(n):
        pivots.append(1.0 / M[k][k])
        for i in range(k + 1, n):
            L[i][k] = factor = mul(M[i][k], pivots[k])
            if is_zero(factor):
                continue
            for j in range(k + 1, i + 1):
                M[i][j] = minus(M[i][j], mul(factor, M[j][k]))
            x[i] = minus(x[i], mul(factor, x[k]))
    for k in reversed(range(n)):
        beyond = dot([L[i][k] for i in range(k + 1, n)], x[k + 1 :])
        x[k] = minus(mul(x[k], pivots[k]), beyond)
    return x
