"""Equations of motion the slow way: positions as functions of time, differentiated twice.

Every quantity is a jet: its value, first and second time derivative. A rotation is the matrix
exponential of a jet, the bodies of an arm are Gauss points, rotors and tip bodies, and the kinetic
energy and the energy of acceleration are sums over them. Nothing here is recursive in forces, and
nothing is shared with `dynamics` except the mode shapes.
"""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.sparse.csgraph import connected_components

from dynamics import Arm, Body, Joint, Link
from dynamics.description.arm import FOURTH_ORDER
from dynamics.description.mode_shapes import shape
from dynamics.description.validate import ZEROS
from dynamics.types import Array
from tests.dynamics.jets import (
    NODES,
    WEIGHTS,
    _angles,
    _bending_of_shortening,
    _constant,
    _deflection,
    _product,
    _rotation,
    _shapes,
    _vector,
)

WHOLE = {"hierarchical", "unconstrained"}  # kinds whose damping ratio is that of natural modes
X, Y, Z = np.eye(3)


class Bodies(NamedTuple):
    """N rigid bodies: mass points where `inertia` is zero, rotors where `mass` is zero."""

    mass: Array  # (N,)
    inertia: Array  # (N, 3, 3) each in its own frame
    p: Array  # (3, N, 3, 1) jets of their positions
    R: Array  # (3, N, 3, 3) jets of their orientations

    def spin(self) -> tuple[Array, Array, Array]:
        """(N, 3) angular velocities, accelerations and momenta in the world frame."""
        R, Rt = self.R, np.swapaxes(self.R, -1, -2)
        w = _vector(R[1] @ Rt[0])
        w_dot = _vector(R[2] @ Rt[0] + R[1] @ Rt[1])
        return w, w_dot, R[0] @ self.inertia @ Rt[0]


def kinetic_energy(arm: Arm, q: Array, v: Array) -> float:
    """T [J] from the velocities of all bodies."""
    b, rotors = _bodies(arm, np.array([q, v, 0.0 * v]))
    w, _, J = b.spin()
    moving = 0.5 * b.mass @ np.sum(b.p[1] ** 2, axis=(1, 2))
    turning = 0.5 * np.einsum("ni,nij,nj->", w, J, w)
    return float(moving + turning + sum(0.5 * I * slip[1] ** 2 for I, slip in rotors))


def acceleration_energy(arm: Arm, q: Array, v: Array, a: Array) -> float:
    """The Gibbs-Appell function S up to terms without accelerations, gravity included."""
    b, rotors = _bodies(arm, np.array([q, v, a]))
    w, w_dot, J = b.spin()
    felt = b.p[2, :, :, 0] - np.array(arm.gravity)
    moving = 0.5 * b.mass @ np.sum(felt**2, axis=1)
    turning = 0.5 * np.einsum("ni,nij,nj->", w_dot, J, w_dot)
    gyroscopic = np.sum(w_dot * np.cross(w, np.einsum("nij,nj->ni", J, w)))
    return float(moving + turning + gyroscopic + sum(0.5 * I * s[2] ** 2 for I, s in rotors))


def mass_matrix(arm: Arm, q: Array) -> Array:
    """(n, n) M from T alone: M_jk = T(e_j + e_k) - T(e_j) - T(e_k)."""
    units = np.eye(arm.n)
    T = np.array([kinetic_energy(arm, q, e) for e in units])
    M = np.diag(2.0 * T)
    for j in range(arm.n):
        for k in range(j):
            M[j, k] = M[k, j] = kinetic_energy(arm, q, units[j] + units[k]) - T[j] - T[k]
    return M


def inertial_forces(arm: Arm, q: Array, v: Array, a: Array) -> Array:
    """(n,) dS/da, exact to round-off because S is quadratic in a."""
    steps = np.diag(1.0 + np.abs(a))
    return np.array(
        [
            acceleration_energy(arm, q, v, a + d) - acceleration_energy(arm, q, v, a - d)
            for d in steps
        ]
    ) / (2.0 * np.diag(steps))


