"""Constants of one link: integrals over its mode shapes, computed once off-line as plain floats.

Equation numbers are those of Korayem & Shafei (2009). A point of the link is
r = [x, 0, 0] + sum_j delta_j r_j(x); the shape s_j of a mode acts along one direction:

| direction | displacement r_j | rotation theta_j |
|-----------|------------------|------------------|
| "y"       | (0, s, 0)        | (0, 0, s')       |
| "z"       | (0, 0, s)        | (0, -s', 0)      |
| "x"       | (0, 0, 0)        | (s, 0, 0)        |
| "axial"   | (s, 0, 0)        | (0, 0, 0)        |
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.description.arm import FOURTH_ORDER, Arm
from dynamics.description.beams.integrals import BeamIntegrals, beam_integrals
from dynamics.description.beams.sections import cut
from dynamics.description.deflection import TILT
from dynamics.description.joint import Joint
from dynamics.description.link import Body, Link, Payload, about_origin
from dynamics.description.mode_shapes import points
from dynamics.description.validate import IDENTITY, ZEROS
from dynamics.types import Array, Matrix3, Vector3

LIGHT_TIP = 1e-3  # [-] inertia of the last tip, over its link's, that turns by slopes for angles
LUMPED_SHARE, LUMPED_TWIST = 1 / 4, 1 / 3  # of mass and polar inertia, at the tip of lumped links
_E_X = np.array((1.0, 0.0, 0.0))
_E_Z = np.array((0.0, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class LinkConstants:
    """Constants of one link (a body of the chain) with m modes; mu = rho_A, int over 0 <= eta <= l.

    The integrals are (34)-(42), with eta = (x, 0, 0); K is (51)-(54). Absent terms are exact zeros.
    Foreshortening u = -1/2 int (y'^2 + z'^2) adds p shapes g_jk = int s_j' s_k' along x, which
    follow the m modes in every tuple except those of rotations, stiffness and damping. Their
    amplitudes are -delta_j delta_k, or half of it for j = k (`kinematics.amplitudes`). To fourth
    order, bending u has the stiffness `K_pairs`, and `condensed` has the beam's inertia in u.
    """

    length: float  # [m]
    welded: bool  # no coordinate of a joint: fixed to the tip of the body before
    prismatic: bool  # the joint slides along z instead of turning about it
    driven: bool  # a torque acts on the joint; false for a weld and for a joint spring's deflection
    bypassed: bool  # the next joint has a parallel drive, grounded on the base of this joint
    pairs: tuple[tuple[int, int], ...]  # (p) modes j <= k whose product foreshortens the link
    mass: float  # [kg] of beam and body
    first_moment: Vector3  # [kg m] int mu eta, plus the body
    epsilon: tuple[Vector3, ...]  # (m) [kg] int mu r_j
    s: tuple[tuple[float, ...], ...]  # (m, m) [kg] int mu r_j . r_k
    c_jk: tuple[tuple[Vector3, ...], ...]  # (m, m) [kg] int mu r_j x r_k
    c: tuple[Vector3, ...]  # (m) [kg m] int mu eta x r_j
    C: tuple[Matrix3, ...]  # (m) [kg m] int mu eta~' r_j~
    D: tuple[tuple[Matrix3, ...], ...]  # (m, m) [kg] int mu r_j~' r_k~
    C0: Matrix3  # [kg m^2] int mu eta~' eta~, plus the body
    tip_phi: tuple[Vector3, ...]  # (m) [-] displacement at the tip
    tip_theta: tuple[Vector3, ...]  # (m) [1/m] rotation at the tip
    root_slope: tuple[float, ...]  # (m) [1/m] rotation about z at the root
    K: tuple[tuple[float, ...], ...]  # (m, m) [N/m]
    K_pairs: tuple[tuple[float, ...], ...]  # (p, p) [N/m^3] int EI g'' g''; () if not fourth order
    sines: bool  # slopes at the tip are sines of its angles, to fourth order
    damping: tuple[tuple[float, ...], ...]  # (m, m) [N s/m]
    tip_mass: float  # [kg] including the payload
    tip_moment: Vector3  # [kg m] first moment of the body at the tip, about the tip
    tip_inertia: Matrix3  # [kg m^2] including the payload, about the tip
    carried_at: Vector3  # [m] from the tip to the payload's centre of mass
    rotation: Matrix3  # [-] mounting
    offset: Vector3  # [m] mounting
    rotor_inertia: float  # [kg m^2]
    viscous: float  # [N m s/rad]
    coulomb: float  # [N m]
    coulomb_speed: float  # [rad/s]
    spring: float  # [N m/rad] at the joint


def chain_constants(arm: Arm) -> list[tuple[LinkConstants, ...]]:
    """Bodies of every link of an arm: a rotor if the joint is elastic, then one per segment.

    A damping ratio that belongs to a link as a whole is not in them: see damping.py.
    """
    result = [
        _with_rotor(link.joint, *_on_root(link, payload, arm.foreshortening))
        for link, payload in zip(arm.links, arm.carried, strict=True)
    ]
    for i, link in enumerate(arm.links):
        if link.joint.parallel:
            result[i - 1] = (replace(result[i - 1][0], bypassed=True),)
    if result and _turns_almost_nothing(arm.links[-1], result[-1][-1]):
        result[-1] = (*result[-1][:-1], replace(result[-1][-1], sines=False))
    return result


def _turns_almost_nothing(link: Link, last: LinkConstants) -> bool:
    """True if the tip's rotation moves less than LIGHT_TIP of the link's own inertia."""
    own = link.beam.line_mass.second
    return float(np.abs(last.tip_inertia).max()) <= LIGHT_TIP * own


def _on_root(
    link: Link, payload: Payload | None, foreshortening: bool | str
) -> tuple[LinkConstants, ...]:
    """Bodies of a link without its rotor; a body in front carries a root beside the joint."""
    first, *others = parts(link)
    fixed = Joint(type="fixed", offset=link.joint.root)
    carrier = Link(length=0.0, body=Body(mass=0.0), joint=replace(link.joint, root=(0.0, 0.0, 0.0)))
    pieces = [first]
    if any(link.joint.root):
        listed = tuple(first.modes)  # of the link in its arm, not the rule's of a part
        pieces = [carrier, replace(first, joint=fixed, modes=listed)]
    last = len(pieces) + len(others) - 1
    return tuple(
        link_constants(
            piece,
            payload if k == last else None,
            foreshortening=foreshortening,
            welded=k > 0 or link.joint.welds,
        )
        for k, piece in enumerate([*pieces, *others])
    )


def _with_rotor(joint: Joint, *bodies: LinkConstants) -> tuple[LinkConstants, ...]:
    """Bodies of a link; an elastic joint adds a rotor body in front and a spring behind it.

    In a clamp that gives, the spring is on the tip before.
    """
    if joint.stiffness is None:
        return bodies
    sprung = replace(bodies[0], driven=False, spring=joint.stiffness, viscous=joint.spring_damping)
    if not joint.moves:
        return (sprung, *bodies[1:])
    mounted = replace(
        joint, hub_inertia=0.0, stiffness=None, spring_damping=0.0, root=(0.0, 0.0, 0.0)
    )
    rotor = link_constants(Link(length=0.0, body=Body(mass=0.0), joint=mounted))
    sprung = replace(
        sprung, rotation=IDENTITY, offset=(0.0, 0.0, 0.0), rotor_inertia=0.0, coulomb=0.0
    )
    return (rotor, sprung, *bodies[1:])


def parts(link: Link) -> list[Link]:
    """Split a link into equal segments: the first has the joint, the last the tip body."""
    if link.segments == 1:
        return [link]
    listed = tuple(link.modes)  # those of the whole link, not the rule's for a part
    size = link.length / link.segments

    def piece(k: int) -> Link:
        return replace(
            link, length=size, segments=1, modes=listed, damping_ratio=0.0, joint=Joint(),
            tip_mass=0.0, tip_inertia=ZEROS, body=None,
            sections=cut(link.sections, k * size, (k + 1) * size),
        )  # fmt: skip

    count = link.segments
    pieces = [piece(k) for k in range(count)] if link.sections else [piece(0)] * count
    pieces[0] = replace(pieces[0], joint=link.joint, body=link.body)
    pieces[-1] = replace(pieces[-1], tip_mass=link.tip_mass, tip_inertia=link.tip_inertia)
    return pieces


def link_constants(
    link: Link,
    payload: Payload | None = None,
    *,
    foreshortening: bool | str = False,
    welded: bool = False,
) -> LinkConstants:
    """All constants of one link without segments; `payload` is added to its tip body."""
    b = beam_integrals(link, foreshortening)
    m = len(link.modes)
    rho_A = link.mean("rho_A")
    second = rho_A * b.square
    mass, first_moment, C0 = _undeflected(link)
    s, c, C = _modal_inertia(link, b)
    payload = payload or Payload(mass=0.0)
    tip_inertia = np.array(link.tip_inertia) + about_origin(payload)
    constants = LinkConstants(
        length=link.length,
        welded=welded,
        prismatic=link.joint.type == "prismatic",
        driven=not welded,
        bypassed=False,
        pairs=b.pairs,
        mass=mass,
        first_moment=_tuples(first_moment),
        epsilon=_tuples((rho_A * b.zeroth)[:, None] * b.along),
        s=_tuples(s),
        c_jk=_tuples(_pairs(second, np.cross, b.along)),
        c=_tuples(c),
        C=_tuples(C),
        D=_tuples(_pairs(second, lambda u, w: _skew(u).T @ _skew(w), b.along)),
        C0=_tuples(C0),
        tip_phi=_tuples(b.tip[:, None] * b.along),
        tip_theta=_tuples(_tip_theta(link, b)),
        root_slope=_tuples(b.root_slope[:m]),
        K=_tuples(b.K),
        K_pairs=_tuples(b.K_pairs) if foreshortening == FOURTH_ORDER else (),
        sines=foreshortening == FOURTH_ORDER and bool(b.pairs),
        damping=_tuples(_damping(link, b)),
        tip_mass=link.tip_mass + payload.mass,
        tip_moment=_tuples(payload.mass * np.array(payload.com)),
        tip_inertia=_tuples(tip_inertia),
        carried_at=payload.com,
        rotation=link.joint.rotation,
        offset=link.joint.offset,
        rotor_inertia=link.joint.rotor_inertia,
        viscous=link.joint.viscous,
        coulomb=link.joint.coulomb,
        coulomb_speed=link.joint.coulomb_speed,
        spring=0.0,
    )
    if link.lumped and link.modes:
        return _lumped(constants, link)
    return _condensed(constants, b.share * rho_A) if constants.K_pairs else constants


def _condensed(k: LinkConstants, mass: float) -> LinkConstants:
    """Put a part of a beam's mass [kg] at its tip for all that is beyond second order.

    The tip body has every term of u, the beam none but products of u with the rigid motion. So the
    mass is added at the tip, and its terms of up to second order are taken from the beam.
    """
    m, x = len(k.K), k.length * _E_X
    along, bent = np.array(k.tip_phi), np.array(k.tip_phi)[:m]
    s, c_jk, C, D = (np.array(value) for value in (k.s, k.c_jk, k.C, k.D))
    s[:m, :m] -= mass * bent @ bent.T
    c_jk[:m, :m] -= mass * np.cross(bent[:, None], bent[None])
    C -= mass * np.array([_skew(x).T @ _skew(u) for u in along])
    D[:m, :m] -= mass * np.array([[_skew(u).T @ _skew(w) for w in bent] for u in bent])
    return replace(
        k,
        mass=k.mass - mass,
        tip_mass=k.tip_mass + mass,
        first_moment=_tuples(np.array(k.first_moment) - mass * x),
        C0=_tuples(np.array(k.C0) - mass * _skew(x).T @ _skew(x)),
        epsilon=_tuples(np.array(k.epsilon) - mass * along),
        c=_tuples(np.array(k.c) - mass * np.cross(x, along)),
        C=_tuples(C),
        s=_tuples(s),
        c_jk=_tuples(c_jk),
        D=_tuples(D),
    )


def _lumped(constants: LinkConstants, link: Link) -> LinkConstants:
    """Put a beam's inertia at Radau's two points; the modes move only what is at the tip.

    A uniform beam has 3/4 at l/3 and 1/4 at l. The straight link keeps its mass, first moment and
    inertia. A twist keeps the energy of turning in proportion to x.
    """
    share, twist = _lumps(link)
    carried = share * link.length**2 * np.diag((0.0, 1.0, 1.0)) + twist * np.outer(_E_X, _E_X)
    distributed = ("epsilon", "s", "c_jk", "c", "C", "D")
    return replace(
        constants,
        mass=constants.mass - share,
        first_moment=_tuples(constants.first_moment - share * link.length * _E_X),
        C0=_tuples(constants.C0 - carried),
        tip_mass=constants.tip_mass + share,
        tip_inertia=_tuples(constants.tip_inertia + twist * np.outer(_E_X, _E_X)),
        **{name: _tuples(0.0 * np.array(getattr(constants, name))) for name in distributed},
    )


def _lumps(link: Link) -> tuple[float, float]:
    """Mass [kg] and polar inertia [kg m^2] of a beam that move with its tip."""
    l = link.length
    if not link.sections:
        return LUMPED_SHARE * link.rho_A * l, LUMPED_TWIST * link.rho_Ip * l
    mass, first, second = link.beam.line_mass
    x, weights = points(link.beam, ())
    twist = float(weights @ (link.at("rho_Ip", x) * (x / l) ** 2))
    return (mass * second - first**2) / (mass * l**2 - 2.0 * first * l + second), twist


def _undeflected(link: Link) -> tuple[float, Array, Array]:
    """Mass [kg], first moment [kg m] and C0 [kg m^2] of the straight link with hub and body."""
    mass, first, second = link.beam.line_mass
    moment = first * _E_X
    C0 = second * np.diag((0.0, 1.0, 1.0))
    C0 = C0 + link.mean("rho_Ip") * link.length * np.outer(_E_X, _E_X)
    C0 = C0 + link.joint.hub_inertia * np.outer(_E_Z, _E_Z)
    if link.body is not None:
        com = np.array(link.body.com)
        moment = moment + link.body.mass * com
        C0 = C0 + np.array(link.body.inertia) + link.body.mass * _skew(com).T @ _skew(com)
        mass += link.body.mass
    return mass, moment, C0


def _modal_inertia(link: Link, b: BeamIntegrals) -> tuple[Array, Array, list[Array]]:
    """s [kg], c [kg m] and C [kg m] of the modes, with rotary inertia and hub as rotors.

    A rotor of inertia I about the unit axis e that modes turn at t_j per unit rate adds I t_j t_k
    to s, I t_j e to c_j and -1/2 I t_j e~ to C_j (and I e e' to C0).
    """
    hub, rho_A, rho_Ip = link.joint.hub_inertia, link.mean("rho_A"), link.mean("rho_Ip")
    s = rho_A * b.square * (b.along @ b.along.T)
    s += rho_Ip * b.square * np.outer(b.twist, b.twist)
    s += hub * np.outer(b.root_slope, b.root_slope)
    first = rho_A * b.first
    c = first[:, None] * np.cross(_E_X, b.along)
    C = [i * _skew(_E_X).T @ _skew(u) for i, u in zip(first, b.along, strict=True)]
    for axis, rates in ((_E_X, rho_Ip * b.twist * b.zeroth), (_E_Z, hub * b.root_slope)):
        c = c + rates[:, None] * axis
        C = [C_j - 0.5 * rate * _skew(axis) for C_j, rate in zip(C, rates, strict=True)]
    return s, c, C


def _tip_theta(link: Link, b: BeamIntegrals) -> Array:
    """(m, 3) [1/m] rotation of the tip by each mode."""
    m = len(link.modes)
    tilt = np.array([TILT[mode.direction] for mode in link.modes]).reshape(-1, 3)
    return b.tip_slope[:, None] * tilt + (b.tip * b.twist)[:m, None] * _E_X


def _damping(link: Link, b: BeamIntegrals) -> Array:
    """(m, m) [N s/m] 2 zeta sqrt(K_jj m_jj) on the diagonal, or beta K.

    m_jj is the mass that a shape moves, of beam and tip mass without payload. Those of
    clamped-tip-mass, which are natural modes, move the tip's rotary inertia too; torsion turns
    inertia alone.
    """
    m = len(link.modes)
    square, tip, twist = np.diag(b.square)[:m], b.tip[:m] ** 2, b.twist[:m] == 1.0
    theta = _tip_theta(link, b)
    beam = np.where(twist, link.mean("rho_Ip"), link.mean("rho_A")) * square
    turning = np.einsum("ja,ab,jb->j", theta, link.tip_inertia, theta)
    turning *= twist | np.array([mode.kind == "clamped-tip-mass" for mode in link.modes], bool)
    modal = beam + link.tip_mass * tip * ~twist + turning
    damping = 2.0 * link.damping_ratio * np.diag(np.sqrt(np.diag(b.K) * modal))
    own = link.damping_beta_torsion
    beta = np.where(twist, link.damping_beta if own is None else own, link.damping_beta)
    return damping + beta[:, None] * b.K


def _pairs(second: Array, product: Callable[[Array, Array], Array], along: Array) -> list[Any]:
    """second[j][k] * product(u_j, u_k) for every pair of modes."""
    return [
        [second[j, k] * product(u, w) for k, w in enumerate(along)] for j, u in enumerate(along)
    ]


def _skew(a: Array) -> Array:
    """a~, with a~ b = a x b."""
    return np.array(((0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)))


def _tuples(values: Any) -> Any:
    """Nested tuples of plain floats; no negative zeros."""
    if np.ndim(values) == 0:
        return float(values) + 0.0
    return tuple(_tuples(value) for value in values)
