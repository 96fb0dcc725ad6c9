"""Expression graphs of an arm, for compiled stepping and for the functions of `Model`.

Coordinates and rates of a free base are in its own frame (free_base.py). Its attitude (4,), a
quaternion, is a third input, except of `accelerations` and `state_jacobian`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from dynamics.description.deflection import curvature
from dynamics.description.validate import shown
from dynamics.formulations.algebra import Scalar, add, combine, matmul, matvec, transpose
from dynamics.formulations.articulated_body import Implicit
from dynamics.formulations.free_base import (
    SIZE,
    carried,
    local,
    matrix_in_world,
    momentum,
    own_accelerations,
    own_rates,
    renewed,
    turned,
    unturned,
    world,
)
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.formulations.kinematics import Chain, outward, poses
from dynamics.formulations.linearized import inertia
from dynamics.formulations.link_constants import parts
from dynamics.formulations.table import Recursion
from dynamics.tracing.traced_arm import TracedArm

SINGULAR = 1e-9  # [-] eigenvalue of a mass matrix with a diagonal of ones, that counts as zero


class _State(NamedTuple):
    """Symbols of a state, and the recursion's arguments made of them."""

    inputs: list[Any]  # q, v and the attitude of a free base
    attitude: Sequence[Scalar]  # (4,), empty for a base that does not turn in space
    chain: Chain  # with gravity in the frame of a free base
    x: list[Scalar]  # (n,) q, with zero rotation of a free base
    rates: list[Scalar]  # (n,)


def _state(traced: TracedArm) -> _State:
    import casadi as ca

    inputs = [ca.SX.sym("q", traced.n), ca.SX.sym("v", traced.n)]
    q, v = (ca.vertsplit(x) for x in inputs)
    spatial = traced.arm.base.spatial
    inputs += [ca.SX.sym("attitude", 4)] if spatial else []
    attitude = ca.vertsplit(inputs[2]) if spatial else []
    return _State(inputs, attitude, turned(traced.chain, attitude), unturned(q, attitude), v)


def mass_matrix_and_bias(traced: TracedArm) -> Any:
    """CasADi Function (q, v) -> lower triangle of M row by row, then h."""
    import casadi as ca

    s = _state(traced)
    equations = traced.formed.equations
    M, h = equations.mass_matrix(s.chain, s.x), equations.bias(s.chain, s.x, s.rates)
    lower = [x for i, row in enumerate(M) for x in row[: i + 1]]
    return ca.Function("M_h", s.inputs, [ca.cse(ca.vertcat(*lower, *h))])


def state_functions(traced: TracedArm) -> dict[str, Any]:
    """CasADi Functions (q, v) -> mass matrix, bias, energy and momentum; evaluated uncompiled."""
    import casadi as ca

    s = _state(traced)
    formulation, state = traced.formed, (s.chain, s.x, s.rates)
    M = matrix_in_world(formulation.equations.mass_matrix(s.chain, s.x), s.attitude)
    linear, angular = (world(p, s.attitude) for p in momentum(*state))
    values = {
        "mass_matrix": ca.vertcat(*(ca.horzcat(*row) for row in M)),
        "bias": ca.vertcat(*world(formulation.equations.bias(*state), s.attitude)),
        "energy": ca.vertcat(*formulation.energies(*state)),
        "momentum": ca.vertcat(*linear, *angular),
    }
    return {name: ca.Function(name, s.inputs, [value]) for name, value in values.items()}


def generalized_forces(traced: TracedArm) -> Any:
    """CasADi Function (q, v, a) -> M a + h of an arm whose base does not turn in space."""
    import casadi as ca

    s, a = _state(traced), ca.SX.sym("a", traced.n)
    forces = traced.formed.inverse_dynamics(s.chain, s.x, s.rates, ca.vertsplit(a))
    return ca.Function("M_a_h", [*s.inputs, a], [ca.cse(ca.vertcat(*forces))])


@lru_cache(maxsize=8)
def measure(traced: TracedArm) -> Any:
    """CasADi Function (q, v) -> measurements in the columns of `TracedArm.measurements`."""
    import casadi as ca

    s = _state(traced)
    frames = outward(traced.chain, s.x, s.rates)
    end = poses(frames)[-1]
    not_modal = {*range(traced.arm.base.n), *traced.arm.joint_index}
    straight = [x if i in not_modal else 0.0 for i, x in enumerate(s.x)]
    rigid = poses(outward(traced.chain, straight, [0.0] * traced.n))[-1].tip
    velocity = traced.formed.tip_velocity(traced.chain, s.x, s.rates)
    tips = [x for y in (end.tip, velocity, rigid) for x in world(y, s.attitude)]
    deflections, slopes, curvatures = [], [], []
    for link, place in zip(traced.arm.links, traced.bodies, strict=True):
        bodies = frames[place]
        tip = bodies[-1].r
        for outer, inner in zip(bodies[:0:-1], bodies[-2::-1], strict=True):
            tip = add(inner.r, matvec(outer.R, tip))
        theta = add(*(combine(f.delta, f.link.tip_theta) for f in bodies))
        bend = combine(bodies[0].delta, curvature(parts(link)[0], 0.0).tolist())
        shift = ca.vertcat(tip[0] - link.length, *tip[1:])
        deflections.append(ca.norm_2(shift) / (link.length or 1.0))
        slopes.append(ca.norm_2(ca.vertcat(*theta)))
        curvatures += [bend[2], bend[1]]
    values = [*tips, *deflections, *slopes, *curvatures]
    return ca.Function("measure", s.inputs, [ca.cse(ca.vertcat(*values))])


