"""Kinematics of a chain of flexible links: frames from base to tip, over any scalar type.

Equation numbers are those of Korayem & Shafei (2009); docs/theory.md lists the corrections.
Every vector of link i lives in the frame of link i: origin at its joint, x along the undeformed
link, z the joint axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial
from typing import NamedTuple

from dynamics.formulations.algebra import (
    EYE,
    ZERO,
    Matrix,
    Scalar,
    Vector,
    add,
    combine,
    congruence,
    cos,
    cross,
    dot,
    is_zero,
    madd,
    matmul,
    matvec,
    mcombine,
    minus,
    mscale,
    mul,
    plus,
    scale,
    sin,
    skew,
    symmetric,
    tmatvec,
    transpose,
)
from dynamics.formulations.link_constants import LinkConstants

Scalars = Sequence[Scalar]


@dataclass(frozen=True)
class Damper:
    """Rank-one damping over the modes of several bodies: force = rate u (u . rates)."""

    first: int  # coordinate to which the first entry of u belongs
    rate: Scalar  # [1/s]
    u: tuple[float, ...]  # [kg^1/2]


@dataclass(frozen=True)
class Chain:
    """Constants of an arm that the recursion uses: its bodies from base to tip, and gravity."""

    links: tuple[LinkConstants, ...]
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m/s^2]
    rotation: str = "exp"  # of a bent end: exp(theta~); "linear": 1 + theta~
    free_base: bool = False  # the first body turns the base in space: see free_base.py
    dampers: tuple[Damper, ...] = ()  # across bodies, beside the damping of each
    driven_base: bool = False  # a torque turns the base: the last of the torques

    def split(self, x: Scalars) -> list[tuple[Scalar, Scalars]]:
        """Split coordinates into (joint, modes) per body; a welded body's joint is 0.0."""
        parts, start = [], 0
        for link in self.links:
            joint = 0.0 if link.welded else x[start]
            start += not link.welded
            parts.append((joint, x[start : start + len(link.K)]))
            start += len(link.K)
        return parts


def damper_forces(chain: Chain, v: Scalars) -> list[Scalar]:
    """(n,) forces of the dampers across bodies, on the left of the equations of motion."""
    forces: list[Scalar] = [0.0] * len(v)
    for damper in chain.dampers:
        last = damper.first + len(damper.u)
        push = mul(damper.rate, dot(damper.u, v[damper.first : last]))
        for i, u in enumerate(damper.u, damper.first):
            forces[i] = plus(forces[i], mul(u, push))
    return forces


class Shape(NamedTuple):
    """Amplitudes of a link's shapes: m modes, then p foreshortening shapes (mode products)."""

    x: Scalars  # (m + p)
    x_dot: Scalars  # (m + p)
    x_ddot: Scalars  # (m + p)
    J: Sequence[Scalars]  # (p, m) derivatives of the p amplitudes by delta

    def project(self, values: Sequence[Vector]) -> list[Vector]:
        """Project vectors per shape (m + p) onto the modes (m)."""
        m = len(values) - len(self.J)
        return [
            add(values[j], *(scale(row[j], v) for row, v in zip(self.J, values[m:], strict=True)))
            for j in range(m)
        ]


def amplitudes(
    link: LinkConstants, delta: Scalars, delta_dot: Scalars, delta_ddot: Scalars
) -> Shape:
    """Shape of a link; the amplitude of a pair j, k is -delta_j delta_k, half of it if j = k."""
    x, x_dot, x_ddot = list(delta), list(delta_dot), list(delta_ddot)
    J = []
    for j, k in link.pairs:
        row: list[Scalar] = [0.0] * len(delta)
        half = 0.5 if j == k else 1.0
        row[j] = minus(0.0, delta[k])
        row[k] = minus(0.0, delta[j])
        J.append(row)
        x.append(mul(-half, mul(delta[j], delta[k])))
        x_dot.append(dot(row, delta_dot))
        faster = mul(-2.0 * half, mul(delta_dot[j], delta_dot[k]))
        x_ddot.append(plus(faster, dot(row, delta_ddot)))
    return Shape(x, x_dot, x_ddot, J)


