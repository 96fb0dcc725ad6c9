"""Free and planar bases: coordinates of position and attitude at the root of the recursion.

The recursion treats the base as two bodies in front of the first link. The first has neither mass
nor extent, but six "modes": unit displacements and unit rotations of its tip, with amplitudes x (3)
and a rotation vector epsilon (3) relative to an inertial reference frame. The second is the base
itself, welded to that tip. The equations of a deflected tip therefore rotate the base:
E = exp(epsilon~), omega = J_l epsilon_dot.

The reference frame is the world turned to the base's attitude at the start of a step, where
epsilon = 0. There the rates of the six coordinates are velocities and their derivatives are
accelerations, and epsilon stays far from the singularity of a rotation vector. Outside this module
the six coordinates are the position in the world and the rotation vector from the world; their
rates are the velocity in the world and the angular velocity in the base's own frame.

`attitude` is the unit quaternion (4,) of the reference frame; an empty attitude means a base that
does not turn in space, for which all conversions return their input.

A planar base is simpler. The first body has two "modes", unit displacements along x and y of the
world, and the second a joint about z. Its three coordinates have rates that are derivatives.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Base
from dynamics.description.rotations import product, rotation_matrix
from dynamics.formulations.algebra import (
    ZERO,
    Scalar,
    Vector,
    add,
    combine,
    cos,
    cross,
    dot,
    matmul,
    matvec,
    minus,
    mscale,
    msub,
    mul,
    plus,
    scale,
    sin,
    skew,
    sqrt,
    sub,
    tmatvec,
)
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.formulations.kinematics import Chain, Scalars, outward, poses, series, tip_rotation
from dynamics.formulations.link_constants import LinkConstants
from dynamics.types import Vector3

SIZE = 6  # coordinates of a free base
NODES = 6  # of the quadrature in `carried`: error below 1e-9 rad for moves of a radian

_O: Vector3 = (0.0, 0.0, 0.0)
_BODY = LinkConstants(
    length=0.0, welded=True, prismatic=False, driven=False, bypassed=False, spring=0.0, pairs=(),
    mass=0.0, first_moment=_O, epsilon=(), s=(), c_jk=(), c=(),
    C=(), D=(), C0=validate.ZEROS, tip_phi=(), tip_theta=(), root_slope=(), K=(), K_pairs=(),
    sines=False, damping=(), tip_mass=0.0, tip_moment=_O, tip_inertia=validate.ZEROS, carried_at=_O,
    rotation=validate.IDENTITY, offset=_O, rotor_inertia=0.0, viscous=0.0, coulomb=0.0,
    coulomb_speed=1.0,
)  # fmt: skip


def _motion(tip_phi: tuple[Vector3, ...], tip_theta: tuple[Vector3, ...]) -> LinkConstants:
    """The body in front of the base, whose modes displace and turn its tip."""
    size = len(tip_phi)
    none = (0.0,) * size
    return replace(
        _BODY, epsilon=(_O,) * size, s=(none,) * size, c_jk=((_O,) * size,) * size,
        c=(_O,) * size, C=(validate.ZEROS,) * size, D=((validate.ZEROS,) * size,) * size,
        tip_phi=tip_phi, tip_theta=tip_theta, root_slope=none, K=(none,) * size,
        damping=(none,) * size,
    )  # fmt: skip


_MOTION = _motion((*validate.IDENTITY, _O, _O, _O), (_O, _O, _O, *validate.IDENTITY))
_IN_PLANE = _motion(validate.IDENTITY[:2], (_O, _O))


def bodies(base: Base) -> tuple[LinkConstants, ...]:
    """Bodies of the base, in front of the first link of a chain; none for a fixed base."""
    if base.type == "fixed":
        return ()
    com = skew(base.com)
    moment: Any = scale(base.mass, base.com)
    about_origin: Any = msub(base.inertia, mscale(base.mass, matmul(com, com)))
    body = replace(_BODY, mass=base.mass, first_moment=moment, C0=about_origin)
    if base.spatial:
        return _MOTION, body
    return _IN_PLANE, replace(body, welded=False, driven=base.driven)


def turned(chain: Chain, attitude: Scalars) -> Chain:
    """Return the chain with gravity expressed in the reference frame."""
    return replace(chain, gravity=tuple(local(chain.gravity, attitude)))


def local(x: Scalars, attitude: Scalars) -> list[Scalar]:
    """Turn the first three entries of x from the world to the reference frame.

    x : (n,) rates or accelerations, or a vector (3,).
    """
    if not len(attitude):
        return list(x)
    return [*tmatvec(rotation_matrix(attitude), x[:3]), *x[3:]]


def world(x: Scalars, attitude: Scalars) -> list[Scalar]:
    """Inverse of `local`; also for generalized forces (n,)."""
    if not len(attitude):
        return list(x)
    return [*matvec(rotation_matrix(attitude), x[:3]), *x[3:]]


def unturned(x: Scalars, attitude: Scalars) -> list[Scalar]:
    """Coordinates (n,) relative to the reference frame at the attitude: zero rotation vector."""
    return [*x[:3], *ZERO, *x[SIZE:]] if len(attitude) else list(x)


def matrix_in_world(M: Sequence[Scalars], attitude: Scalars) -> list[list[Scalar]]:
    """(n, n) mass matrix with rows and columns turned from the reference frame to the world."""
    rows = [world(row, attitude) for row in M]
    columns = [world(column, attitude) for column in zip(*rows, strict=True)]
    every = range(len(columns))
    # mirror one triangle: entries i, j and j, i are rounded differently
    return [[columns[min(i, j)][max(i, j)] for j in every] for i in every]


def renewed(
    six: Scalars, rates: Scalars, attitude: Scalars
) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
    """Turn the reference frame to the base's present attitude.

    Returns the coordinates (6,) and rates (6,) in the new frame, and the new attitude (4,).
    """
    E, turning, _ = tip_rotation(_MOTION, six, rates, "exp")
    omega = combine(rates, turning)
    square = mul(0.25, dot(six[3:], six[3:]))
    half = mul(0.5, series(square, 1)[0])
    fresh = product(attitude, (series(square, 0)[0], *scale(half, six[3:])))
    inverse = 1.0 / sqrt(dot(fresh, fresh))
    return (
        [*tmatvec(E, six[:3]), *ZERO],
        [*tmatvec(E, rates[:3]), *tmatvec(E, omega)],
        [mul(inverse, x) for x in fresh],
    )


def own_rates(six: Scalars, rates: Scalars) -> list[Scalar]:
    """Rates (6,) of the coordinates from velocity and angular velocity in the base's own frame.

    Correct to first order in the rotation vector, for derivatives at zero rotation.
    """
    return [*rates[:3], *add(rates[3:], scale(0.5, cross(six[3:], rates[3:])))]


def own_accelerations(six: Scalars, rates: Scalars, accelerations: Scalars) -> list[Scalar]:
    """Acceleration (3,) and angular acceleration (3,) in the base's own frame.

    `accelerations` (6,) are the second derivatives of the coordinates.
    """
    E, turning, bias = tip_rotation(_MOTION, six, rates, "exp")
    omega_dot = add(combine(accelerations, turning), bias)
    return [*accelerations[:3], *tmatvec(E, omega_dot)]


def carried(
    chain: Chain, joints: Sequence[int], q: Scalars, target: Scalars
) -> tuple[Scalar, Scalar, Scalar]:
    """Position [m] and angle [rad] of a planar base after the joints moved at zero momentum.

    Links are rigid, and the joints go from q to `target` (n_joint,) on a straight line. From
    M_bb v_b + M_bj v_j = 0 the base's angular rate depends on the joints alone, so that Gauss and
    Legendre's quadrature gives the angle; the centre of mass rests. `joints` are the indices of the
    joints in q (n,).
    """
    moves = [minus(x, q[i]) for x, i in zip(target, joints, strict=True)]

    def at(share: float) -> tuple[Scalars, Scalar]:
        """Centre of mass (2,) [m] in the base's frame, and the base's angle per unit of share."""
        x: list[Scalar] = [0.0] * len(q)
        for i, move in zip(joints, moves, strict=True):
            x[i] = plus(q[i], mul(share, move))
        M = mass_matrix(chain, x)
        heavy = 1.0 / M[0][0]
        centre = (mul(M[1][2], heavy), minus(0.0, mul(M[0][2], heavy)))
        across = [minus(mul(centre[0], M[1][i]), mul(centre[1], M[0][i])) for i in joints]
        moving = dot([minus(M[2][i], y) for i, y in zip(joints, across, strict=True)], moves)
        inertia = minus(M[2][2], mul(M[0][0], dot(centre, centre)))
        return centre, minus(0.0, mul(moving, 1.0 / inertia))

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    angle: Scalar = q[2]
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        angle = plus(angle, mul(0.5 * weight, at(0.5 + 0.5 * node)[1]))

    def turned_by(angle: Scalar, x: Scalars) -> tuple[Scalar, Scalar]:
        c, s = cos(angle), sin(angle)
        return minus(mul(c, x[0]), mul(s, x[1])), plus(mul(s, x[0]), mul(c, x[1]))

    before, after = turned_by(q[2], at(0.0)[0]), turned_by(angle, at(1.0)[0])
    px, py = (plus(q[k], minus(before[k], after[k])) for k in range(2))
    return px, py, angle


def momentum(chain: Chain, q: Scalars, v: Scalars) -> tuple[Vector, Vector]:
    """Linear momentum [N s] and angular momentum about the origin [N m s] of all bodies.

    Computed from velocities of mass points and bodies. Motor rotors are left out: their energy
    depends only on the rate relative to the housing.
    """
    linear, angular = ZERO, ZERO
    frames = outward(chain, q, v)
    for f, pose in zip(frames, poses(frames), strict=True):
        link, x_dot = f.link, f.shape.x_dot
        u = sub(tmatvec(pose.R, pose.tip_velocity), add(cross(f.w, f.r), f.r_dot))  # joint
        beam = add(scale(link.mass, u), cross(f.w, f.rho), combine(x_dot, link.epsilon))
        spin = add(cross(f.rho, u), matvec(f.B9, f.w), combine(x_dot, f.alpha))
        w_end = tmatvec(f.E, f.w_tip)
        spin = add(spin, matvec(f.E, matvec(link.tip_inertia, w_end)))
        beam = matvec(pose.R, beam)
        moment = matvec(pose.R, matvec(f.E, link.tip_moment))
        spin = add(matvec(pose.R, spin), cross(moment, pose.tip_velocity))
        body = scale(link.tip_mass, pose.tip_velocity)
        body = add(body, cross(matvec(pose.R, f.w_tip), moment))
        linear = add(linear, beam, body)
        angular = add(angular, spin, cross(pose.joint, beam), cross(pose.tip, body))
    return linear, angular
