"""Off-line integrals of one link: what the recursion needs of its shapes, once, as plain floats.

Equation numbers are those of Korayem & Shafei (2009). A point of the link is
r = [x, 0, 0] + sum_j delta_j r_j(x); the shape s_j of a mode acts along one direction:

| direction | displacement r_j | rotation theta_j |
|-----------|------------------|------------------|
| "y"       | (0, s, 0)        | (0, 0, s')       |
| "z"       | (0, 0, s)        | (0, -s', 0)      |
| "x"       | (0, 0, 0)        | (s, 0, 0)        |
| "axial"   | (s, 0, 0)        | (0, 0, 0)        |
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from dynamics.description.arm import Arm, Payload
from dynamics.description.beam_shapes import Shape
from dynamics.description.joint import Joint
from dynamics.description.link import Body, Link
from dynamics.description.mode_shapes import STIFFNESS, quadrature, shape
from dynamics.description.validate import IDENTITY, ZEROS
from dynamics.types import Array, Matrix3, Vector3

__all__ = ["LinkConstants", "curvature", "deflection", "link_constants", "shape"]

_ROUND_OFF = 1e-12  # [-] integrals this small beside their natural size are exact zeros
_ENTRY_ROUND_OFF = 1e-14  # [-] the same for the entries of a mounting rotation

_BENDING = ("y", "z")  # strained by s''; the others by s'
_DISPLACEMENT: dict[str, Vector3] = {  # times s
    "x": (0, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "axial": (1, 0, 0),
}  # fmt: skip
_TILT: dict[str, Vector3] = {  # times s'
    "x": (0, 0, 0), "y": (0, 0, 1), "z": (0, -1, 0), "axial": (0, 0, 0),
}  # fmt: skip
_TWIST: dict[str, Vector3] = {  # times s
    "x": (1, 0, 0), "y": (0, 0, 0), "z": (0, 0, 0), "axial": (0, 0, 0),
}  # fmt: skip
_E_X = np.array((1.0, 0.0, 0.0))
_E_Z = np.array((0.0, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class LinkConstants:
    """One link as the recursion sees it: m modes, mu = rho_A, int over 0 <= eta <= l.

    The integrals are (34)-(42), with eta = (x, 0, 0); K is (51)-(54). Exact zeros where nothing is.
    Foreshortening u = -1/2 int (y'^2 + z'^2) is p further shapes g_jk = int s_j' s_k' along x,
    behind the m modes in every list but those of rotations and stiffness; their amplitudes are
    -delta_j delta_k, or half of it for j = k (`kinematics.amplitudes`).
    """

    length: float  # [m]
    welded: bool  # no joint: a part of the link before
    prismatic: bool  # the joint slides along z instead of turning about it
    driven: bool  # a torque acts on the joint: not on a weld or a spring's twist
    bypassed: bool  # the next joint's parallel drive stands on what this joint stands on
    pairs: tuple[tuple[int, int], ...]  # (p) modes j <= k whose product foreshortens the link
    mass: float  # [kg] of the beam and body
    first_moment: Vector3  # [kg m] int mu eta, and the body's
    epsilon: tuple[Vector3, ...]  # (m) [kg] int mu r_j
    s: tuple[tuple[float, ...], ...]  # (m, m) [kg] int mu r_j . r_k
    c_jk: tuple[tuple[Vector3, ...], ...]  # (m, m) [kg] int mu r_j x r_k
    c: tuple[Vector3, ...]  # (m) [kg m] int mu eta x r_j
    C: tuple[Matrix3, ...]  # (m) [kg m] int mu eta~' r_j~
    D: tuple[tuple[Matrix3, ...], ...]  # (m, m) [kg] int mu r_j~' r_k~
    C0: Matrix3  # [kg m^2] int mu eta~' eta~, and the body's
    tip_phi: tuple[Vector3, ...]  # (m) [-] displacement at the tip
    tip_theta: tuple[Vector3, ...]  # (m) [1/m] rotation at the tip
    root_slope: tuple[float, ...]  # (m) [1/m] rotation about z at the root
    K: tuple[tuple[float, ...], ...]  # (m, m) [N/m]
    damping: tuple[tuple[float, ...], ...]  # (m, m) [N s/m]
    tip_mass: float  # [kg] with the payload
    tip_inertia: Matrix3  # [kg m^2] with the payload
    rotation: Matrix3  # [-] mounting
    offset: Vector3  # [m] mounting
    rotor_inertia: float  # [kg m^2]
    viscous: float  # [N m s/rad]
    coulomb: float  # [N m]
    coulomb_speed: float  # [rad/s]
    spring: float  # [N m/rad] at the joint


def chain_constants(arm: Arm) -> list[tuple[LinkConstants, ...]]:
    """Constants of every link of an arm as bodies: any rotor on a spring, then its welded parts."""
    result = [
        _with_rotor(
            link.joint,
            *(
                link_constants(
                    part,
                    payload if k == link.segments - 1 else None,
                    foreshortening=arm.foreshortening,
                    welded=k > 0,
                )
                for k, part in enumerate(parts(link))
            ),
        )
        for link, payload in zip(arm.links, arm.carried, strict=True)
    ]
    for i, link in enumerate(arm.links):
        if link.joint.parallel:
            result[i - 1] = (replace(result[i - 1][0], bypassed=True),)
    return result


def _with_rotor(joint: Joint, *bodies: LinkConstants) -> tuple[LinkConstants, ...]:
    """A link's bodies; behind an elastic joint a spring turns them beside a massless rotor."""
    if joint.stiffness is None:
        return bodies
    mounted = replace(joint, hub_inertia=0.0, stiffness=None, spring_damping=0.0)
    rotor = link_constants(Link(length=0.0, body=Body(mass=0.0), joint=mounted))
    sprung = replace(
        bodies[0], driven=False, spring=joint.stiffness, viscous=joint.spring_damping,
        rotation=IDENTITY, offset=(0.0, 0.0, 0.0), rotor_inertia=0.0, coulomb=0.0,
    )  # fmt: skip
    return (rotor, sprung, *bodies[1:])


