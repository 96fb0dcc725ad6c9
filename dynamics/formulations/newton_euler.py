"""Inverse dynamics of rigid arms by the Newton-Euler recursion, over any scalar type.

Equation numbers are those of Cyril's FLEXLINK thesis. No code is shared with the Gibbs-Appell
recursion: every link is one rigid body with its own centre of mass, and forces are summed link by
link from tip to base. `RigidLink` may hold symbols, so that the operations of a general arm can be
counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Link, Payload
from dynamics.formulations.algebra import (
    ZERO,
    ZEROS,
    Matrix,
    Scalar,
    Vector,
    add,
    cos,
    cross,
    matmul,
    matvec,
    minus,
    mul,
    plus,
    scale,
    sin,
    tanh,
    tmatvec,
    transpose,
)
from dynamics.formulations.kinematics import phi_of

Wrench = tuple[Vector, Vector]  # force [N], moment [N m] about the tip


@dataclass(frozen=True, kw_only=True)
class RigidLink:
    """A rigid link and its joint, in the link's frame."""

    joint: Joint
    rotation: Matrix  # (3, 3) from the joint's frame at q = 0 to the link before
    offset: Vector  # [m] from the tip before to the joint, in the frame of the link before
    tip: Vector  # [m] from joint to tip
    mass: Scalar  # [kg]
    com: Vector  # [m] from joint to centre of mass
    inertia: Matrix  # (3, 3) [kg m^2] about the centre of mass

    @property
    def slides(self) -> bool:
        """True if the joint is prismatic."""
        return self.joint.type == "prismatic"


def rigid_links(arm: Arm) -> tuple[RigidLink, ...]:
    """Links of a fixed-base arm without modes, springs or parallel drives.

    Each body includes the beam, hub, tip body and payload; raises ValueError for other arms.
    """
    if arm.base.type != "fixed":
        raise ValueError(
            f"Newton-Euler inverse dynamics is for a fixed base, got Base.type {arm.base.type!r}; "
            "use Model.inverse_dynamics."
        )
    for i, link in enumerate(arm.links, 1):
        if link.modes or link.joint.elastic or link.joint.parallel:
            what = "a spring at its joint" if link.joint.elastic else "a parallel drive"
            what = f"{len(link.modes)} modes" if link.modes else what
            raise ValueError(
                f"Newton-Euler inverse dynamics is for rigid arms, but link {i} has {what}; "
                "use Model.inverse_dynamics."
            )
    return tuple(map(_rigid_link, arm.links, arm.carried))


def _rigid_link(link: Link, payload: Payload | None) -> RigidLink:
    """Combine beam, hub, body, tip body and payload into one rigid body."""
    line, tip = link.beam.line_mass, (link.length, 0.0, 0.0)
    centre = line.first / line.mass if line.mass else 0.0
    slender, polar = line.second - line.first * centre, link.mean("rho_Ip") * link.length
    around = np.diag((polar, slender, slender + link.joint.hub_inertia))
    shares = [(line.mass, (centre, 0.0, 0.0), around)]
    shares.append((link.tip_mass, tip, np.array(link.tip_inertia)))
    if link.body is not None:
        shares.append((link.body.mass, link.body.com, np.array(link.body.inertia)))
    if payload is not None:
        x, y, z = payload.com
        shares.append((payload.mass, (link.length + x, y, z), np.array(payload.inertia)))
    masses = np.array([m for m, _, _ in shares])
    places = np.array([np.add(c, link.joint.root) for _, c, _ in shares])
    mass = float(masses.sum())
    com = masses @ places / (mass or 1.0)
    inertia = np.sum([J for _, _, J in shares], axis=0)
    for m, r in zip(masses, places - com, strict=True):
        inertia = inertia + m * ((r @ r) * np.eye(3) - np.outer(r, r))
    return RigidLink(
        joint=link.joint,
        rotation=link.joint.rotation,
        offset=link.joint.offset,
        tip=tuple(np.add(tip, link.joint.root).tolist()),
        mass=mass,
        com=tuple(com.tolist()),
        inertia=tuple(map(tuple, inertia.tolist())),
    )


