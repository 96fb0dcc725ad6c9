"""Book's recursive Lagrangian with 4x4 transformations, over any scalar type.

Equation numbers are those of Book, "Recursive Lagrangian dynamics of flexible manipulator arms"
(1984); docs/formulations.md lists the differences. E follows `Chain.rotation`. It may be
1 + theta~, which is not a rotation: energies, velocities and equations of motion all derive from
the same positions, so energy is conserved for any E. Neither E'E = 1 nor R'R = 1 is used: (73) is
evaluated in its long form, and the terms in delta^2 of (37) are kept.

The integrals omit the factor 1/2 of (25), (28), (30), and the traces their factor 2.
"""

from collections.abc import Sequence
from typing import NamedTuple

from dynamics.formulations.algebra import (
    Matrix,
    Scalar,
    Vector,
    add,
    dot,
    madd,
    matmul,
    matvec,
    minus,
    mscale,
    mul,
    plus,
    transpose,
)
from dynamics.formulations.dense_solve import add_rotor, resistance
from dynamics.formulations.homogeneous import BOTTOM, NOTHING, UNITY, Transformed, transformed
from dynamics.formulations.kinematics import Chain, Shape, damper_forces


def inner(A: Matrix, B: Matrix) -> Scalar:
    """Tr A B'."""
    return plus(*(dot(a, b) for a, b in zip(A, B, strict=True)))


# ---- inertia coefficients ------------------------------------------------------------------------


class Outboard(NamedTuple):
    """Sums over link h and all links beyond; left factors in one frame, right ones in frame h."""

    joint: Matrix  # jF~_h = sum over i >= h of jW~_i G_i hW~_i'    (67), (78)
    modal: Matrix  # jF_h = sum over i > h of jW~_i G_i hW_i'    (71), (76)
    W: Matrix  # jW~_h

    def moved(self, T: Matrix) -> "Outboard":
        """Left-multiply by T, to change the frame of the left factors: (78), (81)."""
        return Outboard(matmul(T, self.joint), matmul(T, self.modal), matmul(T, self.W))


def _columns(f: Transformed, X: Matrix, outboard: Outboard) -> list[Scalar]:
    """Inertia coefficients between one coordinate, dW/dx = X, and the joint and modes of link f.

    (66), (68) to (70), (74), (75), as Tr X F X_h' = Tr (X F) X_h'; each X F and the metric of the
    term in D_h are computed once for all modes.
    """
    through, metric = matmul(X, outboard.modal), matmul(transpose(matmul(X, outboard.W)), f.W)
    modal = [
        plus(inner(through, X_k), inner(D, metric))
        for X_k, D in zip(f.X_modal, _project(f.shape, f.D), strict=True)
    ]
    return modal if f.X is None else [inner(matmul(X, outboard.joint), f.X), *modal]


def _project(shape: Shape, values: Sequence[Matrix]) -> list[Matrix]:
    """Project matrices per shape (m + p) onto the modes (m)."""
    rows = [shape.project(row) for row in zip(*values, strict=True)]
    return [*zip(*rows, strict=True)]


def _own_modes(f: Transformed, beyond: Matrix) -> list[list[Scalar]]:
    """(m, m) inertia coefficients between modes of one link: (72), and (73) in its long form."""
    metric = matmul(transpose(f.W), f.W)
    shapes = [
        [plus(inner(C, metric), I) for C, I in zip(row, spin, strict=True)]
        for row, spin in zip(f.C, f.spin, strict=True)
    ]
    own = f.shape.project([*zip(*f.shape.project(shapes), strict=True)])
    through = [matmul(X, beyond) for X in f.X_modal]
    return [
        [plus(own[j][k], inner(through[j], X)) for k, X in enumerate(f.X_modal)]
        for j in range(len(through))
    ]


def mass_matrix(chain: Chain, q: Sequence[Scalar]) -> list[list[Scalar]]:
    """(n, n) J of (66) to (76) by the recursions (77) to (81)."""
    n = len(q)
    frames = transformed(chain, q, [0.0] * n)
    M: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    indices, start = [], 0
    for f in frames:
        stop = start + len(f.X_modal) + (f.X is not None)
        indices.append(range(start, stop))
        start = stop

    outer = NOTHING
    for h in reversed(range(len(frames))):
        f = frames[h]
        beyond = madd(f.tip, outer)  # hPhi_h, in the frame of the tip
        E = f.bend.E
        composite = madd(f.G, matmul(matmul(E, beyond), transpose(E)))  # (77), (79)
        outboard = Outboard(composite, matmul(E, beyond), UNITY)
        modes = indices[h]
        if f.X is not None:
            _fill(M, indices[h][0], indices[h], _columns(f, f.X, outboard))
            modes = modes[1:]
        for index, row in zip(modes, _own_modes(f, beyond), strict=True):
            _fill(M, index, modes, row)
        for j in reversed(range(h)):
            g = frames[j]
            outboard = outboard.moved(frames[j + 1].A)
            modes = indices[j] if g.X is None else indices[j][1:]
            for index, X in zip(modes, g.X_modal, strict=True):
                _fill(M, index, indices[h], _columns(f, X, outboard))
            outboard = outboard.moved(g.bend.E)
            if g.X is not None:
                _fill(M, indices[j][0], indices[h], _columns(f, g.X, outboard))
        outer = matmul(matmul(f.A, composite), transpose(f.A))
    add_rotor(chain, M)
    return M


