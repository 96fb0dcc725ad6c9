"""Cyril's natural orthogonal complement, over any scalar type.

Equation numbers are those of Cyril, "Dynamics of flexible-link manipulators" (McGill, 1988),
chapter 3, extended to flexible links. Every body has a twist t_i, extended by its modal rates, and
an extended mass matrix M_i: M_i t_i' = w_i. N maps the rates of the coordinates to all twists,
t = N v, by the recursion of velocities, and its transpose eliminates the constraint wrenches:

    N' M N a + N' (M N_dot v + gyroscopic wrenches - applied wrenches) = B tau        (3.13)

Twists are written in the frame of their link. With `Chain.rotation` "linear", E = 1 + theta~ turns
vectors and theta_dot is the angular velocity, as in the Gibbs-Appell recursion.
"""

from collections.abc import Sequence
from typing import NamedTuple

from dynamics.formulations.algebra import (
    ZERO,
    Scalar,
    Vector,
    add,
    combine,
    congruence,
    cross,
    dot,
    matvec,
    mcombine,
    minus,
    mul,
    plus,
    scale,
    tmatvec,
)
from dynamics.formulations.dense_solve import add_rotor, resistance
from dynamics.formulations.kinematics import Chain, Frame, damper_forces, outward


class Twist(NamedTuple):
    """Angular velocity, velocity and modal rates of a body; or a wrench in the same order."""

    w: Vector
    u: Vector  # of the joint, or of the tip
    modal: Sequence[Scalar]  # (m)

    def __matmul__(self, other: "Twist") -> Scalar:
        """Power of a wrench on a twist."""
        return plus(dot(self.w, other.w), dot(self.u, other.u), dot(self.modal, other.modal))


class Columns(NamedTuple):
    """Columns of N for one link and for its tip body, up to the link's own coordinates."""

    link: list[Twist]
    tip: list[Twist]


def complement(frames: Sequence[Frame]) -> list[Columns]:
    """N as columns per link, by the recursion of velocities."""
    result: list[Columns] = []
    tips: list[Twist] = []
    for f in frames:
        m = len(f.delta)
        rest = (0.0,) * m
        columns = []
        for tip in tips:
            u = add(tip.u, cross(tip.w, f.offset))
            columns.append(Twist(tmatvec(f.R, tip.w), tmatvec(f.R, u), rest))
        if not f.link.welded:
            columns.append(Twist((0.0, 0.0, 1.0), ZERO, rest))
        for j in range(m):
            columns.append(Twist(ZERO, ZERO, [1.0 if j == k else 0.0 for k in range(m)]))
        tips = [_tip(f, column) for column in columns]
        result.append(Columns(columns, tips))
    return result


def _tip(f: Frame, t: Twist) -> Twist:
    """Twist of a link's tip from the twist of the link."""
    w = add(t.w, combine(t.modal, f.tip_theta))
    return Twist(w, add(t.u, cross(t.w, f.r), combine(t.modal, f.tip_phi)), ())


class Body(NamedTuple):
    """Extended mass matrix of a link, in blocks of angular, linear and modal rates."""

    f: Frame
    alpha: Sequence[Vector]  # (m) angular-modal
    epsilon: Sequence[Vector]  # (m) linear-modal
    s: Sequence[Sequence[Scalar]]  # (m, m) modal

    def __matmul__(self, t: Twist) -> Twist:
        """Extended momentum M_i t_i."""
        f, modal = self.f, t.modal
        return Twist(
            add(matvec(f.B9, t.w), cross(f.rho, t.u), combine(modal, self.alpha)),
            add(scale(f.link.mass, t.u), cross(t.w, f.rho), combine(modal, self.epsilon)),
            [
                plus(dot(a, t.w), dot(e, t.u), dot(row, modal))
                for a, e, row in zip(self.alpha, self.epsilon, self.s, strict=True)
            ],
        )


