"""Expression graphs of one arm: those that are compiled and those that answer questions.

Of a free base, coordinates and rates are those in its own frame (free_base.py), and its attitude
(4,) is a third input.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dynamics.algebra import Scalar, add, combine, matvec
from dynamics.elimination import Implicit
from dynamics.free_base import (
    SIZE,
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
from dynamics.free_parameters import FREE_PARAMETERS
from dynamics.kinematics import Chain, outward, poses
from dynamics.modes import curvature, parts

if TYPE_CHECKING:
    from dynamics.model import Model


class Seen(NamedTuple):
    """Symbols of a state, and what the recursion takes of them."""

    inputs: list[Any]  # q, v and, of a free base, attitude
    attitude: Sequence[Scalar]
    chain: Chain
    x: list[Scalar]  # (n,) q, a free base not turned
    rates: list[Scalar]  # (n,)


def _seen(model: "Model") -> Seen:
    import casadi as ca

    inputs = [ca.SX.sym("q", model.n), ca.SX.sym("v", model.n)]
    q, v = (ca.vertsplit(x) for x in inputs)
    inputs += [ca.SX.sym("attitude", 4)] if model.arm.base.n else []
    turn = ca.vertsplit(inputs[2]) if model.arm.base.n else []
    return Seen(inputs, turn, turned(model.chain, turn), unturned(q, turn), v)


def mass_matrix_and_bias(model: "Model") -> Any:
    """CasADi Function (q, v) -> lower triangle of M row by row, then h."""
    import casadi as ca

    s = _seen(model)
    equations = model.formed.equations
    M, h = equations.mass_matrix(s.chain, s.x), equations.bias(s.chain, s.x, s.rates)
    lower = [x for i, row in enumerate(M) for x in row[: i + 1]]
    return ca.Function("M_h", s.inputs, [ca.cse(ca.vertcat(*lower, *h))])


def questions(model: "Model") -> dict[str, Any]:
    """CasADi Functions (q, v) for the questions that nobody asks in a loop."""
    import casadi as ca

    s = _seen(model)
    formed, state = model.formed, (s.chain, s.x, s.rates)
    M = matrix_in_world(formed.equations.mass_matrix(s.chain, s.x), s.attitude)
    moved = [world(p, s.attitude) for p in momentum(*state)]
    values = {
        "mass_matrix": ca.vertcat(*(ca.horzcat(*row) for row in M)),
        "bias": ca.vertcat(*world(formed.equations.bias(*state), s.attitude)),
        "energy": ca.vertcat(*formed.energies(*state)),
        "momentum": ca.vertcat(*moved[0], *moved[1]),
    }
    return {name: ca.Function(name, s.inputs, [value]) for name, value in values.items()}


def measure(model: "Model") -> Any:
    """CasADi Function (q, v) -> what `Model.measurements` names."""
    import casadi as ca

    s = _seen(model)
    frames = outward(model.chain, s.x, s.rates)
    end = poses(frames)[-1]
    kept = {*range(model.arm.base.n), *model.arm.joint_index}
    straight = [x if i in kept else 0.0 for i, x in enumerate(s.x)]
    rigid = poses(outward(model.chain, straight, [0.0] * model.n))[-1].tip
    velocity = model.formed.tip_velocity(model.chain, s.x, s.rates)
    tips = [x for y in (end.tip, velocity, rigid) for x in world(y, s.attitude)]
    deflections, slopes, curvatures = [], [], []
    for link, place in zip(model.arm.links, model.bodies, strict=True):
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


def jacobians(model: "Model") -> Any:
    """CasADi Function (q, v, then tau) -> derivatives of the accelerations by q, v and tau.

    Of a free base q[3:6] is a small rotation: good where it is zero.
    """
    import casadi as ca

    s = _seen(model)
    q, v = s.inputs[:2]
    tau = ca.SX.sym("tau", model.n_joint)
    x, rates = ca.vertsplit(q), list(s.rates)
    if s.attitude:
        rates[:SIZE] = own_rates(x[:SIZE], rates[:SIZE])
    a = model.formed.accelerations(s.chain, x, rates, ca.vertsplit(tau))
    if s.attitude:
        a[:SIZE] = own_accelerations(x[:SIZE], rates[:SIZE], a[:SIZE])
    result = ca.vertcat(*a)
    derivatives = [ca.jacobian(result, y) for y in (q, v, tau)]
    return ca.Function("jacobians", [*s.inputs, tau], derivatives)


def state_jacobian(graph: Any) -> Any:
    """CasADi Function of a graph's inputs -> derivatives by the first two of them, row by row."""
    import casadi as ca

    x = graph.sx_in()
    a = graph(*x)
    rows = [ca.vec(ca.densify(ca.jacobian(a, y)).T) for y in x[:2]]
    return ca.Function("jacobian", x, [ca.cse(ca.vertcat(*rows))])


def accelerations(model: "Model", implicit: bool) -> Any:
    """CasADi Function (q, v, tau, parameters, nothing or `Implicit`) -> accelerations."""
    import casadi as ca

    parameters = len(model.free_parameters) + model.n_gravity
    sizes = {"q": model.n, "v": model.n, "tau": model.n_joint, "p": parameters,
             "implicit": 2 + model.n if implicit else 0}  # fmt: skip
    symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    q, v, tau, _, x = (ca.vertsplit(symbol) for symbol in symbols)
    weights = Implicit(x[0], x[1], x[2:]) if implicit else None
    a = model.formed.accelerations(_with_parameters(model, symbols[3]), q, v, tau, weights)
    return ca.Function("accelerations", symbols, [ca.cse(ca.vertcat(*a))])


def check_rest(model: "Model") -> None:
    """Refuse an arm that cannot even rest, straight and without torque."""
    parameters = [*model.nominal_parameters, *model.n_gravity * [0.0]]
    rest = np.array(model.graph(0.0, 0.0, 0.0, parameters, []))
    if not np.isfinite(rest).all():
        raise ValueError(
            "The arm's accelerations at rest are not finite: its lengths, masses and stiffnesses "
            "are too far apart for double precision."
        )


def _with_parameters(model: "Model", p: Any) -> Chain:
    links = list(model.chain.links)
    for k, name in enumerate(model.free_parameters):
        links = FREE_PARAMETERS[name].apply(links, p[k])
    first, gravity = len(model.free_parameters), model.arm.gravity
    if model.n_gravity:
        gravity = (p[first], p[first + 1], p[first + 2])
    return replace(model.chain, links=tuple(links), gravity=gravity)


def renewal(gravity: Sequence[float]) -> tuple[Any, dict[str, int]]:
    """CasADi Function of what follows every step: a free base's own frame is the next step's.

    (coordinates, rates, attitude), of the base alone -> the same, then gravity in that frame if
    there is any; and how many numbers each is, by the names of their slots.
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
