"""Actions and actuators inside the compiled control step.

Actuator and arm advance in turn, once a substep. First the arm moves under the actuator's mean
torque over the substep, at the present angle and rate of the joint; then the actuator's states
follow. The linear part is exact for a constant action and a rate that changes linearly, so an
electrical pole may be far faster than the substep. The coupling is of order 2, or of the
integrator's order if the actuator has no states.
"""

import math
import operator
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from dynamics import Arm
from dynamics.description import validate
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.integrators.table import INTEGRATORS
from dynamics.model import Model
from dynamics.tracing.function import Function, traced
from dynamics.tracing.statements import Call
from dynamics.types import Array, Symbols
from flexarm_env.hardware.actuators import Actuator, Law
from flexarm_env.task.scales import SAFE, scales

UNLIMITED = 1e30  # [N m]
REFUSED = "rosenbrock"  # its Jacobian would need the slopes of actuators and pushes
EXPLICIT_PART = 1.0  # largest omega h of actuators if the integrator itself has no stability limit

# with actuators in place of ideal torque sources: before the accelerations, and a substep
DRIVE = (Call("drive"),)
SUBSTEP = (Call("mark"), Call("start"), Call("step"), Call("follow"))


def command(n_torque: int, at: Mapping[str, int], torque_limit: int) -> Function:
    """`command(w)`: clip the given actions, set the torques, count the step.

    `torque_limit` is the first slot of the limits.
    """
    import casadi as ca

    given, before, limit = (ca.SX.sym(x, n_torque) for x in ("given", "before", "torque_limit"))
    elapsed = ca.SX.sym("elapsed")
    action = ca.fmin(ca.fmax(given, -1.0), 1.0)
    outputs = {
        "BEFORE": before, "ACTION": action, "TAU": action * limit,
        "ELAPSED": elapsed + 1.0, "LOST": ca.SX(0.0),
    }  # fmt: skip
    graph = ca.Function("command", [given, before, limit, elapsed], [ca.vertcat(*outputs.values())])
    inputs = [at["GIVEN"], at["ACTION"], torque_limit, at["ELAPSED"]]
    slots = [at[name] + k for name, x in outputs.items() for k in range(x.numel())]
    return traced("command", graph, inputs, slots)


def refuse_slopes(integrator: str | None, givers: str) -> None:
    """Refuse a method that needs slopes of forces beside what does not give them."""
    if integrator == REFUSED:
        raise ValueError(
            f"integrator {integrator!r} needs the slopes of the forces, which {givers} not give; "
            'leave it out or take "rk4".'
        )