def body_of(f: Frame) -> Body:
    """Extended mass matrix of one link."""
    s = f.shape.project([*zip(*f.shape.project(f.link.s), strict=True)])
    return Body(f, f.shape.project(f.alpha), f.shape.project(f.link.epsilon), s)


def _tip_momentum(f: Frame, t: Twist) -> Twist:
    """Momentum of the body at a link's tip from the tip's twist."""
    J, s = congruence(f.E, f.link.tip_inertia), matvec(f.E, f.link.tip_moment)
    turning = add(matvec(J, t.w), cross(s, t.u))
    return Twist(turning, add(scale(f.link.tip_mass, t.u), cross(t.w, s)), ())


def mass_matrix(chain: Chain, q: Sequence[Scalar]) -> list[list[Scalar]]:
    """(n, n) N' M N, summed body by body."""
    n = len(q)
    M: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    frames = outward(chain, q, [0.0] * n)
    for f, columns in zip(frames, complement(frames), strict=True):
        body = body_of(f)
        moments = [body @ column for column in columns.link]
        tip_moments = [_tip_momentum(f, column) for column in columns.tip]
        for j, (link, tip) in enumerate(zip(*columns, strict=True)):
            for k in range(j, len(moments)):
                M[j][k] = plus(M[j][k], link @ moments[k], tip @ tip_moments[k])
                M[k][j] = M[j][k]
    add_rotor(chain, M)
    return M


def bias(chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar]) -> list[Scalar]:
    """(n,) h of M qdd + h = B tau: N' (M N_dot v + gyroscopic wrenches) plus link forces."""
    h = damper_forces(chain, v)
    frames, start = outward(chain, q, v), 0
    for f, columns, (rate, _) in zip(frames, complement(frames), chain.split(v), strict=True):
        wrench = _link_wrench(f)
        momentum = _tip_momentum(f, Twist(f.w_tip, ZERO, ()))
        tip = _tip_momentum(f, Twist(f.w_dot_tip, f.a_tip, ()))
        tip = Twist(
            add(tip.w, cross(f.w_tip, momentum.w)), add(tip.u, cross(f.w_tip, momentum.u)), ()
        )
        for j, (at_joint, at_tip) in enumerate(zip(*columns, strict=True)):
            h[j] = plus(h[j], at_joint @ wrench, at_tip @ tip)
        modal, friction = resistance(f.link, rate, f.delta, f.delta_dot)
        forces = modal if f.link.welded else [friction, *modal]
        for j, force in enumerate(forces, start):
            h[j] = plus(h[j], force)
        start += len(forces)
    return h


def _link_wrench(f: Frame) -> Twist:
    """M_i N_i_dot v plus the gyroscopic wrench of one link; gravity is a base acceleration."""
    link, w, shape = f.link, f.w, f.shape
    modal_bias = shape.x_ddot  # of modes and foreshortening
    bending = Twist(
        combine(modal_bias, f.alpha),
        combine(modal_bias, link.epsilon),
        _projected(f, [dot(row, modal_bias) for row in link.s]),
    )
    carried = body_of(f) @ Twist(f.w_dot, f.a, (0.0,) * len(f.delta))
    spun = add(cross(w, f.rho), scale(2.0, combine(shape.x_dot, link.epsilon)))
    coriolis = matvec(mcombine(shape.x_dot, f.beta), w)
    modal = [
        minus(mul(-2.0, dot(w, combine(shape.x_dot, link.c_jk[j]))), dot(w, matvec(beta, w)))
        for j, beta in enumerate(f.beta)
    ]
    return Twist(
        add(carried.w, bending.w, scale(2.0, coriolis), cross(w, matvec(f.B9, w))),
        add(carried.u, bending.u, cross(w, spun)),
        add(carried.modal, bending.modal, _projected(f, modal)),
    )


def _projected(f: Frame, values: Sequence[Scalar]) -> list[Scalar]:
    """Project numbers per shape (m + p) onto the modes (m)."""
    return [x for (x,) in f.shape.project([(value,) for value in values])]
