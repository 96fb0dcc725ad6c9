"""Accelerations in O(n) by an articulated-body algorithm for flexible links, over any scalar type.

Blocks of the mass matrix come from gibbs_appell.py; each link's modes and joint are eliminated
from tip to base.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from dynamics.formulations.algebra import (
    ZERO,
    Scalar,
    add,
    combine,
    cross,
    dot,
    is_zero,
    minus,
    msub,
    mul,
    plus,
    scale,
    sub,
    symmetric,
    tmatvec,
)
from dynamics.formulations.gibbs_appell import (
    NO_INERTIA,
    Block,
    Inertia,
    Wrench,
    block_of,
    in_coordinate_order,
    inverse_dynamics,
    joint_load,
    transmitted,
)
from dynamics.formulations.kinematics import Chain, Frame, damper_forces, outward
from dynamics.formulations.link_constants import LinkConstants


class Implicit(NamedTuple):
    """Linear forces taken implicitly: (M + W) a = B tau - h + W guess.

    W_jk = stiffness_j K_jk + damping_j C_jk; coordinates that K or C couple have equal weights.
    `guess` holds the accelerations with which the integrator extrapolated q and v.
    """

    stiffness: Sequence[Scalar]  # (n,) [s^2]
    damping: Sequence[Scalar]  # (n,) [s]
    guess: Sequence[Scalar]  # (n,) accelerations

    def split(self, chain: Chain) -> list["Implicit"]:
        """Its parts per body, modes first, then the joint (0.0 of a welded body)."""
        parts = zip(*(chain.split(x) for x in self), strict=True)
        return [Implicit(*([*modes, joint] for joint, modes in part)) for part in parts]


def accelerations(
    chain: Chain,
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    tau: Sequence[Scalar],
    implicit: Implicit | None = None,
) -> list[Scalar]:
    """(n,) accelerations a of (M + W) a = B tau - h + W guess."""
    frames = outward(chain, q, v)
    rates, across = chain.split(v), chain.split(damper_forces(chain, v))
    drives = _drives(chain, tau)

    def loaded(i: int, load: Wrench) -> tuple[Wrench, list[Scalar]]:
        wrench, forces = joint_load(frames[i], rates[i][0], load)
        residual = [minus(t, h) for t, h in zip(drives[i], forces, strict=True)]
        for j, force in enumerate(across[i][1]):
            residual[j] = minus(residual[j], force)
        return wrench, residual

    return _solution(frames, implicit.split(chain) if implicit else [], loaded)


def response(
    chain: Chain, q: Sequence[Scalar], forces: Sequence[Scalar], implicit: Implicit | None = None
) -> list[Scalar]:
    """(n,) solution x of (M + W) x = forces."""
    frames, given = outward(chain, q, [0.0] * len(q)), chain.split(forces)
    parts = implicit.split(chain) if implicit else []

    def loaded(i: int, load: Wrench) -> tuple[Wrench, list[Scalar]]:
        wrench, carried = transmitted(frames[i], load)
        joint, modal = given[i]
        return wrench, [minus(x, y) for x, y in zip([*modal, joint], carried, strict=False)]

    return _solution(frames, [x._replace(guess=[0.0] * len(x.guess)) for x in parts], loaded)


def imbalance(
    chain: Chain,
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    tau: Sequence[Scalar],
    a: Sequence[Scalar],
    implicit: Implicit | None = None,
) -> list[Scalar]:
    """(n,) B tau - h + W guess - (M + W) a, which is zero of the accelerations a."""
    result: list[Scalar] = []
    parts = implicit.split(chain) if implicit else [None] * len(chain.links)
    forces, rises = chain.split(inverse_dynamics(chain, q, v, a)), chain.split(a)
    for link, drive, (joint, modal), (rise, fast), part in zip(
        chain.links, _drives(chain, tau), forces, rises, parts, strict=True
    ):
        own = [minus(t, h) for t, h in zip(drive, [*modal, joint], strict=False)]
        if part:
            off = [minus(x, y) for x, y in zip([*fast, rise], part.guess, strict=True)]
            weights = _weights(link, part, len(own))
            own = [minus(x, dot(row, off[: len(own)])) for x, row in zip(own, weights, strict=True)]
        result += in_coordinate_order(link, own)
    return result


def _drives(chain: Chain, tau: Sequence[Scalar]) -> list[list[Scalar]]:
    """B tau per body: on the modes, then on the joint if any."""
    torques, result = iter(tau), []
    for link in chain.links:
        torque = next(torques) if link.driven else 0.0
        joint = [] if link.welded else [torque]
        result.append([*(mul(s, torque) for s in link.root_slope), *joint])
    return result


def _solution(
    frames: list[Frame],
    parts: list[Implicit],
    loaded: Callable[[int, Wrench], tuple[Wrench, list[Scalar]]],
) -> list[Scalar]:
    """(n,) solution; one pass inward eliminates, one pass outward substitutes.

    `loaded(i, load)` gives the wrench at the joint of body i and the right-hand side of its
    coordinates, under the load of the bodies beyond.
    """
    solved = []
    outer, load = NO_INERTIA, Wrench(ZERO, ZERO)
    for i in reversed(range(len(frames))):
        f = frames[i]
        wrench, residual = loaded(i, load)
        block = block_of(f, outer)
        if parts:
            add_implicit(f.link, block.D, residual, parts[i])
        pivots = _eliminate(block, residual)
        solved.append((block, residual, pivots))
        if i:
            own = f.link.rotor_inertia  # on the joint coordinate alone, not on the link before
            if parts:
                own = plus(own, mul(parts[i].damping[-1], f.link.viscous))
                own = plus(own, mul(parts[i].stiffness[-1], f.link.spring))
            inertia = _articulated_inertia(f.link, block, pivots, own)
            outer = inertia.turned(f.R).moved(f.offset)
            push = [mul(e, p) for e, p in zip(residual, pivots, strict=True)]
            load = Wrench(
                add(wrench.force, combine(push, [c.force for c in block.columns])),
                add(wrench.moment, combine(push, [c.moment for c in block.columns])),
            ).from_next(f.R, f.offset)
    return _outward_solution(frames, solved[::-1])


def add_implicit(
    link: LinkConstants, D: list[list[Scalar]], residual: list[Scalar], part: Implicit
) -> None:
    """Add one link's W to D, and W guess to the residual."""
    values = part.guess[: len(D)]
    for j, row in enumerate(_weights(link, part, len(D))):
        for k, weight in enumerate(row):
            D[j][k] = plus(D[j][k], weight)
        residual[j] = plus(residual[j], dot(row, values))