class Actuation:
    """The actuators of an arm.

    Parameters
    ----------
    actuators : one per joint.
    arm : the arm, including the inertia and friction of its motors.
    usual : (n_joint,) [N m] torque limits of the arm with ideal torque sources.

    Attributes
    ----------
    states : number of actuator states.
    torque_limit : (n_joint,) [N m] torque at action 1 and rest; where it grows with time, `usual`.
    command : (n_joint,) command at action 1, in the unit of the actuator.
    slip : (n_joint, n) actuator angles (a link's root against its hub) from coordinates.
    """

    def __init__(self, actuators: tuple[Actuator, ...], arm: Arm, usual: tuple[float, ...]) -> None:
        self.arm = arm
        self.laws = [a.law(most) for a, most in zip(actuators, usual, strict=True)]
        self._sizes = [len(law.B) + _slews(law) for law in self.laws]
        self.states = sum(self._sizes)
        stalls = [law.stall for law in self.laws]
        self.torque_limit = np.array(
            [most if x is None else x for x, most in zip(stalls, usual, strict=True)]
        )
        self.command = np.array([law.command for law in self.laws])
        self.slip = Model(arm).encoders

    @property
    def key(self) -> str:
        """Cache key: the properties on which the compiled functions depend."""
        return f"{[(len(law.B), _slews(law)) for law in self.laws]}"

    # ---- numbers -----------------------------------------------------------------------------

    @cached_property
    def n_constant(self) -> int:
        """Number of `constants`."""
        return self.constants(1.0).size

    def constants(self, h: float) -> Array:
        """Constants that the compiled functions read, for a substep of h [s]."""
        values = [list(_discrete(law, h).values()) for law in self.laws]
        return np.concatenate([np.ravel(x) for joint in values for x in joint])

    def at_rest(self, q: Array) -> Array:
        """(states, N) states at zero torque, for coordinates q (N, n)."""
        rest = [(*law.rest, *[0.0] * _slews(law)) for law in self.laws]
        angles = q @ self.slip.T
        return np.concatenate([np.outer(x, angles[:, j]) for j, x in enumerate(rest)])

    def substeps(self, control_dt: float, integrator: str) -> int:
        """Substeps per control step that keep the arm behind its actuators stable.

        By Weyl's inequality the squared frequencies grow by at most the largest squared frequency
        of the joints on the actuators' springs alone. Every method treats actuator forces
        explicitly.
        """
        refuse_slopes(integrator, "actuators do")
        limit = INTEGRATORS[integrator].limit
        frequency, decay = self._fastest
        if math.isfinite(limit):
            frequency = math.hypot(frequency, scales(self.arm).fastest)
        else:
            limit = EXPLICIT_PART
        return math.ceil(control_dt * (frequency + decay) / (SAFE * limit) - 1e-9)

    @cached_property
    def _fastest(self) -> tuple[float, float]:
        """Highest frequency [rad/s] and decay rate [1/s] of the joints on the actuators alone."""
        q = np.zeros(self.arm.n)
        q[list(self.arm.joint_index)] = scales(self.arm).home
        M = np.array(mass_matrix(Model(self.arm).chain, q.tolist()), dtype=np.float64)
        mobility = self.slip @ np.linalg.solve(M, self.slip.T)

        def largest(values: list[float]) -> float:
            root = np.sqrt(values)
            return float(np.linalg.eigvalsh(root[:, None] * mobility * root)[-1])

        springs = [law.stiffness for law in self.laws]
        return math.sqrt(largest(springs)), largest([_steady_damping(law) for law in self.laws])

    # ---- graphs ------------------------------------------------------------------------------

    def torque(self, s: Symbols) -> Any:
        """(n_joint,) [N m] present joint torques, as symbols.

        `s` holds "action", "actuator" (states), "actuators" (constants), "q" and "v".
        """
        return self._each(s, _present_torque)

    def rest(self, q: Any) -> Any:
        """(states,) states at zero torque, linear in the coordinates q (n,), as symbols."""
        import casadi as ca

        linear = self.at_rest(np.eye(q.numel()))
        return ca.mtimes(ca.DM(linear), q) if len(linear) else ca.SX(0, 1)

    def functions(self, at: Mapping[str, int], constants: int) -> list[Function]:
        """Functions `mark(w)`, `drive(w)`, `follow(w)`; their constants start at slot `constants`.

        They store the actuators' rates, the mean torques of a substep, and the next states.
        """
        import casadi as ca

        n, m = self.slip.shape[1], len(self.laws)
        sizes = {"action": m, "actuator": self.states, "q": n, "v": n, "before": m,
                 "actuators": self.n_constant}  # fmt: skip
        s = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        slots = [at[name] for name in ("ACTION", "ACTUATOR", "Q", "V", "RATE_BEFORE")]
        outputs = {
            "mark": (ca.mtimes(ca.DM(self.slip), s["v"]), at["RATE_BEFORE"]),
            "drive": (self._each(s, _mean_torque), at["TAU"]),
            "follow": (self._each(s, _next_states), at["ACTUATOR"]),
        }
        if not self.states:
            outputs["follow"] = (ca.SX(0, 1), at["ACTUATOR"])
        return [
            traced(
                name,
                ca.Function(name, list(s.values()), [ca.cse(value)]),
                [*slots, constants],
                slot,
            )
            if value.numel()
            else Function(name)
            for name, (value, slot) in outputs.items()
        ]

    def _each(self, s: Symbols, function: Any) -> Any:
        """Stack `function(constants, joint)` of all joints; `s` may lack "before"."""
        import casadi as ca

        angles, rates = (ca.mtimes(ca.DM(self.slip), s[name]) for name in "qv")
        result, first, at = [], 0, 0
        for j, (law, size) in enumerate(zip(self.laws, self._sizes, strict=True)):
            p: dict[str, Any] = {}
            for name, value in _discrete(law, 1.0).items():
                places = at + np.arange(np.size(value)).reshape(np.shape(value))
                p[name] = _entries(s["actuators"], places.tolist())
                at += places.size
            joint = _Joint(
                x=_entries(s["actuator"], list(range(first, first + size))),
                u=s["action"][j],
                angle=angles[j],
                rate=rates[j],
                before=s["before"][j] if "before" in s else None,
            )
            first += size
            found = function(p, joint)
            result += found if isinstance(found, list) else [found]
        return ca.vertcat(*result)