class Frame(NamedTuple):
    """Kinematics of one link in its own frame; `*_tip` is at eta = l.

    Accelerations hold at the second derivatives of the coordinates that `outward` was given.
    """

    link: LinkConstants
    R: Matrix  # from this frame to the frame of the link before
    offset: Vector  # from the tip before to the joint, in the frame of the link before
    joint: Scalar  # joint coordinate
    slide: Vector  # velocity of a prismatic joint along its axis
    delta: Scalars
    delta_dot: Scalars
    shape: Shape
    r: Vector  # from joint to tip
    r_dot: Vector  # tip velocity relative to the frame
    E: Matrix  # rotation of the deflected tip
    tip_phi: Sequence[Vector]  # (m) tip velocity per modal rate
    tip_theta: Sequence[Vector]  # (m) J_l theta_j: tip angular velocity per modal rate
    rho: Vector  # first mass moment, B3 = rho~    (25)
    alpha: Sequence[Vector]  # (m + p) (31)
    beta: Sequence[Matrix]  # (m + p) (32)
    B9: Matrix  # (33)
    a: Vector  # acceleration of the joint
    w: Vector  # angular velocity
    w_dot: Vector  # angular acceleration
    Phi: Matrix  # w_dot~ + w~ w~
    a_tip: Vector
    w_tip: Vector
    w_dot_tip: Vector


_TERMS = 7  # series in |theta|^2: error below 1e-16 up to 0.6 rad, 5e-14 at 1 rad


def series(x: Scalar, first: int) -> tuple[Scalar, Scalar]:
    """Sum of (-x)^k / (2k + first)! over k, and its derivative, by Horner's rule."""
    c = [(-1.0) ** k / factorial(2 * k + first) for k in range(_TERMS)]
    value: Scalar = 0.0
    slope: Scalar = 0.0
    for k in reversed(range(_TERMS)):
        value = plus(mul(value, x), c[k])
        if k:
            slope = plus(mul(slope, x), k * c[k])
    return value, slope


def tip_rotation(
    link: LinkConstants, delta: Scalars, delta_dot: Scalars, kind: str
) -> tuple[Matrix, Sequence[Vector], Vector]:
    """Rotation of the deflected tip, angular velocity per modal rate, bias angular acceleration.

    E = exp(theta~), theta = sum_j delta_j theta_j(l)        (6), (8), with a true rotation
    omega_rel = J_l theta_dot, J_l = 1 + c theta~ + d theta~^2, bias J_l_dot theta_dot
    c = (1 - cos f)/f^2, d = (f - sin f)/f^3, f = |theta|
    """
    shapes: Sequence[Vector] = link.tip_theta
    theta = combine(delta, shapes)
    rate = combine(delta_dot, shapes)
    turning: Vector = ZERO
    if all(is_zero(x) for x in theta):
        return EYE, shapes, ZERO
    if kind != "exp":
        return madd(EYE, skew(theta)), shapes, ZERO
    if link.sines:
        theta, shapes, turning = _from_slopes(theta, rate, shapes)
        rate = combine(delta_dot, shapes)
    T = skew(theta)
    x = dot(theta, theta)
    c, dc = series(x, 2)
    d, dd = series(x, 3)
    sinc = minus(1.0, mul(x, d))
    squares = symmetric(lambda i, j: mul(theta[i], theta[j]))
    TT = symmetric(lambda i, j: minus(squares[i][j], x) if i == j else squares[i][j])
    E = madd(EYE, mscale(sinc, T), mscale(c, TT))

    def J_l(u: Vector) -> Vector:
        Tu = cross(theta, u)
        return add(u, scale(c, Tu), scale(d, cross(theta, Tu)))

    x_dot = mul(2.0, dot(theta, rate))
    Tr = cross(theta, rate)
    bias = add(
        scale(mul(dc, x_dot), Tr),
        scale(mul(dd, x_dot), cross(theta, Tr)),
        scale(d, cross(rate, Tr)),
    )
    return E, [J_l(u) for u in shapes], add(bias, J_l(turning))


def _from_slopes(
    slopes: Vector, rates: Vector, shapes: Sequence[Vector]
) -> tuple[Vector, Sequence[Vector], Vector]:
    """Rotation vector of a tip whose slopes are sines: y' = sin, not the angle itself.

    A bending slope s turns the tip by asin s = k s, k = 1 + s^2/6 + 3 s^4/40 + .... Returns the
    rotation vector, its derivatives by the amplitudes, and its second derivative in time at
    constant modal rates. A twist, along x, is as it is.
    """
    b, b_dot = (0.0, *slopes[1:]), (0.0, *rates[1:])
    x, x_dot = dot(b, b), mul(2.0, dot(b, b_dot))
    k = plus(1.0, mul(x, plus(1.0 / 6.0, mul(3.0 / 40.0, x))))
    dk = plus(1.0 / 6.0, mul(3.0 / 20.0, x))
    derived = []
    for u in shapes:
        bent = (0.0, *u[1:])
        own, turned = scale(k, bent), scale(mul(dk, mul(2.0, dot(b, bent))), b)
        derived.append(add((u[0], 0.0, 0.0), own, turned))
    k_dot = mul(dk, x_dot)
    k_bias = plus(mul(3.0 / 20.0, mul(x_dot, x_dot)), mul(dk, mul(2.0, dot(b_dot, b_dot))))
    theta = add((slopes[0], 0.0, 0.0), scale(k, b))
    return theta, derived, add(scale(mul(2.0, k_dot), b_dot), scale(k_bias, b))