def parts(link: Link) -> list[Link]:
    """The link's segments: equal parts, the joint on the first and the tip body on the last."""
    if link.segments == 1:
        return [link]
    bare = replace(link, length=link.length / link.segments, segments=1)
    middle = replace(bare, joint=Joint(), tip_mass=0.0, tip_inertia=ZEROS)
    first = replace(middle, joint=link.joint)
    return [first, *[middle] * (link.segments - 2), replace(bare, joint=Joint())]


def link_constants(
    link: Link,
    payload: Payload | None = None,
    *,
    foreshortening: bool = False,
    welded: bool = False,
) -> LinkConstants:
    """All constants of one link without segments; `payload` joins its tip body.

    The rotary inertia rho_Ip and the hub are rotors: a rotor about the unit axis e with inertia I
    that modes turn at t_j per unit rate adds I e e' to C0, I t_j e to c_j, I t_j t_k to s and
    -1/2 I t_j e~ to C_j. The damping ratio counts the mass that a mode displaces, with the
    link's tip mass but not the payload's; a torsion mode displaces none, so beta must damp it.
    """
    x, weights = quadrature(link.length, link.modes)
    shapes = [shape(mode, link) for mode in link.modes]
    values = _table([s.value(x) for s in shapes], x.size)
    directions = [mode.direction for mode in link.modes]
    along = np.array([_DISPLACEMENT[d] for d in directions]).reshape(-1, 3)
    twist = np.array([_TWIST[d][0] for d in directions])  # 1 for torsion, else 0

    m = len(shapes)
    pairs, shortening, shortening_tip = _shortening(link, shapes, x, weights, foreshortening)
    values = np.vstack([values, shortening])
    along = np.vstack([along, np.tile(_E_X, (len(pairs), 1))])
    twist = np.append(twist, np.zeros(len(pairs)))

    mass = link.rho_A * link.length
    moment = mass * link.length / 2.0 * _E_X
    square = (values * weights) @ values.T  # int s_j s_k
    size = np.sqrt(np.diag(square))
    square = _snap(square, np.outer(size, size))
    zeroth = link.rho_A * _snap(values @ weights, math.sqrt(link.length) * size)
    first = link.rho_A * _snap(values @ (weights * x), link.length**1.5 * size)
    second = link.rho_A * square

    epsilon = zeroth[:, None] * along
    s = second * (along @ along.T)
    c = first[:, None] * np.cross(_E_X, along)
    C = [i * _skew(_E_X).T @ _skew(u) for i, u in zip(first, along, strict=True)]
    C0 = mass * link.length**2 / 3.0 * np.diag((0.0, 1.0, 1.0))

    polar = link.rho_Ip * twist  # rotary inertia about x, spread along the link
    spin = polar * _snap(values @ weights, math.sqrt(link.length) * size)  # int rho_Ip s_j
    s += link.rho_Ip * square * np.outer(twist, twist)
    root_slope = np.zeros(len(values))
    for j, mode in enumerate(link.modes):
        if mode.kind == "pinned-free":
            root_slope[j] = float(shapes[j].slope(0.0))
    hub = link.joint.hub_inertia
    s += hub * np.outer(root_slope, root_slope)
    for axis, inertia, rates in (
        (_E_X, link.rho_Ip * link.length, spin),
        (_E_Z, hub, hub * root_slope),
    ):
        C0 = C0 + inertia * np.outer(axis, axis)
        c = c + rates[:, None] * axis
        C = [C_j - 0.5 * rate * _skew(axis) for C_j, rate in zip(C, rates, strict=True)]

    if link.body is not None:
        com = np.array(link.body.com)
        moment = moment + link.body.mass * com
        C0 = C0 + np.array(link.body.inertia) + link.body.mass * _skew(com).T @ _skew(com)
        mass += link.body.mass

    K = _stiffness(link, shapes, x, weights)
    tip_value = np.array([*(float(s_j.value(link.length)) for s_j in shapes), *shortening_tip])
    tip_value = _snap(tip_value, size / math.sqrt(link.length))
    tip_slope = np.array([float(s_j.slope(link.length)) for s_j in shapes])
    tip_slope = _snap(tip_slope, size[:m] / link.length**1.5)
    tilt = np.array([_TILT[d] for d in directions]).reshape(-1, 3)
    displaced = (link.rho_A * np.diag(square) + link.tip_mass * tip_value**2)[:m]
    modal = np.where(twist[:m] == 1.0, 0.0, displaced)
    damping = 2.0 * link.damping_ratio * np.diag(np.sqrt(np.diag(K) * modal))
    damping = damping + link.damping_beta * K

    tip_inertia = np.array(link.tip_inertia)
    if payload is not None:
        tip_inertia = tip_inertia + np.array(payload.inertia)
    mounting = np.array(link.joint.rotation)
    mounting = np.where(np.abs(mounting) < _ENTRY_ROUND_OFF, 0.0, mounting)
    mounting = np.where(
        np.abs(np.abs(mounting) - 1.0) < _ENTRY_ROUND_OFF, np.sign(mounting), mounting
    )
    return LinkConstants(
        length=link.length,
        welded=welded,
        prismatic=link.joint.type == "prismatic",
        driven=not welded,
        bypassed=False,
        pairs=pairs,
        mass=mass,
        first_moment=_tuples(moment),
        epsilon=_tuples(epsilon),
        s=_tuples(s),
        c_jk=_tuples(_pairs(second, np.cross, along)),
        c=_tuples(c),
        C=_tuples(C),
        D=_tuples(_pairs(second, lambda u, w: _skew(u).T @ _skew(w), along)),
        C0=_tuples(C0),
        tip_phi=_tuples(tip_value[:, None] * along),
        tip_theta=_tuples(tip_slope[:, None] * tilt + (tip_value * twist)[:m, None] * _E_X),
        root_slope=_tuples(root_slope[:m]),
        K=_tuples(K),
        damping=_tuples(damping),
        tip_mass=link.tip_mass + (payload.mass if payload is not None else 0.0),
        tip_inertia=_tuples(tip_inertia),
        rotation=_tuples(mounting),
        offset=link.joint.offset,
        rotor_inertia=link.joint.rotor_inertia,
        viscous=link.joint.viscous,
        coulomb=link.joint.coulomb,
        coulomb_speed=link.joint.coulomb_speed,
        spring=0.0,
    )