def tip_axes(traced: TracedArm) -> Any:
    """CasADi Function (q, v) -> (3, 3) axes of the last link at its bent tip, as columns."""
    import casadi as ca

    s = _state(traced)
    frames = outward(traced.chain, s.x, s.rates)
    axes = transpose(matmul(poses(frames)[-1].R, frames[-1].E))
    columns = [ca.vertcat(*world(axis, s.attitude)) for axis in axes]
    return ca.Function("tip_axes", s.inputs, [ca.SX(ca.horzcat(*columns))])


def planar_momentum(traced: TracedArm, q: Any, v: Any, parameters: Any) -> Any:
    """(3,) momentum [N s] along x and y, and about the world's origin along z [N m s]."""
    import casadi as ca

    chain = with_parameters(traced, parameters)
    linear, angular = momentum(chain, ca.vertsplit(q), ca.vertsplit(v))
    return ca.vertcat(linear[0], linear[1], angular[2])


def carried_base(traced: TracedArm) -> Any:
    """CasADi Function (q, target, parameters) -> pose of a planar base, see `carried`."""
    import casadi as ca

    sizes = {"q": traced.n, "target": traced.n_joint, "p": len(traced.free_parameters)}
    symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    q, target = (ca.vertsplit(x) for x in symbols[:2])
    pose = carried(with_parameters(traced, symbols[2]), traced.arm.joint_index, q, target)
    return ca.Function("place", symbols, [ca.cse(ca.vertcat(*pose))])


def jacobians(traced: TracedArm) -> Any:
    """CasADi Function (q, v, attitude, tau) -> derivatives of the accelerations by q, v and tau.

    Only a free base has the input `attitude`. Its q[3:6] is a small rotation; the derivatives hold
    where that is zero.
    """
    import casadi as ca

    s = _state(traced)
    q, v = s.inputs[:2]
    tau = ca.SX.sym("tau", traced.n_torque)
    x, rates = ca.vertsplit(q), list(s.rates)
    if s.attitude:
        rates[:SIZE] = own_rates(x[:SIZE], rates[:SIZE])
    torques = traced.along_chain(ca.vertsplit(tau))
    a = traced.formed.accelerations(s.chain, x, rates, torques)
    if s.attitude:
        a[:SIZE] = own_accelerations(x[:SIZE], rates[:SIZE], a[:SIZE])
    result = ca.vertcat(*a)
    derivatives = [ca.jacobian(result, y) for y in (q, v, tau)]
    return ca.Function("jacobians", [*s.inputs, tau], derivatives)


@lru_cache(maxsize=8)
def state_jacobian(traced: TracedArm) -> Any:
    """CasADi Function (q, v, tau, parameters, empty) -> da/dq, then da/dv, row by row."""
    import casadi as ca

    graph = accelerations(traced)
    x = graph.sx_in()
    a = graph(*x)
    rows = [ca.vec(ca.densify(ca.jacobian(a, y)).T) for y in x[:2]]
    return ca.Function("jacobian", x, [ca.cse(ca.vertcat(*rows))])


@lru_cache(maxsize=8)
def accelerations(traced: TracedArm, implicit: bool = False) -> Any:
    """CasADi Function (q, v, tau, parameters, empty or `Implicit`) -> accelerations.

    A free base has its position and rotation vector in a frame that does not move, so that its
    rates are derivatives. Gravity in that frame comes last in the parameters: see free_base.py.
    """
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            return _accelerations(traced, implicit)
    except ArithmeticError:
        raise _not_finite(traced) from None


def _accelerations(traced: TracedArm, implicit: bool) -> Any:
    import casadi as ca

    s = _Motion.of(traced, implicit)
    a = traced.formed.accelerations(s.chain, s.q, s.v, s.tau, s.implicit)
    return ca.Function("accelerations", s.inputs, [ca.cse(ca.vertcat(*a))])


def imbalance(traced: TracedArm, implicit: bool) -> Any:
    """CasADi Function (inputs of `accelerations`, a) -> (n,) B tau - h + W guess - (M + W) a."""
    import casadi as ca

    s, a = _Motion.of(traced, implicit), ca.SX.sym("a", traced.n)
    recursion = _recursion(traced)
    off = recursion.imbalance(s.chain, s.q, s.v, s.tau, ca.vertsplit(a), s.implicit)
    return ca.Function("imbalance", [*s.inputs, a], [ca.cse(ca.vertcat(*off))])