def elastic_forces(link: LinkConstants, shape: Shape) -> list[Scalar]:
    """(m) forces of bending, twist and stretching on the modes, and of foreshortening: K x."""
    m = len(link.K)
    pairs = [dot(row, shape.x[m:]) for row in link.K_pairs]
    forces = []
    for j, row in enumerate(link.K):
        across = [mul(J[j], force) for J, force in zip(shape.J, pairs, strict=False)]
        forces.append(plus(dot(row, shape.x[:m]), *across))
    return forces


def _turn(q: Scalar) -> Matrix:
    """Rz(q)."""
    c, s = cos(q), sin(q)
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))


def _mounting(link: LinkConstants, joint: Scalar) -> tuple[Matrix, Vector]:
    """Rotation and position of a link's frame in the end frame of the link before."""
    if link.welded:
        return link.rotation, link.offset
    if link.prismatic:
        axis = transpose(link.rotation)[2]
        return link.rotation, add(link.offset, scale(joint, axis))
    return matmul(link.rotation, _turn(joint)), link.offset


def phi_of(w: Vector, w_dot: Vector) -> Matrix:
    """w_dot~ + w~ w~; a body-fixed point r accelerates at a + Phi r."""
    p = symmetric(lambda i, j: mul(w[i], w[j]))
    ww = symmetric(
        lambda i, j: minus(0.0, plus(p[i - 2][i - 2], p[i - 1][i - 1])) if i == j else p[i][j]
    )
    return madd(skew(w_dot), ww)


def outward(chain: Chain, q: Scalars, v: Scalars, v_dot: Scalars | None = None) -> list[Frame]:
    """Frames of all links from base to tip: (59), (63), (65), Steps 1 to 3.

    Without `v_dot`, the second derivatives of the coordinates, these are zero.
    Gravity enters as an acceleration of the base: a_0 = -g. A joint's base is the tip of the link
    before; with a parallel drive it keeps the orientation of that link's own joint base.
    """
    frames: list[Frame] = []
    a_tip: Vector = scale(-1.0, chain.gravity)
    R_base, w_base, w_dot_base = EYE, ZERO, ZERO  # of a joint's base, in the link before's frame
    parts = (chain.split(x) for x in (q, v, v_dot or [0.0] * len(q)))
    for link, (joint, delta), (rate, delta_dot), (faster, delta_ddot) in zip(
        chain.links, *parts, strict=True
    ):
        mounting, place = _mounting(link, joint)
        along, rise = (0.0, 0.0, rate), (0.0, 0.0, faster)
        spin, slide = (ZERO, along) if link.prismatic else (along, ZERO)
        spin_dot, slide_dot = (ZERO, rise) if link.prismatic else (rise, ZERO)
        R = matmul(R_base, mounting)
        offset = matvec(R_base, place)
        before, before_dot = tmatvec(R, w_base), tmatvec(R, w_dot_base)
        a = tmatvec(R, add(a_tip, matvec(phi_of(w_base, w_dot_base), offset)))
        a = add(a, scale(2.0, cross(before, slide)), slide_dot)
        w = add(before, spin)
        w_dot = add(before_dot, cross(before, spin), spin_dot)
        Phi = phi_of(w, w_dot)

        shape = amplitudes(link, delta, delta_dot, delta_ddot)
        r = add((link.length, 0.0, 0.0), combine(shape.x, link.tip_phi))
        r_dot = combine(shape.x_dot, link.tip_phi)
        kind = "exp" if chain.free_base and not frames else chain.rotation
        E, tip_theta, bias = tip_rotation(link, delta, delta_dot, kind)
        theta_dot = combine(delta_dot, tip_theta)
        a_tip = add(
            a, matvec(Phi, r), scale(2.0, cross(w, r_dot)), combine(shape.x_ddot, link.tip_phi)
        )
        w_tip = add(w, theta_dot)
        theta_ddot = add(bias, combine(delta_ddot, tip_theta))
        w_dot_tip = add(w_dot, theta_ddot, cross(w, theta_dot))
        R_base, w_base, w_dot_base = E, w_tip, w_dot_tip
        if link.bypassed:
            R_base, w_base, w_dot_base = transpose(_turn(joint)), before, before_dot

        x, every = shape.x, range(len(shape.x))
        beta = [madd(link.C[j], mcombine(x, [link.D[k][j] for k in every])) for j in every]
        alpha = [add(link.c[j], combine(x, [link.c_jk[k][j] for k in every])) for j in every]
        half = madd(mcombine(x, [transpose(C) for C in link.C]), mcombine(x, beta))
        frames.append(
            Frame(
                link=link, R=R, offset=offset, joint=joint, slide=slide,
                delta=delta, delta_dot=delta_dot, shape=shape,
                r=r, r_dot=r_dot, E=E, tip_phi=shape.project(link.tip_phi), tip_theta=tip_theta,
                rho=add(link.first_moment, combine(x, link.epsilon)), alpha=alpha, beta=beta,
                B9=symmetric(lambda i, j, C0=link.C0, half=half: plus(C0[i][j], half[i][j])),
                a=a, w=w, w_dot=w_dot, Phi=Phi, a_tip=a_tip, w_tip=w_tip, w_dot_tip=w_dot_tip,
            )
        )  # fmt: skip
    return frames