def inverse_dynamics(
    links: Sequence[RigidLink],
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    a: Sequence[Scalar],
    *,
    gravity: Vector = ZERO,
    wrench: Wrench = (ZERO, ZERO),
) -> list[Scalar]:
    """(n,) [N m or N] joint torques and forces that move the arm with accelerations `a`.

    Parameters
    ----------
    links : from `rigid_links`.
    q, v, a : (n,) [rad or m] coordinates, rates, accelerations of the joints that move; floats or
        symbols.
    gravity : (3,) [m/s^2] in the world frame.
    wrench : force [N] and moment [N m] that the last link exerts on its surroundings at its tip,
        in the last link's frame: f_{N,N+1} and n_{N,N+1}.
    """
    moving = [link.joint.moves for link in links]
    q, v, a = (_spread(x, moving) for x in (q, v, a))
    w, w_dot, Phi = ZERO, ZERO, ZEROS
    p_dd: Vector = scale(-1.0, gravity)  # acceleration of the frame's origin; of the base, -g
    before, loads = ZERO, []  # before: from joint to tip of the link before, in its frame
    for link, angle, rate, rise in zip(links, q, v, a, strict=True):
        R, shift = _joint(link, angle)
        p_dd = tmatvec(R, add(p_dd, matvec(Phi, add(before, shift))))  # (2.6)
        w, w_dot = tmatvec(R, w), tmatvec(R, w_dot)
        along, faster = (0.0, 0.0, rate), (0.0, 0.0, rise)
        if link.slides:
            p_dd = add(p_dd, scale(2.0, cross(w, along)), faster)  # (2.7b)
        else:
            w, w_dot = add(w, along), add(w_dot, cross(w, along), faster)  # (2.3), (2.4)
        Phi = phi_of(w, w_dot)
        force = scale(link.mass, add(p_dd, matvec(Phi, link.com)))  # (2.8d), (2.9)
        loads.append((R, shift, force, _moment(link.inertia, w, w_dot, Phi)))
        before = link.tip
    f, n = wrench  # at the tip of link i, in its frame
    torques: list[Scalar] = []
    backward = zip(reversed(links), reversed(loads), reversed(v), strict=True)
    for link, (R, shift, force, moment), rate in backward:
        n = add(n, cross(link.tip, f), moment, cross(link.com, force))  # (2.12)
        f = add(f, force)  # (2.11)
        torques.append(plus(f[2] if link.slides else n[2], _resistance(link.joint, rate)))  # (2.13)
        f = matvec(R, f)
        n = add(matvec(R, n), cross(shift, f))
    rotors = [mul(link.joint.rotor_inertia, rise) for link, rise in zip(links, a, strict=True)]
    found = zip(reversed(torques), rotors, moving, strict=True)
    return [plus(tau, rotor) for tau, rotor, moves in found if moves]


def _spread(x: Sequence[Scalar], moving: Sequence[bool]) -> list[Scalar]:
    """One entry per link: zero where the joint is fixed."""
    entries = iter(x)
    return [next(entries) if moves else 0.0 for moves in moving]


def _joint(link: RigidLink, q: Scalar) -> tuple[Matrix, Vector]:
    """Rotation of a link's frame in the link before, and its origin from that link's tip: (2.1)."""
    F = link.rotation
    if link.slides:
        return F, add(link.offset, scale(q, transpose(F)[2]))
    c, s = cos(q), sin(q)
    return matmul(F, ((c, minus(0.0, s), 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))), link.offset


def _moment(J: Matrix, w: Vector, w_dot: Vector, Phi: Matrix) -> Vector:
    """J w_dot + w x J w, (2.10), from the entries of Phi: 15 products instead of 24."""

    def component(i: int) -> Scalar:
        j, k = (i + 1) % 3, (i + 2) % 3
        products = plus(
            mul(J[i][i], w_dot[i]),
            mul(minus(J[k][k], J[j][j]), mul(w[j], w[k])),
            mul(J[j][k], minus(Phi[j][j], Phi[k][k])),
        )
        return plus(products, minus(mul(J[i][k], Phi[j][i]), mul(J[i][j], Phi[k][i])))

    return (component(0), component(1), component(2))


def _resistance(joint: Joint, rate: Scalar) -> Scalar:
    """Joint friction [N m or N]: viscous, and Coulomb smoothed by tanh."""
    viscous = mul(joint.viscous, rate)
    if joint.coulomb == 0.0:
        return viscous
    return plus(viscous, mul(joint.coulomb, tanh(mul(1.0 / joint.coulomb_speed, rate))))
