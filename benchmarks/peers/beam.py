"""Geometrically exact planar beams by polynomials of high degree: the truth of the peers' scenes.

A link is described by the angle theta(s) of its axis and by its stretch e(s), polynomials of the
undeformed coordinate s. Deflections of any size are exact:

    r(s) = r(0) + int_0^s (1 + e) (cos theta, sin theta) ds
    V = 1/2 int EI theta'^2 + EA e^2 ds,  T = 1/2 int rho_A r_t . r_t ds

No segment, hinge or mode shape occurs, and the error falls exponentially with the degree. The
integration is a Runge-Kutta method of order 4 at steps far below the period of every mode.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numba import njit
from numpy.polynomial import legendre

from dynamics import Arm
from dynamics.accuracy.scene import JointMotion
from dynamics.types import Array

CAREFUL = 1.5  # [-] largest product of step and frequency; 2.8 is stable


class Beam(NamedTuple):
    """Constants of an arm of beams: n coordinates per link, G points of quadrature."""

    angles: Array  # (G, degree + 1) shapes of theta; the first is 1, the others are 0 at the root
    stretches: Array  # (G, m) shapes of e
    integrals: Array  # (n_link, G + 1, G) [m] from the root to the points and to the tip
    masses: Array  # (n_link, G + 1) [kg] at the points and at the tip
    stiffness: Array  # (n_link n, n_link n)
    rotor: float  # [kg m^2] at the root of the first link
    gravity: Array  # (2,) [m/s^2]


def beam(arm: Arm, degree: int, stretch: int = 0, axial: float = 0.0) -> Beam:
    """An arm with polynomials theta of `degree` and `stretch` Legendre polynomials e; EA `axial`.

    The stretch is zero with `stretch` 0.
    """
    points = 2 * degree + 6
    x, weights = legendre.leggauss(points)
    rise = np.eye(degree + 1)
    rise[0, 1:] = -((-1.0) ** np.arange(1, degree + 1))
    angles = legendre.legvander(x, degree) @ rise
    bends = np.column_stack([legendre.legval(x, legendre.legder(c)) for c in rise.T])
    stretches = np.ascontiguousarray(legendre.legvander(x, max(stretch, 1))[:, :stretch], float)
    to_series = np.linalg.inv(legendre.legvander(x, points - 1))
    rising = legendre.legint(to_series, lbnd=-1.0, axis=0)
    unit = legendre.legval(np.append(x, 1.0), rising).T
    size = degree + 1 + stretch
    K = np.zeros((size * len(arm.links),) * 2)
    for i, link in enumerate(arm.links):
        at, half = i * size, 0.5 * link.length
        bent, stretched = slice(at, at + degree + 1), slice(at + degree + 1, at + size)
        K[bent, bent] = (link.EIz or 0.0) / half * (bends.T * weights) @ bends
        K[stretched, stretched] = axial * half * (stretches.T * weights) @ stretches
    return Beam(
        angles, stretches,
        np.array([0.5 * link.length * unit for link in arm.links]),
        np.array([[*(0.5 * k.length * k.rho_A * weights), k.tip_mass] for k in arm.links]),
        K, arm.links[0].joint.rotor_inertia, np.array(arm.gravity[:2]),
    )  # fmt: skip


@njit
def equations(q: Array, v: Array, torque: float, beam: Beam) -> tuple[Array, Array]:
    """Mass matrix and forces."""
    n_link, n, count = len(beam.integrals), q.size, beam.angles.shape[1]
    size = n // n_link
    M, f = np.zeros((n, n)), -beam.stiffness @ q
    M[0, 0], f[0] = beam.rotor, f[0] + torque
    slopes, biases = np.zeros((2, n)), np.zeros(2)  # of the link's root
    for i in range(n_link):
        at = i * size
        theta = beam.angles @ q[at : at + count]
        turn = beam.angles @ v[at : at + count]
        e = 1.0 + beam.stretches @ q[at + count : at + size]
        rate = beam.stretches @ v[at + count : at + size]
        along = (np.cos(theta), np.sin(theta))
        across = (-along[1], along[0])
        for k in range(2):
            local = np.empty((theta.size, size))
            local[:, :count] = (e * across[k]).reshape(-1, 1) * beam.angles
            local[:, count:] = along[k].reshape(-1, 1) * beam.stretches
            J = np.zeros((theta.size + 1, n)) + slopes[k]
            J[:, at : at + size] += beam.integrals[i] @ local
            bias = 2.0 * rate * turn * across[k] - e * turn * turn * along[k]
            acceleration = biases[k] + beam.integrals[i] @ bias
            weighted = (beam.masses[i].reshape(-1, 1) * J).T.copy()
            M += weighted @ J
            f -= weighted @ (acceleration - beam.gravity[k])
            slopes[k], biases[k] = J[-1], acceleration[-1]
    return M, f


@njit
def advance(q: Array, v: Array, h: float, torques: Array, beam: Beam) -> tuple[Array, Array]:
    """Runge-Kutta steps of length h; torques at every half step."""
    for k in range(torques.size // 2):
        dq, dv, a = np.zeros_like(q), np.zeros_like(v), np.zeros_like(v)
        speed = v
        for stage in range(4):
            inside = (0.0, 0.5, 0.5, 1.0)[stage] * h
            at, speed = q + inside * speed, v + inside * a
            M, f = equations(at, speed, torques[2 * k + (stage + 1) // 2], beam)
            a = np.linalg.solve(M, f)
            share = (1.0, 2.0, 2.0, 1.0)[stage] * h / 6.0
            dq += share * speed
            dv += share * a
        q, v = q + dq, v + dv
    return q, v


def tip(q: Array, beam: Beam) -> Array:
    """(2,) [m]."""
    count = beam.angles.shape[1]
    result = np.zeros(2)
    for part, integral in zip(np.split(q, len(beam.integrals)), beam.integrals, strict=True):
        theta = beam.angles @ part[:count]
        e = 1.0 + beam.stretches @ part[count:]
        result += np.stack([e * np.cos(theta), e * np.sin(theta)]) @ integral[-1]
    return result


def fastest(beam: Beam) -> float:
    """Highest frequency of the straight beam [rad/s]."""
    rest = np.zeros(len(beam.stiffness))
    M, _ = equations(rest, rest, 0.0, beam)
    return math.sqrt(scipy.linalg.eigh(beam.stiffness, M, eigvals_only=True)[-1])


def tips(beam: Beam, motion: JointMotion, interval: float, careful: float = CAREFUL) -> Array:
    """(N, 3) t [s] and tip [m] of a motion from rest with straight links.

    The torque may jump only at multiples of the interval.
    """
    q, v = np.zeros(len(beam.stiffness)), np.zeros(len(beam.stiffness))
    q[:: q.size // len(beam.integrals)] = np.cumsum(motion.joint_angles)
    steps = math.ceil(fastest(beam) * interval / careful)
    inside = np.clip(np.linspace(0.0, 1.0, 2 * steps + 1), 1e-9, 1.0 - 1e-9) * interval
    rows = [(0.0, *tip(q, beam))]
    for k in range(round(motion.t_end / interval)):
        t = k * interval
        torques = np.zeros(inside.size)
        if motion.torque is not None:
            torques[:] = [np.asarray(motion.torque(t + s))[0] for s in inside]
        q, v = advance(q, v, interval / steps, torques, beam)
        rows.append((t + interval, *tip(q, beam)))
    return np.array(rows)