def imbalance(M: Array, a: Array | list[float], load: Array) -> float:
    """Largest error of M a = load in a row, as a share of all that is added up there [-].

    A solution of its own would depend on M's condition, and on the machine's way to solve.
    """
    return float(np.max(np.abs(M @ a - load) / (np.abs(M) @ np.abs(a) + np.abs(load))))


def augmented(
    arm: Arm, M: Array, load: Array, guess: Array, s: float, d: float
) -> tuple[Array, Array]:
    """M + W and load + W guess, W = s K + d C of all that is linear in q and v, but dampers."""
    smooth = [replace(link, joint=replace(link.joint, coulomb=0.0)) for link in arm.links]
    linear, none = replace(arm, links=tuple(smooth), foreshortening=False), np.zeros(arm.n)
    units = np.eye(arm.n)
    K = np.array([resisting_forces(linear, e, none) for e in units]).T
    C = np.array([resisting_forces(linear, none, e, dampers=False) for e in units]).T
    W = s * K + d * C
    return M + W, load + W @ guess


def resisting_forces(arm: Arm, q: Array, v: Array, dampers: bool = True) -> Array:
    """(n,) elastic, damping and friction forces, from their definitions.

    `dampers` includes those across the segments of a link, which no implicit method takes so.
    """
    forces: list[float] = [0.0] * arm.base.n
    for (link, welded, spring), (turn, delta), (rate, delta_dot) in zip(
        _parts(arm), _by_part(arm, q), _by_part(arm, v), strict=True
    ):
        K, C = np.zeros((2, len(delta), len(delta)))
        x, weights = 0.5 * link.length * (NODES + 1.0), 0.5 * link.length * WEIGHTS
        root = np.zeros(len(delta))
        for j, mode in enumerate(link.modes):
            s = shape(mode, link.beam)
            root[j] = s.slope(0.0) if mode.direction == "y" else 0.0
            for k, other in enumerate(link.modes):
                if other.direction != mode.direction:
                    continue
                r = shape(other, link.beam)
                if mode.direction in ("x", "axial"):
                    rigidity = link.GJ if mode.direction == "x" else link.EA
                    K[j, k] = rigidity * weights @ (s.slope(x) * r.slope(x))
                else:
                    EI = link.EIz if mode.direction == "y" else link.EIy
                    K[j, k] = EI * weights @ (s.curvature(x) * r.curvature(x))
            twist = mode.direction == "x"
            m = (link.rho_Ip if twist else link.rho_A) * weights @ s.value(x) ** 2
            m += (link.tip_inertia[0][0] if twist else link.tip_mass) * s.value(link.length) ** 2
            if mode.kind == "clamped-tip-mass":
                axis = {"z": 1, "y": 2}[mode.direction]
                m += link.tip_inertia[axis][axis] * s.slope(link.length) ** 2
            C[j, j] = 2.0 * link.damping_ratio * np.sqrt(K[j, j] * m)
        twists = np.array([mode.direction == "x" for mode in link.modes], dtype=bool)
        torsion = link.damping_beta_torsion
        torsion = link.damping_beta if torsion is None else torsion
        C += np.where(twists, torsion, link.damping_beta)[:, None] * K
        if arm.foreshortening == FOURTH_ORDER:
            K_delta = K @ delta + _bending_of_shortening(link, delta)
        else:
            K_delta = K @ delta
        slip = rate + root @ delta_dot
        joint = link.joint
        friction = joint.viscous * slip + joint.coulomb * np.tanh(slip / joint.coulomb_speed)
        friction += spring * (turn + root @ delta)
        forces += [] if welded else [friction]
        forces += list(K_delta + C @ delta_dot + root * friction)
    result = np.array(forces)
    stop = arm.base.n
    for link in arm.links:
        stop += link.joint.moves + link.joint.elastic + link.segments * len(link.modes)
        whole = _damping_of_the_whole(link, viscous=not dampers)
        if whole is not None:
            rows = slice(stop - len(whole), stop)
            result[rows] += whole @ v[rows]
    return result


