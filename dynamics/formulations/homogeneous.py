"""4x4 transformations of a chain of flexible links, and inertia integrals, over any scalar type.

Equation numbers are those of Book, "Recursive Lagrangian dynamics of flexible manipulator arms"
(1984); lagrange_book.py has the equations of motion. A point of link i is W_i h_i in the world,
with h = (1, r) and W_i affine: its first row is (1, 0, 0, 0).
"""

from collections.abc import Sequence
from math import factorial
from typing import NamedTuple

from dynamics.formulations.algebra import (
    EYE,
    ZERO,
    ZEROS,
    Matrix,
    Scalar,
    Vector,
    add,
    combine,
    cos,
    dot,
    is_zero,
    madd,
    matmul,
    mcombine,
    minus,
    mscale,
    mul,
    plus,
    sin,
    skew,
    symmetric,
    transpose,
)
from dynamics.formulations.kinematics import Chain, Shape, amplitudes
from dynamics.formulations.link_constants import LinkConstants

TOP = (1.0, 0.0, 0.0, 0.0)  # first row of a transformation
BOTTOM = (0.0, 0.0, 0.0, 0.0)  # first row of its derivatives
NOTHING: Matrix = (BOTTOM,) * 4
UNITY: Matrix = (TOP, *((0.0, *row) for row in EYE))


def affine(R: Matrix, p: Vector, top: Vector = TOP) -> Matrix:
    """(4, 4) transformation r -> p + R r; with `top` zero, a derivative of a transformation."""
    return (top, *((x, *row) for x, row in zip(p, R, strict=True)))


def pseudo(J: Matrix) -> Matrix:
    """(3, 3) int a b' from J = int b~' a~ = int (a . b) 1 - a b'."""
    half = mul(0.5, plus(J[0][0], J[1][1], J[2][2]))
    return tuple(tuple(minus(half if i == j else 0.0, J[i][j]) for j in range(3)) for i in range(3))


# ---- the deflected tip ---------------------------------------------------------------------------

_TERMS = 8  # of the series in |theta|^2


def _series(x: Scalar, first: int) -> tuple[Scalar, Scalar, Scalar]:
    """Sum of (-x)^k / (2k + first)! over k, its first and its second derivative."""
    c = [(-1.0) ** k / factorial(2 * k + first) for k in range(_TERMS)]
    sums: list[Scalar] = []
    for order in range(3):
        value: Scalar = 0.0
        for k in reversed(range(order, _TERMS)):
            falling = factorial(k) / factorial(k - order)
            value = plus(mul(value, x), c[k] * falling)
        sums.append(value)
    return sums[0], sums[1], sums[2]


class Bend(NamedTuple):
    """E and its derivatives: (7)."""

    E: Matrix  # (4, 4)
    M: list[Matrix]  # (m) (4, 4) dE/ddelta_k
    rate: Matrix  # (4, 4) sum of M_k delta_k_dot
    bias: Matrix  # (4, 4) d2E/dt2 at zero second derivatives of delta


def bend(
    link: LinkConstants, delta: Sequence[Scalar], rates: Sequence[Scalar], shape: Shape, kind: str
) -> Bend:
    """Transformation E from the deflected tip's frame to the link's.

    With kind "exp" the rotation is exp theta~ = 1 + a theta~ + b theta~^2, a = sin f / f,
    b = (1 - cos f) / f^2, f = |theta|; otherwise a = 1, b = 0, Book's E = H + sum of delta_k M_k.
    """
    theta, theta_dot = combine(delta, link.tip_theta), combine(rates, link.tip_theta)
    T, Td, Tk = skew(theta), skew(theta_dot), [skew(t) for t in link.tip_theta]
    if kind != "exp" or all(is_zero(x) for x in theta):
        R, Rk, Rdd = madd(EYE, T), Tk, ZEROS
    else:
        x = dot(theta, theta)
        a, da, dda = _series(x, 1)
        b, db, ddb = _series(x, 2)
        TT, TTd, TdTd = matmul(T, T), _anticommutator(T, Td), matmul(Td, Td)
        R = madd(EYE, mscale(a, T), mscale(b, TT))
        Rk = []
        for t, S in zip(link.tip_theta, Tk, strict=True):
            x_k = mul(2.0, dot(theta, t))
            slope = madd(mscale(mul(da, x_k), T), mscale(mul(db, x_k), TT))
            Rk.append(madd(slope, mscale(a, S), mscale(b, _anticommutator(T, S))))
        x_dot, x_dd = mul(2.0, dot(theta, theta_dot)), mul(2.0, dot(theta_dot, theta_dot))
        square = mul(x_dot, x_dot)
        Rdd = madd(
            mscale(plus(mul(dda, square), mul(da, x_dd)), T),
            mscale(plus(mul(ddb, square), mul(db, x_dd)), TT),
            mscale(mul(2.0, mul(da, x_dot)), Td),
            mscale(mul(2.0, mul(db, x_dot)), TTd),
            mscale(mul(2.0, b), TdTd),
        )
    tip = add((link.length, 0.0, 0.0), combine(shape.x, link.tip_phi))
    M = [affine(S, phi, BOTTOM) for S, phi in zip(Rk, shape.project(link.tip_phi), strict=True)]
    rate = affine(mcombine(rates, Rk), combine(shape.x_dot, link.tip_phi), BOTTOM)
    return Bend(affine(R, tip), M, rate, affine(Rdd, combine(shape.x_ddot, link.tip_phi), BOTTOM))


def _anticommutator(A: Matrix, B: Matrix) -> Matrix:
    return madd(matmul(A, B), matmul(B, A))


