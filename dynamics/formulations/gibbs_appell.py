"""The recursive Gibbs-Appell equations of an arm with flexible links, over any scalar type.

Equation numbers are those of Korayem & Shafei, "Inverse/forward dynamics of flexible-link arms by
recursive Gibbs-Appell formulation and assumed modes" (2009); docs/theory.md lists the corrections.
Every vector of link i lives in the frame of link i: origin at its joint, x along the undeformed
link, z the joint axis. Called with floats, the functions are the slow reference; called with
symbols, they build the expression graph of one arm.

`mass_matrix` and `bias` use composite inertias, as in the paper. articulated_body.py solves for the
accelerations link by link from the same blocks.
"""

from collections.abc import Sequence
from typing import NamedTuple

from dynamics.formulations.algebra import (
    ZERO,
    ZEROS,
    Matrix,
    Scalar,
    Vector,
    add,
    combine,
    congruence,
    cross,
    dot,
    is_zero,
    madd,
    matmul,
    matvec,
    mcombine,
    minus,
    mul,
    plus,
    rotate,
    scale,
    skew,
    symmetric,
    tanh,
    tmatvec,
    transpose,
)
from dynamics.formulations.kinematics import (
    Chain,
    Frame,
    damper_forces,
    elastic_forces,
    outward,
    stretch,
)
from dynamics.formulations.link_constants import LinkConstants


class Inertia(NamedTuple):
    """Spatial inertia about a point: force = A a + B' alpha, moment = B a + D alpha."""

    A: Matrix
    B: Matrix
    D: Matrix

    def moved(self, r: Vector) -> "Inertia":
        """Inertia about another point; `r` leads from that point to this one."""
        if all(is_zero(x) for x in r):
            return self
        B = madd(self.B, matmul(skew(r), self.A))
        Br, rB = matmul(B, skew(r)), matmul(skew(r), transpose(self.B))
        D = symmetric(lambda i, j: plus(self.D[i][j], minus(rB[i][j], Br[i][j])))
        return Inertia(self.A, B, D)

    def turned(self, R: Matrix) -> "Inertia":
        """Inertia in the frame that R maps to; R need not be a rotation."""
        A, D = (congruence(R, X, rotation=False) for X in (self.A, self.D))
        return Inertia(A, rotate(R, self.B), D)

    def turned_composite(self, R: Matrix) -> "Inertia":
        """`turned` by a true rotation of a composite inertia: A = m 1 is invariant, B = b~."""
        b = (self.B[2][1], self.B[0][2], self.B[1][0])
        return Inertia(self.A, skew(matvec(R, b)), congruence(R, self.D))


def friction_torque(link: LinkConstants, rate: Scalar) -> Scalar:
    """Joint friction torque [N m]: viscous, and Coulomb smoothed by tanh."""
    viscous = mul(link.viscous, rate)
    if is_zero(link.coulomb):
        return viscous
    return plus(viscous, mul(link.coulomb, tanh(mul(1.0 / link.coulomb_speed, rate))))


def _own_inertia(f: Frame) -> tuple[Vector, Vector, list[Scalar]]:
    """Inertial force, moment about the joint and modal forces of a link: (96), (97), (102).

    The body at the tip is not included.
    """
    link, w, shape = f.link, f.w, f.shape
    eps_dot = combine(shape.x_dot, link.epsilon)
    B8w = matvec(mcombine(shape.x_dot, f.beta), w)
    force = add(
        scale(link.mass, f.a),
        matvec(f.Phi, f.rho),
        scale(2.0, cross(w, eps_dot)),
        combine(shape.x_ddot, link.epsilon),
    )
    moment = add(
        cross(f.rho, f.a),
        scale(2.0, B8w),
        matvec(f.B9, f.w_dot),
        cross(w, matvec(f.B9, w)),
        combine(shape.x_ddot, f.alpha),
    )
    modal = []
    for j, beta in enumerate(f.beta):
        gyroscopic = plus(
            mul(2.0, dot(w, combine(shape.x_dot, link.c_jk[j]))), dot(w, matvec(beta, w))
        )
        inertial = plus(
            dot(f.a, link.epsilon[j]), dot(f.w_dot, f.alpha[j]), dot(link.s[j], shape.x_ddot)
        )
        modal.append((minus(inertial, gyroscopic),))
    return force, moment, [x for (x,) in shape.project(modal)]


def _tip_body_inertia(f: Frame) -> tuple[Vector, Vector]:
    """Force and moment about the tip that accelerate the body at the tip."""
    J, s = congruence(f.E, f.link.tip_inertia), matvec(f.E, f.link.tip_moment)
    moment = add(matvec(J, f.w_dot_tip), cross(f.w_tip, matvec(J, f.w_tip)), cross(s, f.a_tip))
    swung = add(cross(f.w_dot_tip, s), cross(f.w_tip, cross(f.w_tip, s)))
    return add(scale(f.link.tip_mass, f.a_tip), swung), moment