def deflection(link: Link, delta: Iterable[float], x: Array) -> Array:
    """Elastic displacement of the points x of a link, in the link's frame.

    Parameters
    ----------
    delta : (m,) [m] modal amplitudes.
    x : (n,) [m] places along the undeformed link.

    Returns
    -------
    (n, 3) [m]
    """
    x = np.asarray(x, dtype=np.float64)
    result = np.zeros((x.size, 3))
    for mode, d in zip(link.modes, delta, strict=True):
        result += d * np.outer(shape(mode, link).value(x), _DISPLACEMENT[mode.direction])
    return result


def curvature(link: Link, x: float) -> Array:
    """Twist rate and curvatures at x per unit amplitude of each mode.

    Returns
    -------
    (m, 3) [1/m^2] about x: s' of a torsion mode; about y: -s'' of a "z" mode; about z: s'' of a
    "y" mode.
    """
    rows = []
    for mode in link.modes:
        s = shape(mode, link)
        about = _TWIST if mode.direction == "x" else _TILT
        rate = s.curvature(x) if mode.direction in _BENDING else s.slope(x)
        rows.append(float(rate) * np.array(about[mode.direction]))
    return np.array(rows).reshape(-1, 3)


def _stiffness(link: Link, shapes: list[Shape], x: Array, weights: Array) -> Array:
    """int GJ or EA s_j' s_k' (torsion, axial), int EI s_j'' s_k'' (bending); no cross terms."""
    bent = _table(
        [
            s.curvature(x) if mode.direction in _BENDING else s.slope(x)
            for s, mode in zip(shapes, link.modes, strict=True)
        ],
        x.size,
    )
    rigidity = np.array([getattr(link, STIFFNESS[mode.direction]) for mode in link.modes])
    same = np.array([[j.direction == k.direction for k in link.modes] for j in link.modes])
    K = (bent * weights) @ bent.T * same.reshape(len(shapes), len(shapes))
    size = np.sqrt(np.diag(K))
    return rigidity.reshape(-1, 1) * _snap(K, np.outer(size, size))