def momentum(arm: Arm, q: Array, v: Array) -> tuple[Array, Array]:
    """Linear momentum, and angular momentum about the world's origin, of all bodies."""
    b, _ = _bodies(arm, np.array([q, v, 0.0 * v]))
    p, moving = b.p[0, :, :, 0], b.mass[:, None] * b.p[1, :, :, 0]
    w, _, J = b.spin()
    return moving.sum(0), (np.cross(p, moving) + np.einsum("nij,nj->ni", J, w)).sum(0)


def gravity_energy(arm: Arm, q: Array) -> float:
    """Zero with all mass at the world's origin."""
    b, _ = _bodies(arm, np.array([q, 0.0 * q, 0.0 * q]))
    return float(-b.mass @ b.p[0, :, :, 0] @ np.array(arm.gravity))


def tip(arm: Arm, q: Array, v: Array) -> tuple[Array, Array]:
    """Position and velocity of the last tip."""
    bodies, _ = _bodies(arm, np.array([q, v, 0.0 * v]))
    return bodies.p[0, -1, :, 0], bodies.p[1, -1, :, 0]


# ---- jets: (3, N, ...) arrays of value, first and second derivative of N things -----------------


@cache
def _damping_of_the_whole(link: Link, viscous: bool = False) -> Array | None:
    """Damping matrix of a link whose ratio is that of its natural modes; None for any other.

    With segments it is written by projectors: modes 1 to 5 of each coupled set of coordinates have
    the ratio, the others the viscosity that gives it to mode 5. `viscous` leaves only the latter.
    """
    kinds = [mode.kind for mode in link.modes]
    several = any(kinds.count(kind) > 1 for kind in ("torsion-poly", "axial-poly"))
    whole = link.segments > 1 or link.lumped or several or WHOLE & {*kinds}
    if not (link.damping_ratio and link.modes and whole):
        return None
    joint = replace(link.joint, parallel=False)
    alone = Arm(links=(replace(link, joint=joint, damping_ratio=0.0, modes=tuple(link.modes)),))
    modal, rest = slice(alone.n - link.segments * len(link.modes), alone.n), np.zeros(alone.n)
    M = mass_matrix(alone, rest)[modal, modal]
    K = np.array([resisting_forces(alone, e, rest) for e in np.eye(alone.n)])[modal, modal]
    C = np.zeros_like(M)
    size = np.sqrt(np.outer(np.diag(M), np.diag(M)))
    count, label = connected_components((np.abs(M) > 1e-9 * size) | (np.abs(K) > 0.0))
    for k in range(count):
        at = np.ix_(label == k, label == k)
        if not M[at].any():
            continue
        squares, phi = eigh(K[at], M[at])
        rate = 2.0 * link.damping_ratio * np.sqrt(squares)
        if link.segments > 1:
            last = min(5, rate.size) - 1
            beta = rate[last] / squares[last]
            rate[0 if viscous else last :] = beta * squares[0 if viscous else last :]
        C[at] = M[at] @ phi @ np.diag(rate) @ phi.T @ M[at]
    return C


def _parts(arm: Arm) -> list[tuple[Link, bool, float]]:
    """All segments of all links, whether they are welded to the one before, springs at joints.

    A joint with a spring is two: a rotor without a link, and a free joint beside the spring. A root
    beside its joint is a link of its own.
    """
    parts = []
    for link in arm.links:
        joint, spring = link.joint, link.joint.stiffness or 0.0
        if spring and not joint.moves:
            free = {"type": "revolute", "stiffness": None, "spring_damping": 0.0}
            joint = replace(joint, viscous=joint.spring_damping, **free)
        elif spring:
            mounted = replace(
                joint, hub_inertia=0.0, stiffness=None, spring_damping=0.0, root=(0.0, 0.0, 0.0)
            )
            parts.append((_nothing(mounted), False, 0.0))
            joint = Joint(
                type=joint.type, hub_inertia=joint.hub_inertia, viscous=joint.spring_damping,
                root=joint.root,
            )  # fmt: skip
        if any(joint.root):
            carrier = replace(joint, root=(0.0, 0.0, 0.0))
            parts.append((_nothing(carrier), not joint.moves, spring))
            joint, spring = Joint(type="fixed", offset=joint.root), 0.0
        if _damping_of_the_whole(link) is not None:
            link = replace(link, damping_ratio=0.0)
        for k in range(link.segments):
            part = replace(link, length=link.length / link.segments, segments=1)
            if k < link.segments - 1:
                part = replace(part, tip_mass=0.0, tip_inertia=ZEROS)
            body = None if k else part.body
            part = replace(part, joint=Joint(type="fixed") if k else joint, body=body)
            parts.append((part, not part.joint.moves, 0.0 if k else spring))
    return parts


