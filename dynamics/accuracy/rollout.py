"""Tip motions of an arm by any integrator, without compilation.

The step functions of the integrators run on a workspace of symbols, which gives the expression
graph of one step. CasADi evaluates that graph step after step. Preparing a model takes a fraction
of a second, so many models can be compared.
"""

import warnings
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from dynamics.accuracy.scene import JointMotion
from dynamics.description.arm import Arm
from dynamics.formulations.articulated_body import Implicit, accelerations
from dynamics.formulations.kinematics import outward, poses
from dynamics.formulations.linearized import aid
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.model import Model
from dynamics.simulation import step_limits
from dynamics.tracing import graphs
from dynamics.tracing.operation_counts import operations
from dynamics.types import Array

SAMPLES = 256  # least number of tip positions at which motions are compared
STRIDES = (8, 4, 2, 1)  # distances between compared samples; large steps take a large stride
EXPLICIT_WORK = 1e8  # [operations] (under a second) above which an implicit method starts
EARLY = 3  # samples: a tip that leaves the reach within them does so because of the step
MOST_WORK = 5e9  # [operations] after which a motion is given up


class NotConverged(RuntimeError):
    """A motion diverges, or still depends on the step at the smallest affordable step."""


@dataclass(frozen=True)
class TracedMethod:
    """CasADi functions of one integrator on one arm.

    A state is the part of the workspace that outlives a step: q and v come first.
    """

    start: Any  # (state, torque, step) -> state
    step: Any
    evaluations: float  # operations of a step over operations of one evaluation
    operations: int  # per evaluation of the accelerations


@dataclass(frozen=True)
class Run:
    """Tip motion by one fixed step."""

    tips: Array  # (N, 3) [m] at every `stride`-th sample
    stride: int
    dt: float  # [s] largest step taken


class Rollout:
    """Tip motions of one arm."""

    def __init__(self, arm: Arm) -> None:
        self.arm, self.model = arm, Model(arm)
        self._methods: dict[str, TracedMethod] = {}

    @cached_property
    def operations(self) -> int:
        """Operations per explicit evaluation of the accelerations."""
        return self.method("rk4").operations

    def fastest(self, motion: JointMotion) -> float:
        """[rad/s] bound on the eigenvalues of the arm at rest at the start of a motion."""
        q = np.zeros(self.model.n)
        q[list(self.arm.joint_index)] = motion.joint_angles
        return step_limits.fastest(self.model, q)

    def method(self, integrator: str) -> TracedMethod:
        """CasADi functions of one integrator."""
        if integrator not in self._methods:
            self._methods[integrator] = _trace(self.model, integrator)
        return self._methods[integrator]

    def tips(self, motion: JointMotion, integrator: str, dt: float, stride: int = 1) -> Array:
        """(N, 3) [m] tip at every `stride`-th sample, by equal steps of at most `dt`.

        Each step takes the torque at its midpoint, as `simulate` does. After a motion diverges,
        its tip is NaN.
        """
        method = self.method(integrator)
        pieces = _pieces(motion, stride)
        steps = max(1, int(np.ceil(max(width for _, width in pieces) / dt - 1e-9)))
        roll = method.step.mapaccum("roll", steps)
        n, joints = self.model.n, list(self.arm.joint_index)
        x = np.zeros(method.start.size1_in(0))
        x[joints], x[[n + j for j in joints]] = motion.joint_angles, motion.joint_rates
        states, jumps = [x], motion.knots[:-1]
        for begin, width in pieces:
            h = width / steps
            tau = self._torque(motion, [begin + h * (k + 0.5) for k in range(steps)])
            if begin in jumps:
                x = method.start(x, tau[:, 0], h)
            x = np.array(roll(x, tau, np.full((1, steps), h))[:, -1]).ravel()
            states.append(x)
            if not np.all(np.isfinite(x)):
                break
        tips = np.full((len(pieces) + 1, 3), np.nan)
        tips[: len(states)] = np.array(self._tip.map(len(states))(np.array(states)[:, :n].T)).T
        return tips

    def run(self, motion: JointMotion, integrator: str, dt: float) -> Run:
        """Tip by steps of about `dt`, which may be longer than the time between samples."""
        for stride in reversed(STRIDES):
            width = max(width for _, width in _pieces(motion, stride))
            if width >= 4.0 * dt:
                break
        steps = max(1, round(width / dt))
        return Run(self.tips(motion, integrator, width / steps, stride), stride, width / steps)

    def converged(self, motion: JointMotion, accuracy: float) -> Array:
        """(N, 3) [m] tip at all samples, with an integration error of at most `accuracy`.

        Steps are halved until two results agree; these are extrapolated to zero step.

        Raises
        ------
        NotConverged : if the motion diverges or needs too small a step.
        """
        fastest, method = self.fastest(motion), "rk4"
        dt = min(2.0 / fastest if fastest else np.inf, motion.t_end / (2 * SAMPLES))
        work = 4.0 * self.operations * motion.t_end
        if work / dt > EXPLICIT_WORK:
            method, dt = "midpoint", motion.t_end / (8 * SAMPLES)
            work /= 4.0
        gain = 2.0 ** INTEGRATORS[method].order - 1.0
        coarse = self.tips(motion, method, dt)
        while True:
            dt /= 2.0
            fine = self.tips(motion, method, dt)
            exits = [self._exit(t) for t in (coarse, fine)]
            # an exit that the step causes comes much later with half the step
            alike = min(exits) > EARLY and max(exits) <= 1.1 * min(exits)
            if max(exits) < len(fine) and (alike or work / dt > MOST_WORK):
                raise NotConverged(
                    f"The motion leaves the reach ({self.arm.reach:.6g} m): diverged."
                )
            if distance(fine, coarse) <= accuracy:
                return fine + (fine - coarse) / gain
            if work / dt > MOST_WORK:
                break
            coarse = fine
        raise NotConverged(
            f"Steps of {dt:.3g} s still move the tip by {distance(fine, coarse):.3g} m, more than "
            f"{accuracy:.3g} m; the motion is too long, too stiff or chaotic."
        )

    def _exit(self, tips: Array) -> int:
        """Index of the first sample beyond twice the reach or NaN, else the number of samples."""
        far = ~(np.abs(tips).max(axis=1) <= 2.0 * self.arm.reach)
        return int(np.argmax(far)) if far.any() else len(tips)

    def _torque(self, motion: JointMotion, times: list[float]) -> Array:
        if motion.torque is None:
            return np.zeros((self.model.n_joint, len(times)))
        return np.array([motion.torque(t) for t in times], dtype=np.float64).T

    @cached_property
    def _tip(self) -> Any:
        import casadi as ca

        q = ca.SX.sym("q", self.model.n)
        frames = outward(self.model.chain, ca.vertsplit(q), [0.0] * self.model.n)
        return ca.Function("tip", [q], [ca.cse(ca.vertcat(*poses(frames)[-1].tip))])