def _fill(
    M: list[list[Scalar]], row: int, columns: Sequence[int], values: Sequence[Scalar]
) -> None:
    for column, value in zip(columns, values, strict=True):
        M[row][column] = M[column][row] = value


# ---- right-hand side -----------------------------------------------------------------------------


def bias(chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar]) -> list[Scalar]:
    """(n,) h of M qdd + h = B tau (Book's -R) from Q and P of (83) to (90)."""
    g = (0.0, *chain.gravity)
    h: list[Scalar] = []
    Q: Matrix = NOTHING  # int h a' beyond the tip, a the acceleration
    P: Vector = BOTTOM  # int h beyond the tip
    for f, (rate, _) in zip(
        reversed(transformed(chain, q, v)), reversed(chain.split(v)), strict=True
    ):
        Q = madd(Q, matmul(f.tip, transpose(f.tip_bias)))
        P = add(P, f.tip[0])
        resisting, friction = resistance(f.link, rate, f.delta, f.rates)
        forces = [
            plus(own, inner(X, transpose(Q)), minus(0.0, dot(g, matvec(X, P))), resisting_k)
            for own, X, resisting_k in zip(_own_forces(f, g), f.X_modal, resisting, strict=True)
        ]  # (84), (85)
        Q = madd(
            matmul(f.G, transpose(f.W_bias)),
            matmul(_sum(f.shape.x_dot, f.D, 2.0), transpose(f.W_dot)),
            matmul(_sum(f.shape.x_ddot, f.D), transpose(f.W)),
            matmul(f.bend.E, Q),
        )  # (87), (88)
        P = add(f.G[0], matvec(f.bend.E, P))  # (89), (90)
        if f.X is not None:
            driven = minus(inner(f.X, transpose(Q)), dot(g, matvec(f.X, P)))  # (83)
            forces = [plus(driven, friction), *forces]
        h = [*forces, *h]
        Q, P = matmul(f.A, Q), matvec(f.A, P)
    return [plus(own, across) for own, across in zip(h, damper_forces(chain, v), strict=True)]


def _own_forces(f: Transformed, g: Vector) -> list[Scalar]:
    """(m) inertial forces, at zero second derivatives, and weight of a link on its own modes."""
    W = f.W
    resting, turning, metric = (matmul(transpose(W), other) for other in (f.W_bias, f.W_dot, W))
    forces = []
    for D, C in zip(f.D, f.C, strict=True):
        inertial = plus(
            inner(D, transpose(resting)),
            inner(_sum(f.shape.x_dot, C, 2.0), turning),
            inner(_sum(f.shape.x_ddot, C), metric),
        )
        forces.append((minus(inertial, dot(g, matvec(W, D[0]))),))
    return [force for (force,) in f.shape.project(forces)]


def _sum(x: Sequence[Scalar], matrices: Sequence[Matrix], factor: float = 1.0) -> Matrix:
    """(4, 4) factor * sum of x_k A_k."""
    terms = (mscale(x_k, A) for x_k, A in zip(x, matrices, strict=True))
    return mscale(factor, madd(NOTHING, *terms))


# ---- energy and tip ------------------------------------------------------------------------------


def energies(
    chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar]
) -> tuple[Scalar, Scalar, Scalar]:
    """Kinetic energy with rotors, elastic and gravity energy [J]: (22), (40), (49)."""
    kinetic: Scalar = 0.0
    elastic: Scalar = 0.0
    gravity: Scalar = 0.0
    g = (0.0, *chain.gravity)
    for f, (rate, _) in zip(transformed(chain, q, v), chain.split(v), strict=True):
        x_dot, link = f.shape.x_dot, f.link
        metric = matmul(transpose(f.W), f.W)
        slip = plus(rate, dot(link.root_slope, f.rates))
        modal = [
            dot(x_dot, [plus(inner(C, metric), I) for C, I in zip(row, spin, strict=True)])
            for row, spin in zip(f.C, f.spin, strict=True)
        ]
        kinetic = plus(
            kinetic,
            mul(0.5, inner(matmul(f.W_dot, f.G), f.W_dot)),
            inner(matmul(f.W_dot, _sum(x_dot, f.D)), f.W),
            mul(0.5, dot(x_dot, modal)),
            mul(0.5, inner(matmul(f.tip_rate, f.tip), f.tip_rate)),
            mul(0.5 * link.rotor_inertia, mul(slip, slip)),
        )
        elastic = plus(elastic, mul(0.5, dot(f.delta, [dot(row, f.delta) for row in link.K])))
        moment = add(matvec(f.W, f.G[0]), matvec(matmul(f.W, f.bend.E), f.tip[0]))
        gravity = minus(gravity, dot(g, moment))
    return kinetic, elastic, gravity


def tip_velocity(chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar]) -> Vector:
    """(3,) [m/s] velocity of the last tip, the exact derivative of its position."""
    rate = transformed(chain, q, v)[-1].tip_rate
    return tuple(row[0] for row in rate[1:])