def _nothing(joint: Joint) -> Link:
    return Link(length=0.0, body=Body(mass=0.0), joint=joint)


def _by_part(arm: Arm, x: Array) -> list[tuple[Array, Array]]:
    """(joint, modes) of every segment, along the last axis of x; no joint turns by zero."""
    found, start = [], arm.base.n
    for part, welded, _ in _parts(arm):
        joint = np.zeros(x.shape[:-1]) if welded else x[..., start]
        start += not welded
        found.append((joint, x[..., start : start + len(part.modes)]))
        start += len(part.modes)
    assert start == x.shape[-1]
    return found


def _bodies(arm: Arm, jet: Array) -> tuple[Bodies, list[tuple[float, Array]]]:
    """All bodies of an arm in the world, and (inertia, slip) of the rotors; jet is (3, n)."""
    parts: list[tuple[Array, ...]] = []  # mass, inertia, p, R
    rotors: list[tuple[float, Array]] = []
    p, R = _base(jet) if arm.base.n else (_constant(0.0 * X), _constant(np.eye(3)))
    stand = R  # what the joint before turns on
    com = p + _product(R, _constant(arm.base.com))
    parts.append((np.array([arm.base.mass]), np.array(arm.base.inertia)[None], com, R))
    whole = _parts(arm)
    for i, ((link, _, _), (q, delta)) in enumerate(zip(whole, _by_part(arm, jet), strict=True)):
        p = p + _product(R, _constant(link.joint.offset))
        R = stand = _product(stand if link.joint.parallel else R, _constant(link.joint.rotation))
        if link.joint.type == "prismatic":
            p = p + _product(R, np.multiply.outer(q, Z)[:, None, :, None])
        else:
            R = _product(R, _rotation(q[:, None, None] * Z))
        if link.body:
            mass, at = np.array([link.body.mass]), p + _product(R, _constant(link.body.com))
            parts.append((mass, np.array([link.body.inertia]), at, R))
        root = delta @ [s.slope(0.0) * (m.direction == "y") for m, s in _shapes(link)]
        hub = _product(R, _rotation(root[:, None, None] * Z))
        parts.append((np.zeros(1), link.joint.hub_inertia * np.outer(Z, Z)[None], p, hub))
        rotors.append((link.joint.rotor_inertia, q + root))

        parts += _beam(link, delta, p, R, arm.foreshortening)
        r, theta = _deflection(link, delta, np.array([link.length]), bool(arm.foreshortening))
        if arm.foreshortening == FOURTH_ORDER and not _light_tip(arm, i, len(whole)):
            theta = _angles(theta)
        p, R = p + _product(R, r), _product(R, _rotation(theta))
        mass, inertia = link.tip_mass, np.array(link.tip_inertia)
        if link.lumped and link.modes:
            mass = mass + link.rho_A * link.length / 4.0
            inertia = inertia + link.rho_Ip * link.length / 3.0 * np.outer(X, X)
        if i == len(whole) - 1 and arm.payload:
            load, at = arm.payload, p + _product(R, _constant(arm.payload.com))
            parts.append((np.array([load.mass]), np.array(load.inertia)[None], at, R))
        parts.append((np.array([mass]), inertia[None], p, R))
    m, J, ps, Rs = zip(*parts, strict=True)
    joined = Bodies(
        np.concatenate(m), np.concatenate(J), np.concatenate(ps, 1), np.concatenate(Rs, 1)
    )
    return joined, rotors


