"""Static equilibrium of an arm whose joints are held: h(q) = B tau at zero rates.

The joint angles are given; modal amplitudes, deflections of joint springs and the torques that hold
the joints are unknown. Newton's method with the exact Jacobian follows the arm from no gravity to
all of it and takes no equilibrium that is unstable, so that it finds the one into which a straight
arm bends, and none of an arm that buckles.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from dynamics.description.arm import Arm
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.linearized import inputs
from dynamics.tracing import graphs
from dynamics.tracing.traced_arm import TracedArm
from dynamics.types import Array

ITERATIONS = 30  # of Newton's method at one share of gravity
CONVERGED = 1e-12  # [-] last change over the size of the unknowns
SLOWEST = 0.25  # [-] a change of the bent coordinates over the one before
SMALLEST_SHARE = 1.0 / 4096.0  # of gravity that is added at once
SETTLING = 8  # steps of `settling`, each of about two digits
SETTLED = 1e-6  # [-] share of the last of them in what it has come to, both squared
FARTHEST = 1e3  # [m] or [rad] that a coordinate may move by them
TINY = 1e-30


class Equilibrium(NamedTuple):
    """Coordinates of an arm at rest, and the torques that hold its joints."""

    q: Array  # (n,) joint angles as given, and bent links
    torque: Array  # (n_joint,) [N m]


def equilibrium(traced: TracedArm, angles: Array) -> Equilibrium:
    """Equilibrium at joint angles (n_joint,) [rad or m] of an arm on a fixed base.

    Raises
    ------
    ValueError : if gravity cannot be applied in steps of SMALLEST_SHARE.
    """
    n, joints = traced.n, list(traced.arm.joint_index)
    bent = bent_coordinates(traced.arm)
    x = np.zeros(len(bent) + traced.n_joint)
    share, step = 0.0, 1.0
    while share < 1.0:
        step = min(step, 1.0 - share)
        found = _newton(traced, angles, share + step, x)
        if found is not None:
            x, share, step = found, share + step, 2.0 * step
        elif step > SMALLEST_SHARE:
            step *= 0.5
        else:
            raise ValueError(
                f"No equilibrium of {traced.arm.name or 'the arm'} was found beyond "
                f"{share:.0%} of its gravity: it buckles or bends too far for its modes; raise "
                "Link.segments, or make the links stiffer."
            )
    q = np.zeros(n)
    q[joints], q[bent] = angles, x[: len(bent)]
    return Equilibrium(q, x[len(bent) :])


def bent_coordinates(arm: Arm) -> list[int]:
    """Coordinates that gravity sets where joints are held: of modes and of joint springs."""
    return [i for i in range(arm.n) if i not in arm.joint_index]


def settling(traced: TracedArm) -> Any:
    """CasADi Function (q, rest, parameters) -> rest nearer to the equilibrium at the joints of q.

    `rest` are the `bent_coordinates` of an arm on a fixed base. It is a step of Newton's method
    with the stiffness as its Jacobian: it divides the error by about the weight that would make
    the arm buckle over its own. A last number is the square of the step over that of `rest`; where
    the arm is too soft to converge, `rest` stays below FARTHEST.
    """
    import casadi as ca

    bent = bent_coordinates(traced.arm)
    symbols = [
        ca.SX.sym("q", traced.n), ca.SX.sym("rest", len(bent)),
        ca.SX.sym("parameters", len(traced.free_parameters)),
    ]  # fmt: skip
    q, rest, parameters = symbols
    placed = ca.vertsplit(q)
    for i, value in zip(bent, ca.vertsplit(rest), strict=True):
        placed[i] = value
    chain = graphs.with_parameters(traced, parameters)
    residual = _without_torques(traced, chain, placed)[bent]
    elastic = _without_torques(traced, replace(chain, gravity=(0.0, 0.0, 0.0)), placed)[bent]
    step = ca.densify(ca.solve(ca.jacobian(elastic, rest), residual))
    nearer = ca.fmax(ca.fmin(rest - step, FARTHEST), -FARTHEST)
    share = ca.sumsqr(step) / (ca.sumsqr(nearer) + TINY)
    return ca.Function("settle", symbols, [ca.cse(ca.vertcat(nearer, share))])


def settled(traced: TracedArm, q: Array) -> Array:
    """Coordinates (N, n) of straight links bent as gravity bends them in SETTLING steps.

    Links that are too soft to settle stay straight.
    """
    bent, count = bent_coordinates(traced.arm), len(q)
    parameters = np.tile(traced.nominal_parameters[:, None], count)
    step, found = settling(traced).map(count), np.zeros((len(bent) + 1, count))
    for _ in range(SETTLING):
        found = np.array(step(q.T, found[:-1], parameters))
    result = q.copy()
    result[:, bent] += np.where(found[-1] < SETTLED, found[:-1], 0.0).T
    return result


def _without_torques(traced: TracedArm, chain: Chain, q: list[Any]) -> Any:
    """(n,) forces h - B tau at rest, with the torques that leave none at the joints."""
    import casadi as ca

    h: Any = ca.vertcat(*traced.formed.equations.bias(chain, q, traced.n * [0.0]))
    return h - ca.mtimes(ca.DM(inputs(traced.chain)), h[list(traced.arm.joint_index)])


def _newton(traced: TracedArm, angles: Array, share: float, x: Array) -> Array | None:
    """Stable solution at a share of gravity from a guess; None if it is not reached."""
    forces, x, before = _forces(traced), x.copy(), np.inf
    for _ in range(ITERATIONS):
        residual, jacobian, stiffness = (np.array(y) for y in forces(x, angles, share))
        if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
            return None
        try:
            change = np.linalg.solve(jacobian, residual.ravel())
            size = float(np.linalg.norm(change[: x.size - traced.n_joint]))
        except (ArithmeticError, np.linalg.LinAlgError):  # far from any equilibrium
            return None
        x -= change
        if np.all(np.abs(change) <= CONVERGED * (np.abs(x).max() + 1e-300)):
            return x if np.all(np.linalg.eigvalsh(stiffness) > 0.0) else None
        if size > SLOWEST * before:  # it may leave for another equilibrium
            return None
        before = size
    return None


@lru_cache(maxsize=8)
def _forces(traced: TracedArm) -> Any:
    """CasADi Function (unknowns, angles, share of gravity) -> h - B tau, and its Jacobian.

    A third result is the stiffness of the arm whose joints are held, of elasticity and gravity.
    """
    import casadi as ca
    from scipy.linalg import null_space

    joints, m = list(traced.arm.joint_index), traced.n_joint
    bent = bent_coordinates(traced.arm)
    x, angles, share = ca.SX.sym("x", len(bent) + m), ca.SX.sym("angles", m), ca.SX.sym("share")
    q: list[Any] = traced.n * [None]
    bend, torques = ca.vertsplit(x, [0, len(bent), x.numel()])
    for places, values in ((bent, bend), (joints, angles)):
        for place, value in zip(places, ca.vertsplit(values), strict=True):
            q[place] = value
    gravity: Any = tuple(share * g if g else 0.0 for g in traced.arm.gravity)
    h = traced.formed.equations.bias(replace(traced.chain, gravity=gravity), q, traced.n * [0.0])
    B = inputs(traced.chain)
    residual, still = ca.vertcat(*h) - ca.mtimes(ca.DM(B), torques), ca.DM(null_space(B.T))
    stiffness = ca.mtimes([still.T, ca.jacobian(ca.vertcat(*h), ca.vertcat(*q)), still])
    results = [residual, ca.jacobian(residual, x), stiffness]
    return ca.Function("statics", [x, angles, share], results)