def response(traced: TracedArm, implicit: bool) -> Any:
    """CasADi Function (inputs of `accelerations`, forces) -> (n,) accelerations by these alone."""
    import casadi as ca

    s, forces = _Motion.of(traced, implicit), ca.SX.sym("forces", traced.n)
    x = _recursion(traced).response(s.chain, s.q, ca.vertsplit(forces), s.implicit)
    return ca.Function("response", [*s.inputs, forces], [ca.cse(ca.vertcat(*x))])


def pushed(traced: TracedArm, implicit: bool) -> Any:
    """CasADi Function (inputs of `accelerations`, force) -> (n,) accelerations by the force alone.

    The force (3,) [N] acts at the tip, along the axes of the last link at its bent tip.
    """
    import casadi as ca

    s, force = _Motion.of(traced, implicit), ca.SX.sym("force", 3)
    q, v = s.inputs[:2]
    J = ca.jacobian(ca.vertcat(*traced.formed.tip_velocity(s.chain, s.q, s.v)), v)
    forces = ca.mtimes(J.T, ca.mtimes(tip_axes(traced)(q, v), force))
    x = _recursion(traced).response(s.chain, s.q, ca.vertsplit(forces), s.implicit)
    return ca.Function("pushed", [*s.inputs, force], [ca.cse(ca.vertcat(*x))])


def _recursion(traced: TracedArm) -> Recursion:
    recursion = traced.formed.recursion
    if recursion is None:
        raise TypeError(f"Formulation {traced.formulation!r} has no recursion.")
    return recursion


class _Motion(NamedTuple):
    """Symbols of the inputs of `accelerations`, and the recursion's arguments made of them."""

    inputs: list[Any]
    chain: Chain
    q: list[Scalar]  # (n,)
    v: list[Scalar]  # (n,)
    tau: list[Scalar]  # (n_torque,) along the chain
    implicit: Implicit | None

    @classmethod
    def of(cls, traced: TracedArm, implicit: bool) -> "_Motion":
        import casadi as ca

        n, parameters = traced.n, len(traced.free_parameters) + traced.n_gravity
        sizes = {"q": n, "v": n, "tau": traced.n_torque, "p": parameters,
                 "implicit": 3 * n if implicit else 0}  # fmt: skip
        inputs = [ca.SX.sym(name, size) for name, size in sizes.items()]
        q, v, tau, _, x = (ca.vertsplit(symbol) for symbol in inputs)
        weights = Implicit(x[:n], x[n : 2 * n], x[2 * n :]) if implicit else None
        chain = with_parameters(traced, inputs[3])
        return cls(inputs, chain, q, v, traced.along_chain(tau), weights)


def check_rest(traced: TracedArm) -> None:
    """Refuse an arm whose accelerations at rest, straight and without torque, are not finite."""
    parameters = [*traced.nominal_parameters, *traced.n_gravity * [0.0]]
    rest = np.array(accelerations(traced)(0.0, 0.0, 0.0, parameters, []))
    if not np.isfinite(rest).all():
        raise _not_finite(traced)


def _not_finite(traced: TracedArm) -> ValueError:
    """Refusal of an arm without finite accelerations, with coordinates that move no mass."""
    M = inertia(traced.chain, np.zeros(traced.n))
    size = np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
    values, motions = np.linalg.eigh(M / np.outer(size, size))
    share = np.abs(motions[:, values < SINGULAR]).max(axis=1, initial=0.0)
    idle = [name for name, x in zip(traced.arm.names, share, strict=True) if x > SINGULAR]
    apart = "lengths, masses and stiffnesses are too far apart for double precision."
    if not idle:
        return ValueError(f"The arm's accelerations at rest are not finite: its {apart}")
    return ValueError(
        f"The arm's mass matrix is singular at rest: {shown(idle)} can move without moving mass. "
        "Give the links between these joints mass off the axes or inertia (Link.body, "
        f"Joint.hub_inertia), or the joints a Joint.rotor_inertia. If they have these, {apart}"
    )


def with_parameters(traced: TracedArm, p: Any) -> Chain:
    """The chain with the values p of its free parameters, and of gravity where that turns."""
    chain = traced.chain
    for k, name in enumerate(traced.free_parameters):
        chain = FREE_PARAMETERS[name].apply(chain, p[k])
    first, gravity = len(traced.free_parameters), traced.arm.gravity
    if traced.n_gravity:
        gravity = (p[first], p[first + 1], p[first + 2])
    return replace(chain, gravity=gravity)


def renewal(gravity: Sequence[float]) -> tuple[Any, dict[str, int]]:
    """CasADi Function that moves a free base's state into its new own frame after every step.

    Inputs are the coordinates (6,), rates (6,) and attitude (4,) of the base. Outputs are the same
    in the new frame, followed by any gravity in it. Also returns the sizes of the outputs by the
    names of their slots.
    """
    import casadi as ca

    sizes = {"Q": SIZE, "V": SIZE, "ATTITUDE": 4}
    inputs = [ca.SX.sym(name, size) for name, size in sizes.items()]
    values = list(renewed(*(ca.vertsplit(x) for x in inputs)))
    if any(gravity):
        sizes["GRAVITY"] = 3
        values.append(local(gravity, values[-1]))
    every = ca.vertcat(*(x for part in values for x in part))
    return ca.Function("renew", inputs, [ca.cse(every)]), sizes