def distance(a: Array, b: Array) -> float:
    """[m] largest distance between two tip motions; infinite if one diverged."""
    with np.errstate(over="ignore"):  # a diverging motion may overflow
        largest = float(np.linalg.norm(a - b, axis=1).max())
    return largest if np.isfinite(largest) else float("inf")


def _pieces(motion: JointMotion, stride: int) -> list[tuple[float, float]]:
    """Start and width [s] of every interval between samples; torque jumps lie on starts."""
    result = []
    for begin, end in pairwise(motion.knots):
        count = STRIDES[0] * int(np.ceil(SAMPLES / STRIDES[0] * (end - begin) / motion.t_end))
        width = (end - begin) / count * stride
        result += [(begin + k * width, width) for k in range(count // stride)]
    return result


def _trace(model: Model, integrator: str) -> TracedMethod:
    """Run an integrator's step functions on a workspace of symbols."""
    import casadi as ca

    method, n = INTEGRATORS[integrator], model.n
    Q, V, A, W, SCRATCH = 0, n, 2 * n, 3 * n, 6 * n
    places = Slots(n, Q, V, A, W, SCRATCH)
    keep = SCRATCH + method.kept(n)
    x = ca.vertsplit(ca.SX.sym("x", keep))  # the part of the workspace that steps keep
    tau, h = ca.SX.sym("tau", model.n_joint), ca.SX.sym("h")
    weights = Implicit(*(x[W + k * n : W + (k + 1) * n] for k in range(3)))
    implicit = weights if method.implicit else None
    result = accelerations(model.chain, x[Q:V], x[V:A], ca.vertsplit(tau), implicit)
    inputs = [ca.vertcat(*part) for part in (x[Q:V], x[V:A], x[W:SCRATCH])]
    graph = ca.Function("accelerations", [*inputs, tau], [ca.cse(ca.vertcat(*result))])

    def evaluate(w: Any) -> None:
        values = [ca.vertcat(*part) for part in (w[Q:V], w[V:A], w[W:SCRATCH])]
        w[A:W] = ca.vertsplit(graph(*values, tau))

    def jacobian(w: Any) -> None:
        values = [ca.vertcat(*part) for part in (w[Q:V], w[V:A])]
        rows = graphs.state_jacobian(model.traced)(*values, tau, *[ca.SX(0, 1)] * 2)
        w[SCRATCH : SCRATCH + 2 * n * n] = ca.vertsplit(rows)

    known = jacobian if method.aid == "jacobian" else aid(method.aid, model.chain)

    def start(w: Any, h: Any, *rest: Any) -> None:
        method.prepare(w, h, places, known)
        method.start(w, h, *rest)

    steps = []
    for function in (start, method.step):
        w = np.zeros(SCRATCH + method.scratch(n), dtype=object)
        w[:keep] = x
        with warnings.catch_warnings():  # CasADi warns of numpy.cos on symbols, which is intended
            warnings.simplefilter("ignore")
            function(w, h, evaluate, places, known)
        after = ca.vertcat(*w[:keep])
        steps.append(ca.Function("step", [ca.vertcat(*x), tau, h], [after]))
    cost, whole = (sum(operations(x).values()) for x in (graph, steps[1]))
    return TracedMethod(steps[0], steps[1], whole / cost, cost)