# ---- one link at a state -------------------------------------------------------------------------


class Transformed(NamedTuple):
    """One link at a state: transformations to the world, and integrals over its deflected shape."""

    link: LinkConstants
    shape: Shape
    A: Matrix  # (4, 4) joint: from this frame to the tip before
    bend: Bend
    W: Matrix  # (4, 4) from this frame to the world: (3)
    W_dot: Matrix  # (4, 4) dW/dt (9)
    W_bias: Matrix  # (4, 4) d2W/dt2 (10) at zero second derivatives of the coordinates
    X: Matrix | None  # (4, 4) dW/dq; None for a welded body
    X_modal: list[Matrix]  # (m) (4, 4) d(W E)/ddelta_k
    G: Matrix  # (4, 4) int mu h h'    (37), including terms in delta^2
    D: list[Matrix]  # (m + p) (4, 4) int mu h h_k', h_k = (0, r_k)    (36)
    C: list[list[Matrix]]  # (m + p, m + p) (4, 4) int mu h_j h_k'    (25)
    delta: Sequence[Scalar]
    rates: Sequence[Scalar]  # of delta
    tip_rate: Matrix  # (4, 4) d(W E)/dt    (14)
    tip_bias: Matrix  # (4, 4) d2(W E)/dt2 at zero second derivatives of the coordinates    (17)
    spin: list[list[Scalar]]  # (m + p, m + p) modal inertia of rotary inertia and hub
    tip: Matrix  # (4, 4) int h h' dm of the body at the tip, in the tip's frame


def _integrals(
    link: LinkConstants, shape: Shape
) -> tuple[Matrix, list[Matrix], list[list[Matrix]]]:
    """G, D and C of (25), (28), (30), (36), (37), from the constants of the link."""
    every = range(len(link.s))
    pairs = [[pseudo(link.D[k][j]) for k in every] for j in every]
    across = [transpose(pseudo(C)) for C in link.C]  # int mu eta r_k'
    rows = [madd(across[k], mcombine(shape.x, [pairs[j][k] for j in every])) for k in every]
    half = madd(mcombine(shape.x, [transpose(B) for B in across]), mcombine(shape.x, rows))
    square = pseudo(link.C0)
    second = symmetric(lambda i, j: plus(square[i][j], half[i][j]))
    first = add(link.first_moment, combine(shape.x, link.epsilon))
    D: list[Matrix] = [
        ((0.0, *eps), *((0.0, *row) for row in block))
        for eps, block in zip(link.epsilon, rows, strict=True)
    ]
    C = [[affine(block, ZERO, BOTTOM) for block in row] for row in pairs]
    return affine(second, first, (link.mass, *first)), D, C


def _turn(link: LinkConstants, q: Scalar) -> tuple[Matrix, Matrix, Matrix]:
    """A and its first and second derivatives U, U2 by the joint angle: (9), (10)."""
    if link.welded:
        return UNITY, NOTHING, NOTHING
    c, s = cos(q), sin(q)
    turns = (
        ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)),
        ((-s, -c, 0.0), (c, -s, 0.0), ZERO),
        ((-c, s, 0.0), (-s, -c, 0.0), ZERO),
    )
    A, U, U2 = (matmul(link.rotation, R) for R in turns)
    return affine(A, link.offset), affine(U, ZERO, BOTTOM), affine(U2, ZERO, BOTTOM)


def transformed(chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar]) -> list[Transformed]:
    """Transformations of all links from base to tip: (3), (9), (10), (13) to (17)."""
    result: list[Transformed] = []
    W_tip, W_tip_dot, W_tip_bias = UNITY, NOTHING, NOTHING
    for link, (angle, delta), (rate, rates) in zip(
        chain.links, chain.split(q), chain.split(v), strict=True
    ):
        A, U, U2 = _turn(link, angle)
        X = matmul(W_tip, U)
        W = matmul(W_tip, A)
        W_dot = madd(matmul(W_tip_dot, A), mscale(rate, X))
        W_bias = madd(
            matmul(W_tip_bias, A),
            mscale(mul(2.0, rate), matmul(W_tip_dot, U)),
            mscale(mul(rate, rate), matmul(W_tip, U2)),
        )
        shape = amplitudes(link, delta, rates, [0.0] * len(delta))
        bent = bend(link, delta, rates, shape, chain.rotation)
        G, D, C = _integrals(link, shape)
        every = range(len(link.s))
        spin = [[minus(link.s[j][k], _trace(C[j][k])) for k in every] for j in every]
        W_tip = matmul(W, bent.E)
        W_tip_bias = madd(
            matmul(W_bias, bent.E), mscale(2.0, matmul(W_dot, bent.rate)), matmul(W, bent.bias)
        )
        W_tip_dot = madd(matmul(W_dot, bent.E), matmul(W, bent.rate))
        mass = (link.tip_mass, *link.tip_moment)
        result.append(
            Transformed(
                link=link, shape=shape, A=A, bend=bent, W=W, W_dot=W_dot, W_bias=W_bias,
                X=None if link.welded else X, X_modal=[matmul(W, M) for M in bent.M],
                G=G, D=D, C=C, spin=spin, delta=delta, rates=rates, tip_rate=W_tip_dot,
                tip_bias=W_tip_bias, tip=affine(pseudo(link.tip_inertia), link.tip_moment, mass),
            )
        )  # fmt: skip
    return result


def _trace(A: Matrix) -> Scalar:
    return plus(*(row[i] for i, row in enumerate(A)))