def _weights(link: LinkConstants, part: Implicit, size: int) -> list[list[Scalar]]:
    """(size, size) W of one link."""
    m, slopes = len(link.K), [*link.root_slope, 1.0]

    def weight(j: int, k: int) -> Scalar:
        slope_product = slopes[j] * slopes[k]
        C, K = mul(link.viscous, slope_product), mul(link.spring, slope_product)
        if j < m and k < m:
            C, K = plus(C, link.damping[j][k]), plus(K, link.K[j][k])
        return plus(mul(part.damping[j], C), mul(part.stiffness[j], K))

    return [[weight(j, k) for k in range(size)] for j in range(size)]


def _eliminate(block: Block, residual: list[Scalar]) -> list[Scalar]:
    """Factor one link's D as L D L', modes first; reduce columns and residual along with it.

    Works in place. Returns the inverse pivots.
    """
    D, columns = block.D, block.columns
    pivots = []
    for c in range(len(columns)):
        inverse = 1.0 / D[c][c]
        pivots.append(inverse)
        for d in range(c + 1, len(columns)):
            factor = mul(D[c][d], inverse)
            if is_zero(factor):
                continue
            columns[d] = Wrench(
                sub(columns[d].force, scale(factor, columns[c].force)),
                sub(columns[d].moment, scale(factor, columns[c].moment)),
            )
            for e in range(d, len(columns)):
                D[d][e] = minus(D[d][e], mul(factor, D[c][e]))
            residual[d] = minus(residual[d], mul(factor, residual[c]))
            D[c][d] = factor
    return pivots


def _articulated_inertia(
    link: LinkConstants, block: Block, pivots: list[Scalar], own: Scalar
) -> Inertia:
    """Articulated inertia at the joint; `own` is the joint coordinate's own inertia."""
    A, B, D = block.inertia
    for column, pivot in zip(block.columns, pivots, strict=True):
        F, N = column
        pF, pN = scale(pivot, F), scale(pivot, N)
        A = symmetric(lambda i, j, A=A, pF=pF, F=F: minus(A[i][j], mul(pF[i], F[j])))
        B = msub(B, tuple(tuple(mul(pN[i], F[j]) for j in range(3)) for i in range(3)))
        D = symmetric(lambda i, j, D=D, pN=pN, N=N: minus(D[i][j], mul(pN[i], N[j])))
    root_turns = any(link.root_slope) and not is_zero(own)
    if link.welded or link.bypassed or root_turns:
        return Inertia(A, B, D)
    # along a free joint axis only `own` is left: set that row, so that it is exactly zero without
    keep = mul(own, pivots[-1])
    z = Wrench(*(scale(keep, u) for u in block.columns[-1]))
    if link.prismatic:
        A = symmetric(lambda i, j, A=A: z.force[i] if j == 2 else A[i][j])
        return Inertia(A, tuple((row[0], row[1], z.moment[i]) for i, row in enumerate(B)), D)
    B = (B[0], B[1], z.force)
    D = symmetric(lambda i, j, D=D: z.moment[i] if j == 2 else D[i][j])
    return Inertia(A, B, D)


def _outward_solution(
    frames: list[Frame], solved: list[tuple[Block, list[Scalar], list[Scalar]]]
) -> list[Scalar]:
    """Substitute back from base to tip; `solved` holds blocks, residuals and inverse pivots."""
    result: list[Scalar] = []
    a, w_dot = ZERO, ZERO  # of the tip before, without the bias accelerations
    for f, (block, residual, pivots) in zip(frames, solved, strict=True):
        a = tmatvec(f.R, add(a, cross(w_dot, f.offset)))
        w_dot = tmatvec(f.R, w_dot)
        u: list[Scalar] = [0.0] * len(pivots)
        for c in reversed(range(len(pivots))):
            F, N = block.columns[c]
            driven = minus(residual[c], plus(dot(F, a), dot(N, w_dot)))
            u[c] = minus(mul(driven, pivots[c]), dot(block.D[c][c + 1 :], u[c + 1 :]))
        result += in_coordinate_order(f.link, u)
        modal = u[: len(f.delta)]
        turning = w_dot
        if not f.link.welded:
            along = (0.0, 0.0, u[-1])
            a, turning = (add(a, along), w_dot) if f.link.prismatic else (a, add(w_dot, along))
        a = add(a, cross(turning, f.r), combine(modal, f.tip_phi))
        if not f.link.bypassed:
            w_dot = add(turning, combine(modal, f.tip_theta))
    return result