def stretch(f: Frame) -> Scalar:
    """Deflection of a joint spring: the joint coordinate plus the modal rotation of the root."""
    return plus(f.joint, dot(f.link.root_slope, f.delta))


class Pose(NamedTuple):
    """Position and orientation of a link and velocity of its tip, in the world frame."""

    joint: Vector  # [m]
    R: Matrix  # from the link's frame to the world
    tip: Vector  # [m]
    tip_velocity: Vector  # [m/s]
    joint_velocity: Vector  # [m/s] in the link's own frame


def poses(frames: Sequence[Frame]) -> list[Pose]:
    """World poses of all links: (59), (63)."""
    result: list[Pose] = []
    tip, R, velocity, w_tip = ZERO, EYE, ZERO, ZERO
    for f in frames:
        joint = add(tip, matvec(R, f.offset))
        at_joint = add(tmatvec(f.R, add(velocity, cross(w_tip, f.offset))), f.slide)
        R = matmul(R, f.R)
        velocity = add(at_joint, cross(f.w, f.r), f.r_dot)
        w_tip = f.w_tip
        tip = add(joint, matvec(R, f.r))
        result.append(Pose(joint, R, tip, matvec(R, velocity), at_joint))
    return result


def energies(chain: Chain, q: Scalars, v: Scalars) -> tuple[Scalar, Scalar, Scalar]:
    """Kinetic, elastic and gravity energy [J]; the last is zero for mass at the base's origin.

    Computed from velocities of mass points and bodies, not from the mass matrix.
    """
    kinetic: Scalar = 0.0
    elastic: Scalar = 0.0
    gravity: Scalar = 0.0
    frames = outward(chain, q, v)
    for f, pose, (rate, _) in zip(frames, poses(frames), chain.split(v), strict=True):
        link = f.link
        u = pose.joint_velocity
        u_end, s = add(u, cross(f.w, f.r), f.r_dot), matvec(f.E, link.tip_moment)
        x_dot = f.shape.x_dot
        eps_dot = combine(x_dot, link.epsilon)
        slip = plus(rate, dot(link.root_slope, f.delta_dot))
        twist = stretch(f)
        kinetic = plus(
            kinetic,
            mul(0.5 * link.mass, dot(u, u)),
            dot(u, add(cross(f.w, f.rho), eps_dot)),
            mul(0.5, dot(f.w, matvec(f.B9, f.w))),
            dot(f.w, combine(x_dot, f.alpha)),
            mul(0.5, dot(x_dot, [dot(row, x_dot) for row in link.s])),
            mul(0.5 * link.rotor_inertia, mul(slip, slip)),
            mul(0.5 * link.tip_mass, dot(u_end, u_end)),
            dot(u_end, cross(f.w_tip, s)),
            mul(0.5, dot(f.w_tip, matvec(congruence(f.E, link.tip_inertia), f.w_tip))),
        )
        elastic = plus(elastic, mul(0.5, dot(f.delta, [dot(row, f.delta) for row in link.K])))
        pairs = f.shape.x[len(f.delta) :] if link.K_pairs else ()
        elastic = plus(elastic, mul(0.5, dot(pairs, [dot(row, pairs) for row in link.K_pairs])))
        elastic = plus(elastic, mul(0.5, mul(link.spring, mul(twist, twist))))
        moment = add(scale(link.mass, pose.joint), matvec(pose.R, f.rho))
        moment = add(moment, scale(link.tip_mass, pose.tip), matvec(pose.R, s))
        gravity = minus(gravity, dot(chain.gravity, moment))
    return kinetic, elastic, gravity