class _Joint(NamedTuple):
    """Inputs of a joint's actuator: numbers or symbols."""

    x: list[Any]  # states; the last is the torque [N m] if its rate of change is limited
    u: Any  # [-] action
    angle: Any  # [rad]
    rate: Any  # [rad/s]
    before: Any  # [rad/s] rate at the start of the substep


def _slews(law: Law) -> bool:
    """True if the rate of change is limited; then the torque is the last state."""
    return math.isfinite(law.rate_limit)


def _steady_damping(law: Law) -> float:
    """Damping [N m s/rad] at a steady rate."""
    if not any(law.E):
        return law.damping
    return law.damping + float(np.dot(law.C, np.linalg.solve(law.A, law.E)))


def _discrete(law: Law, h: float) -> dict[str, Any]:
    """Constants of a law over a substep of h [s], by name.

    With the rate w changing linearly from w0 to w1,
    x1 = step x + step_u u + step_w0 w0 + step_w1 w1, and the mean of C x over the substep is
    mean x + mean_u u + mean_w0 w0 + mean_w w for the mean rate w = (w0 + w1) / 2.
    """
    from scipy.linalg import expm

    k = len(law.B)
    A, C = np.reshape(law.A, (k, k)), np.reshape(law.C, k)
    flow = np.zeros((2 * k + 3, 2 * k + 3))  # rates of x, u, w, h dw/dt and the integral of x
    flow[:k, :k], flow[k + 3 :, :k] = A, np.eye(k)
    flow[:k, k], flow[:k, k + 1], flow[k + 1, k + 2] = law.B, law.E, 1.0 / h
    with validate.double_precision("The actuator's motion within a substep"):
        end = expm(h * flow)
        step, mean = end[:k], C @ end[k + 3 :] / h
    values: dict[str, Any] = {
        "step": step[:, :k], "step_u": step[:, k], "step_w0": step[:, k + 1] - step[:, k + 2],
        "step_w1": step[:, k + 2],
        "mean": mean[:k], "mean_u": mean[k], "mean_w0": mean[k + 1] - 2.0 * mean[k + 2],
        "mean_w": 2.0 * mean[k + 2],
        "C": C, "D": law.D, "damping": law.damping, "stiffness": law.stiffness,
        "limit": min(law.torque_limit, UNLIMITED),
    }  # fmt: skip
    if _slews(law):
        values["slew"] = law.rate_limit * h
    return values


def _entries(vector: Any, places: Any) -> Any:
    """Entries of a vector in the shape of `places`: nested lists of numbers."""
    if isinstance(places, list):
        return [_entries(vector, k) for k in places]
    return vector[places]


# Formulas of one joint, with constants `p` from `_discrete`


def _dot(a: list[Any], x: list[Any]) -> Any:
    return sum(map(operator.mul, a, x))  # over the linear states, not a rate-limited torque


def _clip(value: Any, limit: Any) -> Any:
    import casadi as ca

    return ca.fmin(ca.fmax(value, -limit), limit)


def _clipped_torque(p: Symbols, joint: _Joint, inner: Any) -> Any:
    """Torque for C x = inner, within the torque limit, before the rate limit."""
    reaction = p["damping"] * joint.rate + p["stiffness"] * joint.angle
    return _clip(inner + p["D"] * joint.u - reaction, p["limit"])


def _present_torque(p: Symbols, joint: _Joint) -> Any:
    """Torque now."""
    return joint.x[-1] if "slew" in p else _clipped_torque(p, joint, _dot(p["C"], joint.x))


def _mean_torque(p: Symbols, joint: _Joint) -> Any:
    """Mean torque over a substep."""
    import casadi as ca

    by_rate = p["mean_w0"] * joint.before + p["mean_w"] * joint.rate
    value = _clipped_torque(p, joint, _dot(p["mean"], joint.x) + p["mean_u"] * joint.u + by_rate)
    if "slew" not in p:
        return value
    gap = _clip(value - joint.x[-1], p["slew"])  # a ramp by this much, then constant
    return joint.x[-1] + gap - gap * ca.fabs(gap) / (2.0 * p["slew"])


def _next_states(p: Symbols, joint: _Joint) -> list[Any]:
    """States at the end of a substep."""
    new = [
        _dot(row, joint.x) + by_u * joint.u + w0 * joint.before + w1 * joint.rate
        for row, by_u, w0, w1 in zip(
            p["step"], p["step_u"], p["step_w0"], p["step_w1"], strict=True
        )
    ]
    if "slew" not in p:
        return new
    last = joint.x[-1]
    return [*new, last + _clip(_clipped_torque(p, joint, _dot(p["C"], new)) - last, p["slew"])]