class Wrench(NamedTuple):
    """Force and moment about a point."""

    force: Vector
    moment: Vector

    def from_next(self, R: Matrix, offset: Vector) -> "Wrench":
        """Transform the next joint's wrench to this link's tip and frame."""
        force = matvec(R, self.force)
        return Wrench(force, add(matvec(R, self.moment), cross(offset, force)))


def wrench_on_link(link: LinkConstants, tip: Wrench) -> Wrench:
    """Part of the next link's wrench that acts on this link: a parallel drive leaves the force."""
    return Wrench(tip.force, ZERO) if link.bypassed else tip


def bypassing_moment(link: LinkConstants, tip: Wrench) -> Vector:
    """Next link's moment that a parallel drive transmits to the base of this link's joint."""
    return tip.moment if link.bypassed else ZERO


def joint_axis_component(link: LinkConstants, wrench: Wrench) -> Scalar:
    """Joint-axis component of a wrench: a force if prismatic, else a moment."""
    return wrench.force[2] if link.prismatic else wrench.moment[2]


def joint_load(
    f: Frame, rate: Scalar, outer: Wrench, faster: Scalar = 0.0
) -> tuple[Wrench, list[Scalar]]:
    """Wrench at the joint and forces of the coordinates (modes, then the joint if any).

    `rate` and `faster` are the joint's rate and acceleration, `outer` is the next link's wrench at
    the tip. Sums of (98) to (103), plus elastic, dissipative and friction forces.
    """
    link = f.link
    force, moment, modal = _own_inertia(f)
    body, load = _tip_body_inertia(f), wrench_on_link(link, outer)
    tip = Wrench(add(body[0], load.force), add(body[1], load.moment))
    slip = plus(rate, dot(link.root_slope, f.delta_dot))
    slip_dot = plus(faster, dot(link.root_slope, f.shape.x_ddot[: len(modal)]))
    rotor = mul(link.rotor_inertia, slip_dot)
    resistance = plus(friction_torque(link, slip), mul(link.spring, stretch(f)), rotor)
    elastic = elastic_forces(link, f.shape)
    for j, inertial in enumerate(modal):
        modal[j] = plus(
            inertial,
            dot(f.tip_phi[j], tip.force),
            dot(f.tip_theta[j], tip.moment),
            elastic[j],
            dot(link.damping[j], f.delta_dot),
            mul(link.root_slope[j], resistance),
        )
    total = Wrench(add(force, tip.force), add(moment, tip.moment, cross(f.r, tip.force)))
    forces = modal if link.welded else [*modal, plus(joint_axis_component(link, total), resistance)]
    return Wrench(total.force, add(total.moment, bypassing_moment(link, outer))), forces


def transmitted(f: Frame, outer: Wrench) -> tuple[Wrench, list[Scalar]]:
    """Part of `joint_load` that the next link's wrench at the tip causes."""
    link, load = f.link, wrench_on_link(f.link, outer)
    forces = [
        plus(dot(phi, load.force), dot(theta, load.moment))
        for phi, theta in zip(f.tip_phi, f.tip_theta, strict=True)
    ]
    total = Wrench(load.force, add(load.moment, cross(f.r, load.force)))
    if not link.welded:
        forces.append(joint_axis_component(link, total))
    return Wrench(total.force, add(total.moment, bypassing_moment(link, outer))), forces


def in_coordinate_order(link: LinkConstants, values: list[Scalar]) -> list[Scalar]:
    """Reorder one link's values from elimination order (joint last) to joint first."""
    return values if link.welded else [values[-1], *values[:-1]]


NO_LOAD = Wrench(ZERO, ZERO)


def bias(
    chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar], load: Wrench = NO_LOAD
) -> list[Scalar]:
    """(n,) h of M qdd + h = B tau: inertial, gravity, elastic and dissipative forces.

    `load` is the wrench that the last link exerts on its surroundings, at its tip in its own frame.
    """
    return inverse_dynamics(chain, q, v, [0.0] * len(q), load)


def inverse_dynamics(
    chain: Chain,
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    v_dot: Sequence[Scalar],
    load: Wrench = NO_LOAD,
) -> list[Scalar]:
    """(n,) M v_dot + h, by one pass outward and one inward; `load` is as in `bias`."""
    frames = outward(chain, q, v, v_dot)
    outer = load
    result: list[Scalar] = []
    rates, rises = (reversed(chain.split(x)) for x in (v, v_dot))
    for f, (rate, _), (faster, _) in zip(reversed(frames), rates, rises, strict=True):
        wrench, forces = joint_load(f, rate, outer, faster)
        result = [*in_coordinate_order(f.link, forces), *result]
        outer = wrench.from_next(f.R, f.offset)
    return [plus(own, across) for own, across in zip(result, damper_forces(chain, v), strict=True)]


class Block(NamedTuple):
    """Mass-matrix blocks of a link and of all links beyond it."""

    inertia: Inertia  # about the joint
    columns: list[Wrench]  # wrench at the joint per acceleration of a mode, then of the joint
    D: list[list[Scalar]]  # couplings of these coordinates, upper triangle only