def _beam(
    link: Link, delta: Array, p: Array, R: Array, shorten: bool | str
) -> list[tuple[Array, ...]]:
    """Sections of a beam at Gauss points, or the inner lump of a lumped one.

    Foreshortening u moves a section of mass m from x by r + u. To second order the energies keep
    the products of x + r with itself and of x with u. The latter's are those of masses m/2 at x + u
    and -m/2 at x - u. To fourth order, a part of the beam's mass at the tip has all other terms: it
    is added there, and its terms of second order are taken away.
    """
    if link.lumped and link.modes:
        mass, polar = link.rho_A * link.length, link.rho_Ip * link.length
        inner = p + _product(R, _constant(link.length / 3.0 * X))
        turned = polar * (2.0 / 3.0) * np.outer(X, X)[None]
        return [(np.array([0.75 * mass]), turned, inner, R)]
    x = 0.5 * link.length * (NODES + 1.0)
    mass, share = link.rho_A * 0.5 * link.length * WEIGHTS, 0.5 * link.length * WEIGHTS
    r, theta = _deflection(link, delta, x, shorten is True)
    section = _product(R, _rotation(theta * X)) if link.rho_Ip else R + 0.0 * r
    polar = link.rho_Ip * share[:, None, None] * np.outer(X, X)
    found = [(mass, polar, p + _product(R, r), section)]
    if shorten == FOURTH_ORDER:
        further = _to_second_order(link, delta, x, mass, p, R)[1:]
        found += [(k, 0.0 * polar, at, section) for k, at in further]
        end, m, none = np.array([link.length]), np.array([_condensed_mass(link)]), 0.0 * polar[:1]
        whole = p + _product(R, _deflection(link, delta, end, True)[0])
        found.append((m, none, whole, R))
        found += [(-k, none, at, R) for k, at in _to_second_order(link, delta, end, m, p, R)]
    return found


def _light_tip(arm: Arm, i: int, count: int) -> bool:
    """The last body turns less than a thousandth of the link's inertia: slopes are its angles."""
    link, payload = arm.links[-1], arm.payload
    inertia = np.array(link.tip_inertia)
    if payload:
        com, inertia = np.array(payload.com), inertia + np.array(payload.inertia)
        inertia += payload.mass * ((com @ com) * np.eye(3) - np.outer(com, com))
    small = np.abs(inertia).max() <= 1e-3 * link.rho_A * link.length**3 / 3.0
    return bool(i == count - 1 and small)


def _to_second_order(
    link: Link, delta: Array, x: Array, mass: Array, p: Array, R: Array
) -> list[tuple[Array, Array]]:
    """Masses and their jets whose energies are those of sections at x to second order."""
    r = _deflection(link, delta, x, False)[0]
    u = _deflection(link, delta, x, True)[0] - r
    straight = _deflection(link, 0.0 * delta, x, False)[0]
    shortened = [(0.5 * k * mass, p + _product(R, straight + k * u)) for k in (1.0, -1.0)]
    return [(mass, p + _product(R, r)), *shortened]


def _condensed_mass(link: Link) -> float:
    """Mass [kg] that, at the tip, moves as the beam does under the first shape's foreshortening."""
    shares = []
    for direction in "yz":
        own = [(m, s) for m, s in _shapes(link) if m.direction == direction]
        if own:
            x = 0.5 * link.length * (NODES + 1.0)
            inside = 0.5 * np.outer([*x, link.length], NODES + 1.0)
            g = 0.5 * np.array([*x, link.length]) * (own[0][1].slope(inside) ** 2 @ WEIGHTS)
            shares.append(0.5 * link.length * WEIGHTS @ g[:-1] ** 2 / g[-1] ** 2)
    return link.rho_A * float(np.mean(shares)) if shares else 0.0


def _base(jet: Array) -> tuple[Array, Array]:
    """Jets of a free base's origin and orientation, from its velocity and own angular velocity."""
    _, w, w_dot = (np.cross(x, -np.eye(3)) for x in jet[:, 3:6])
    R = _rotation(np.array([jet[0, 3:6], 0.0 * X, 0.0 * X])[:, None])[0]
    return jet[:, None, :3, None], np.stack([R, R @ w, R @ (w @ w + w_dot)])
