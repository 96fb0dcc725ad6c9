"""A free base: six coordinates at the root of the recursion, position and attitude.

To the recursion the base is two bodies in front of the first link. One without mass or extent has
six "modes", unit displacements and unit rotations of its tip: amplitudes x (3) and a rotation
vector epsilon (3), seen from a frame that does not move. The other is the base itself, welded to
that tip. What bends a link's end also turns the base, E = exp(epsilon~), omega = J_l epsilon_dot.

The frame that does not move is the world, turned to an attitude that the base has, or had a step
ago: its own at epsilon = 0. There rates and their derivatives are velocities and accelerations,
and no chart ends anywhere near. Outside, the six are the position in the world and the rotation
vector from the world; their rates are the velocity in the world and the angular velocity in the
base's own frame. An empty attitude is a fixed base: everything stays as it is.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from dynamics.description import validate
from dynamics.description.arm import Base
from dynamics.description.rotations import product, rotation_matrix
from dynamics.formulations.algebra import (
    ZERO,
    Scalar,
    Vector,
    add,
    combine,
    cross,
    dot,
    matmul,
    matvec,
    mscale,
    msub,
    mul,
    scale,
    skew,
    sqrt,
    sub,
    tmatvec,
)
from dynamics.formulations.kinematics import Chain, outward, poses, series, tip_rotation
from dynamics.formulations.link_constants import LinkConstants
from dynamics.types import Vector3

SIZE = 6  # coordinates of a free base
Scalars = Sequence[Scalar]

_O: Vector3 = (0.0, 0.0, 0.0)
_BODY = LinkConstants(
    length=0.0, welded=True, prismatic=False, driven=False, bypassed=False, spring=0.0, pairs=(),
    mass=0.0, first_moment=_O, epsilon=(), s=(), c_jk=(), c=(),
    C=(), D=(), C0=validate.ZEROS, tip_phi=(), tip_theta=(), root_slope=(), K=(), damping=(),
    tip_mass=0.0, tip_inertia=validate.ZEROS, rotation=validate.IDENTITY, offset=_O,
    rotor_inertia=0.0, viscous=0.0, coulomb=0.0, coulomb_speed=1.0,
)  # fmt: skip
_NONE = (0.0,) * SIZE
_MOVER = replace(
    _BODY, epsilon=(_O,) * SIZE, s=(_NONE,) * SIZE, c_jk=((_O,) * SIZE,) * SIZE, c=(_O,) * SIZE,
    C=(validate.ZEROS,) * SIZE, D=((validate.ZEROS,) * SIZE,) * SIZE,
    tip_phi=(*validate.IDENTITY, _O, _O, _O), tip_theta=(_O, _O, _O, *validate.IDENTITY),
    root_slope=_NONE, K=(_NONE,) * SIZE, damping=(_NONE,) * SIZE,
)  # fmt: skip


def bodies(base: Base) -> tuple[LinkConstants, ...]:
    """What stands before the first link in a chain."""
    if base.type == "fixed":
        return ()
    com = skew(base.com)
    moment: Any = scale(base.mass, base.com)
    about_origin: Any = msub(base.inertia, mscale(base.mass, matmul(com, com)))
    return _MOVER, replace(_BODY, mass=base.mass, first_moment=moment, C0=about_origin)


def turned(chain: Chain, attitude: Scalars) -> Chain:
    """The chain with gravity as the base's own frame sees it."""
    return replace(chain, gravity=tuple(local(chain.gravity, attitude)))


def local(x: Scalars, attitude: Scalars) -> list[Scalar]:
    """Rates or accelerations (n,), or a vector (3,), their first three turned from the world."""
    if not len(attitude):
        return list(x)
    return [*tmatvec(rotation_matrix(attitude), x[:3]), *x[3:]]


def world(x: Scalars, attitude: Scalars) -> list[Scalar]:
    """Inverse of `local`; the same for forces."""
    if not len(attitude):
        return list(x)
    return [*matvec(rotation_matrix(attitude), x[:3]), *x[3:]]


def unturned(x: Scalars, attitude: Scalars) -> list[Scalar]:
    """Coordinates (n,) in the frame turned to the attitude: no rotation is left."""
    return [*x[:3], *ZERO, *x[SIZE:]] if len(attitude) else list(x)


def matrix_in_world(M: Sequence[Scalars], attitude: Scalars) -> list[list[Scalar]]:
    """A mass matrix whose rows and columns are those of `world`."""
    rows = [world(row, attitude) for row in M]
    columns = [world(column, attitude) for column in zip(*rows, strict=True)]
    every = range(len(columns))
    return [[columns[min(i, j)][max(i, j)] for j in every] for i in every]  # not two roundings


def renewed(
    six: Scalars, rates: Scalars, attitude: Scalars
) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
    """The base in the frame turned to its present attitude, from the frame of an earlier one.

    Returns the coordinates (6,), their rates (6,) and the attitude (4,).
    """
    E, turning, _ = tip_rotation(_MOVER, six, rates, "exp")
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
    """Rates (6,) that have these own rates: velocity, and angular velocity in the base's frame.

    To first order in the rotation vector, for derivatives where it is zero.
    """
    return [*rates[:3], *add(rates[3:], scale(0.5, cross(six[3:], rates[3:])))]


def own_accelerations(six: Scalars, rates: Scalars, accelerations: Scalars) -> list[Scalar]:
    """Accelerations (6,) with the angular acceleration in the base's frame."""
    E, turning, bias = tip_rotation(_MOVER, six, rates, "exp")
    omega_dot = add(combine(accelerations, turning), bias)
    return [*accelerations[:3], *tmatvec(E, omega_dot)]


def momentum(chain: Chain, q: Scalars, v: Scalars) -> tuple[Vector, Vector]:
    """Linear [N s] and angular momentum about the origin [N m s] of everything that moves.

    From the velocities of mass points and bodies; a motor's rotor, whose energy knows only the
    rate relative to its housing, has none of its own.
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
        body = scale(link.tip_mass, pose.tip_velocity)
        linear = add(linear, beam, body)
        angular = add(angular, matvec(pose.R, spin), cross(pose.joint, beam), cross(pose.tip, body))
    return linear, angular