def _shortening(
    link: Link, shapes: list[Shape], x: Array, weights: Array, wanted: bool
) -> tuple[tuple[tuple[int, int], ...], Array, list[float]]:
    """Pairs of modes that foreshorten the link, g_jk = int_0^x s_j' s_k' at x, and at the tip."""
    directions = [mode.direction for mode in link.modes]
    pairs = tuple(
        (j, k)
        for j in range(len(shapes))
        for k in range(j, len(shapes))
        if wanted and directions[j] == directions[k] in _BENDING
    )
    if not pairs:
        return (), _table([], x.size), []
    # integrate the Legendre interpolant through the nodes of the quadrature
    node = 2.0 * x / link.length - 1.0
    basis = legendre.legvander(node, x.size - 1)
    norms = (2.0 * np.arange(x.size) + 1.0) / link.length
    to_series = norms[:, None] * (basis * weights[:, None]).T
    slopes = [s.slope(x) for s in shapes]
    series = [
        legendre.legint(to_series @ (slopes[j] * slopes[k]), lbnd=-1.0, scl=link.length / 2.0)
        for j, k in pairs
    ]
    values = _table([np.asarray(legendre.legval(node, c)) for c in series], x.size)
    return pairs, values, [float(legendre.legval(1.0, c)) for c in series]


def _table(rows: list[Array], columns: int) -> Array:
    return np.array(rows, dtype=np.float64).reshape(len(rows), columns)


def _pairs(second: Array, product: Callable[[Array, Array], Array], along: Array) -> list[Any]:
    """second[j][k] * product(u_j, u_k) for every pair of modes."""
    return [
        [second[j, k] * product(u, w) for k, w in enumerate(along)] for j, u in enumerate(along)
    ]


def _snap(values: Array, size: Array) -> Array:
    """Exact zeros where a value is round-off beside its natural size."""
    return np.where(np.abs(values) <= _ROUND_OFF * size, 0.0, values)


def _skew(a: Array) -> Array:
    """a~, with a~ b = a x b."""
    return np.array(((0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)))


def _tuples(values: Any) -> Any:
    """Nested tuples of plain floats; no negative zeros."""
    if np.ndim(values) == 0:
        return float(values) + 0.0
    return tuple(_tuples(value) for value in values)