def block_of(f: Frame, outer: Inertia) -> Block:
    """Blocks of one link; `outer` is the inertia of all links beyond it, about its tip."""
    if not f.link.bypassed:
        return _block(f, with_tip_body(f, outer))
    # a parallel drive: this link's coordinates translate the next link without rotating it,
    # while a rotation of the joint's base rotates both
    block = _block(f, with_tip_body(f, Inertia(outer.A, ZEROS, ZEROS)))
    couples = Inertia(ZEROS, outer.B, outer.D).moved(f.r)
    A, B, D = block.inertia
    inertia = Inertia(A, madd(B, couples.B), symmetric(lambda i, j: plus(D[i][j], couples.D[i][j])))
    shifts = (*f.tip_phi, cross((0.0, 0.0, 1.0), f.r))
    columns = [
        Wrench(column.force, add(column.moment, matvec(outer.B, shift)))
        for column, shift in zip(block.columns, shifts, strict=True)
    ]
    return Block(inertia, columns, block.D)


def _block(f: Frame, outer: Inertia) -> Block:
    """Blocks of one link with `outer` rigidly fixed to its tip: (75), (81), (85)."""
    link, m = f.link, len(f.delta)
    size = m if link.welded else m + 1
    A, B, D = outer
    columns, couplings = [], [[0.0] * size for _ in range(size)]
    at_tip = [
        Wrench(add(matvec(A, phi), tmatvec(B, theta)), add(matvec(B, phi), matvec(D, theta)))
        for phi, theta in zip(f.tip_phi, f.tip_theta, strict=True)
    ]
    shifted = outer.moved(f.r)
    inertia = Inertia(
        symmetric(lambda i, j: plus(shifted.A[i][j], link.mass if i == j else 0.0)),
        madd(skew(f.rho), shifted.B),
        symmetric(lambda i, j: plus(f.B9[i][j], shifted.D[i][j])),
    )
    epsilon, alpha = f.shape.project(link.epsilon), f.shape.project(f.alpha)
    s = f.shape.project([*zip(*f.shape.project(link.s), strict=True)])
    for j, tip in enumerate(at_tip):
        force = add(epsilon[j], tip.force)
        columns.append(Wrench(force, add(alpha[j], tip.moment, cross(f.r, tip.force))))
        for k in range(j, m):
            couplings[j][k] = plus(
                s[j][k],
                dot(f.tip_phi[j], at_tip[k].force),
                dot(f.tip_theta[j], at_tip[k].moment),
                link.rotor_inertia * link.root_slope[j] * link.root_slope[k],
            )
        if not link.welded:
            turned = link.rotor_inertia * link.root_slope[j]
            couplings[j][m] = plus(joint_axis_component(link, columns[j]), turned)
    if not link.welded:
        columns.append(
            Wrench(inertia.A[2], transpose(inertia.B)[2])
            if link.prismatic
            else Wrench(inertia.B[2], transpose(inertia.D)[2])
        )
        couplings[m][m] = plus(joint_axis_component(link, columns[m]), link.rotor_inertia)
    return Block(inertia, columns, couplings)


def with_tip_body(f: Frame, outer: Inertia) -> Inertia:
    """Add the inertia of the body at the tip."""
    m, J = f.link.tip_mass, congruence(f.E, f.link.tip_inertia)
    A = symmetric(lambda i, j: plus(outer.A[i][j], m if i == j else 0.0))
    B = madd(outer.B, skew(matvec(f.E, f.link.tip_moment)))
    return Inertia(A, B, symmetric(lambda i, j: plus(outer.D[i][j], J[i][j])))


NO_INERTIA = Inertia(ZEROS, ZEROS, ZEROS)


def mass_matrix(chain: Chain, q: Sequence[Scalar]) -> list[list[Scalar]]:
    """(n, n) M from composite inertias; each joint-deflection block is mirrored."""
    n = len(q)
    frames = outward(chain, q, [0.0] * n)
    M: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    indices, start = [], 0  # of each link's coordinates, modes then joint
    for f in frames:
        stop = start + len(f.delta) + (not f.link.welded)
        order = list(range(start, stop))
        indices.append(order if f.link.welded else [*order[1:], order[0]])
        start = stop

    outer = NO_INERTIA
    for i in reversed(range(len(frames))):
        f = frames[i]
        block = block_of(f, outer)
        for c, column in enumerate(block.columns):
            for d in range(c, len(block.columns)):
                row, col = indices[i][c], indices[i][d]
                M[row][col] = M[col][row] = block.D[c][d]
            wrench, child = column, f
            for k in reversed(range(i)):
                parent = frames[k]
                wrench, entries = transmitted(parent, wrench.from_next(child.R, child.offset))
                for row, entry in zip(indices[k], entries, strict=True):
                    M[row][indices[i][c]] = M[indices[i][c]][row] = entry
                child = parent
        turn = Inertia.turned_composite if chain.rotation == "exp" else Inertia.turned
        outer = turn(block.inertia, f.R).moved(f.offset)
    return M
