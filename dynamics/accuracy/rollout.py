"""Tip motions of an arm by any integrator, without compilation.

The step functions of the integrators run on a workspace of symbols, which gives the expression
graph of one step. CasADi evaluates that graph step after step. Preparing a model takes a fraction
of a second, so many models can be compared.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from dynamics.accuracy.choice import NoModel
from dynamics.accuracy.scene import JointMotion
from dynamics.description.arm import Arm
from dynamics.formulations.free_base import SIZE, local, renewed, world
from dynamics.formulations.kinematics import outward, poses
from dynamics.formulations.linearized import aid
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS, Integrator
from dynamics.model import Model
from dynamics.simulation import step_limits
from dynamics.simulation.case_file import Numbers
from dynamics.tracing import graphs
from dynamics.tracing.equilibrium import equilibrium
from dynamics.tracing.operation_counts import operations
from dynamics.types import Array

ROUND_OFF = 1e-9  # relative, of the lengths of steps that are meant to be equal
SAMPLES = 256  # least number of tip positions at which motions are compared
STRIDES = (8, 4, 2, 1)  # distances between compared samples; large steps take a large stride
EXPLICIT_WORK = 1e8  # [operations] (under a second) above which an implicit method starts
AGREE = 3.0  # difference of two results over the error of the finer one, with order two
ESTIMATE = 80.0  # [operations] of a link without modes in an estimate of the work
TRAVELS = 100  # [of the reach] farthest tip of an arm that slides or is on a free base
EARLY = 3  # samples: a tip that leaves the reach within them does so because of the step
LAST = 8  # samples before a tip leaves the reach, in which the cause is looked for
LOST = 0.5  # [-] least inertia of any motion over that at the start, which a step later is gone
REMEDY = "Take a larger tolerance or a shorter scene."
MOST_WORK = 5e9  # [operations] after which a motion is given up


class NotConverged(NoModel):
    """A motion diverges, or still depends on the step at the smallest affordable step."""


@dataclass(frozen=True)
class TracedMethod:
    """CasADi functions of one integrator on one arm.

    A state is the part of the workspace that outlives a step: q and v come first.
    """

    method: Integrator
    prepared: Callable[[Array, float], Array]  # state with the constants of a step length
    start: Any  # (state, torque, step) -> state
    step: Any  # the same
    graph: Any  # of one evaluation
    own: Any  # (step, ...) -> state after a start, state after a step, without the evaluations

    @cached_property
    def both(self) -> Any:
        """Function (state, torque, step) -> state of a start and a step."""
        import casadi as ca

        x, tau, h = (ca.MX.sym(name, self.step.size1_in(k)) for k, name in enumerate("xth"))
        return ca.Function("both", [x, tau, h], [self.step(self.start(x, tau, h), tau, h)])

    @cached_property
    def operations(self) -> int:
        """Operations per evaluation of the accelerations."""
        return sum(operations(self.graph).values())

    def work(self, steps: int) -> float:
        """Operations of a start and of `steps` steps; constants of the step are made before."""
        start, step = (sum(operations(own, offline=1).values()) for own in self.own)
        evaluations = self.method.evaluations(steps)
        return evaluations * self.operations + start + steps * step


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
        self._rest: dict[Numbers, Array] = {}  # joint angles -> equilibrium

    @cached_property
    def operations(self) -> int:
        """Operations per explicit evaluation of the accelerations."""
        return sum(operations(graphs.accelerations(self.model.traced)).values())

    @cached_property
    def estimate(self) -> float:
        """Estimate of `operations` without a trace; too large for planar arms."""
        return sum(ESTIMATE * (1 + len(link.K)) ** 2 for link in self.model.chain.links)

    def fastest(self, motion: JointMotion) -> float:
        """[rad/s] bound on the eigenvalues of the arm at rest at the start of a motion."""
        return step_limits.fastest(self.model, self._start(motion)[0])

    def _start(self, motion: JointMotion) -> tuple[Array, Array]:
        """(n,) coordinates and rates; a free base starts as `Base` describes it."""
        base, joints = self.arm.base, list(self.arm.joint_index)
        q, v = np.zeros(self.model.n), np.zeros(self.model.n)
        q[: base.n], v[: base.n] = base.q, base.v
        q[joints], v[joints] = motion.joint_angles, motion.joint_rates
        if motion.settled and not base.n and any(self.arm.gravity):
            q = self._settled(motion.joint_angles, q)
        return q, v

    def _settled(self, angles: Numbers, straight: Array) -> Array:
        """(n,) coordinates at rest under gravity; `straight` if links are too soft for that."""
        if angles not in self._rest:
            try:
                self._rest[angles] = equilibrium(self.model.traced, np.array(angles)).q
            except ValueError:
                self._rest[angles] = straight
        return self._rest[angles]

    def method(self, integrator: str) -> TracedMethod:
        """CasADi functions of one integrator."""
        if integrator not in self._methods:
            self._methods[integrator] = _trace(self.model, integrator)
        return self._methods[integrator]

    def tips(
        self, motion: JointMotion, integrator: str, dt: float, stride: int = 1, used: bool = False
    ) -> Array:
        """(N, 3) [m] tip at every `stride`-th sample, by equal steps of at most `dt`.

        Each step takes the torque at its midpoint, as `simulate` does. The method starts anew where
        the torque jumps; if `used`, also as often as in use, see `JointMotion.hold`. After a motion
        diverges, its tip is NaN.
        """
        states = self._states(motion, integrator, dt, stride, used)
        tips = np.full((len(_pieces(motion, stride)) + 1, 3), np.nan)
        tips[: len(states)] = np.array(self._tip.map(len(states))(self._positions(states))).T
        return tips

    def deflection(self, motion: JointMotion, link: int) -> float:
        """[-] largest tip deflection of a link in one piece over its length."""
        states = self._states(motion, "midpoint", motion.t_end / (8 * SAMPLES), 1, False)
        parts = self.model.chain.split(list(np.array(states)[:, : self.model.n].T))
        place = self.model.bodies[link]
        body, (_, delta) = self.model.chain.links[place][-1], parts[place][-1]
        shift = np.transpose(body.tip_phi[: len(body.K)]) @ np.array(delta)
        return float(np.linalg.norm(shift, axis=0).max()) / body.length

    def _states(
        self, motion: JointMotion, integrator: str, dt: float, stride: int, used: bool
    ) -> list[Array]:
        """States at every `stride`-th sample up to the first that is not finite."""
        method = self.method(integrator)
        pieces = _pieces(motion, stride)
        steps = max(1, int(np.ceil(max(width for _, width in pieces) / dt - 1e-9)))
        roll = (method.both if used and motion.hold is None else method.step).mapaccum(steps)
        x = np.zeros(method.start.size1_in(0))
        q, v = self._start(motion)
        x[: q.size], x[q.size : 2 * q.size] = q, v
        if self.arm.base.spatial:
            x[-4:] = self.arm.base.quaternion
            for six in (x[:SIZE], x[q.size : q.size + SIZE]):  # into the base's own frame
                six[:3] = local(six[:3].tolist(), self.arm.base.quaternion)
            x[3:SIZE] = 0.0
        states, starts, known = [x], _starts(motion, pieces, used), 0.0
        for (begin, width), starting in zip(pieces, starts, strict=True):
            h = width / steps
            if abs(h - known) > ROUND_OFF * h:
                x, known = method.prepared(x, h), h
            tau = self._torque(motion, [begin + h * (k + 0.5) for k in range(steps)])
            if starting:
                x = method.start(x, tau[:, 0], h)
            x = np.array(roll(x, tau, np.full((1, steps), h))[:, -1]).ravel()
            states.append(x)
            if not np.all(np.isfinite(x)):
                break
        return states

    def step(self, motion: JointMotion, dt: float) -> float:
        """[s] step nearest to `dt` that `run` takes."""
        _, steps, width = _strides(motion, dt)
        return width / steps

    def run(self, motion: JointMotion, integrator: str, dt: float) -> Run:
        """Tip by steps of about `dt` as in use; steps may be longer than between samples."""
        stride, steps, width = _strides(motion, dt)
        tips = self.tips(motion, integrator, width / steps, stride, used=True)
        return Run(tips, stride, width / steps)

    def cost(self, motion: JointMotion, integrator: str, dt: float) -> float:
        """Operations per simulated second by steps of `dt` [s] as in use."""
        hold = motion.hold or dt
        return self.method(integrator).work(max(1, round(hold / dt))) / hold

    def converged(self, motion: JointMotion, accuracy: float) -> Array:
        """(N, 3) [m] tip at all samples, with an integration error of at most `accuracy`.

        Steps are halved until two results agree; these are extrapolated to zero step. The finer
        result of the lowest order, two, errs by a third of their difference.

        Raises
        ------
        NotConverged : if the motion diverges or needs too small a step.
        """
        fastest, method = self.fastest(motion), "rk4"
        dt = min(2.0 / fastest if fastest else np.inf, motion.t_end / (2 * SAMPLES))
        work = 4.0 * self.estimate * motion.t_end
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
                raise NotConverged(self._divergence(motion, method, dt, max(exits)))
            if distance(fine, coarse) <= AGREE * accuracy:
                return fine + (fine - coarse) / gain
            if work / dt > MOST_WORK:
                break
            coarse = fine
        raise NotConverged(
            f"Steps of {dt:.3g} s still move the tip by {distance(fine, coarse):.3g} m, more than "
            f"{AGREE * accuracy:.3g} m; the motion is too long, too stiff or chaotic. {REMEDY}"
        )

    def _divergence(self, motion: JointMotion, method: str, dt: float, end: int) -> str:
        """Cause of a divergence at a sample, in words: the model's inertia, or else the motion."""
        q = np.array(self._states(motion, method, dt, 1, False))[:, : self.model.n]
        looked = [q[0], *(row for row in q[max(1, end - LAST) : end] if np.isfinite(row).all())]
        least = [np.linalg.eigvalsh(self.model.mass_matrix(row))[0] for row in looked]
        if min(least) < LOST * least[0]:
            return (
                "The mass matrix of the bent arm is no longer positive: links move almost no "
                "inertia in some direction. Give rho_Ip [kg m] of links with GJ, or tip_inertia "
                "[kg m^2], or leave GJ out."
            )
        return f"The motion leaves the reach ({self.arm.reach:.6g} m): diverged. {REMEDY}"

    def _exit(self, tips: Array) -> int:
        """Index of the first sample that is too far or NaN, else the number of samples."""
        moves = self.arm.base.n or any(x.joint.type == "prismatic" for x in self.arm.links)
        farthest = math.hypot(*self.arm.base.position) + (TRAVELS if moves else 2) * self.arm.reach
        far = ~(np.abs(tips).max(axis=1) <= farthest)
        return int(np.argmax(far)) if far.any() else len(tips)

    def _torque(self, motion: JointMotion, times: list[float]) -> Array:
        if motion.torque is None:
            return np.zeros((self.model.n_torque, len(times)))
        return np.array([motion.torque(t) for t in times], dtype=np.float64).T

    def _positions(self, states: list[Array]) -> Array:
        """(n, N) coordinates of states, or (n + 4, N) with the attitude of a free base."""
        rows, n = np.array(states), self.model.n
        return np.hstack([rows[:, :n], rows[:, -4:]]).T if self.arm.base.spatial else rows[:, :n].T

    @cached_property
    def _tip(self) -> Any:
        import casadi as ca

        n = self.model.n
        x = ca.SX.sym("x", n + 4 * self.arm.base.spatial)
        q, attitude = ca.vertsplit(x)[:n], ca.vertsplit(x)[n:]
        frames = outward(self.model.chain, q, [0.0] * n)
        tip = world(poses(frames)[-1].tip, attitude)
        return ca.Function("tip", [x], [ca.cse(ca.vertcat(*tip))])


def distance(a: Array, b: Array) -> float:
    """[m] largest distance between two tip motions; infinite if one diverged."""
    with np.errstate(over="ignore"):  # a diverging motion may overflow
        largest = float(np.linalg.norm(a - b, axis=1).max())
    return largest if np.isfinite(largest) else float("inf")


def _pieces(motion: JointMotion, stride: int) -> list[tuple[float, float]]:
    """Start and width [s] of every interval between samples; torque jumps lie on starts."""
    result = []
    for begin, end in pairwise(motion.knots):
        if motion.hold is None:
            count = STRIDES[0] * int(np.ceil(SAMPLES / STRIDES[0] * (end - begin) / motion.t_end))
        else:
            count = _in_hold(motion) * round((end - begin) / motion.hold)
        width = (end - begin) / count * stride
        result += [(begin + k * width, width) for k in range(count // stride)]
    return result


def _in_hold(motion: JointMotion) -> int:
    """Samples per time for which a torque is held: a power of two."""
    assert motion.hold is not None
    return 1 << max(0, int(np.ceil(np.log2(SAMPLES * motion.hold / motion.t_end))))


def _starts(motion: JointMotion, pieces: list[tuple[float, float]], used: bool) -> list[bool]:
    """True for each interval between samples at whose beginning a method starts."""
    if not used:
        jumps = motion.knots[:-1]
        return [begin in jumps for begin, _ in pieces]
    if motion.hold is None:
        return [False] * len(pieces)  # a start is part of each step
    every = max(1, round(motion.hold / pieces[0][1]))
    return [k % every == 0 for k in range(len(pieces))]


def _strides(motion: JointMotion, dt: float) -> tuple[int, int, float]:
    """Stride, steps per interval between the samples that it leaves, and this interval [s]."""
    if motion.hold is not None:  # steps divide the hold; compare where steps and samples meet
        steps, samples = max(1, round(motion.hold / dt)), _in_hold(motion)
        common = math.gcd(steps, samples)
        return samples // common, steps // common, motion.hold / common
    for stride in reversed(STRIDES):
        width = max(width for _, width in _pieces(motion, stride))
        if width >= 4.0 * dt:
            break
    return stride, max(1, round(width / dt)), width


def _trace(model: Model, integrator: str) -> TracedMethod:
    """Run an integrator's step functions on a workspace of symbols."""
    import casadi as ca

    method, n = INTEGRATORS[integrator], model.n
    Q, V, A, W, SCRATCH = 0, n, 2 * n, 3 * n, 6 * n
    TAU = SCRATCH + method.scratch(n)
    places = Slots(n, Q, V, A, W, SCRATCH, TAU)
    keep = SCRATCH + method.kept(n)
    graph = graphs.accelerations(model.traced, method.implicit)
    x = ca.SX.sym("x", keep)  # the part of the workspace that steps keep
    tau, h = ca.SX.sym("tau", model.n_torque), ca.SX.sym("h")

    attitude = ca.vertsplit(ca.SX.sym("attitude", 4)) if model.arm.base.spatial else []

    def parameters() -> Any:
        gravity = local(model.arm.gravity, attitude) if model.traced.n_gravity else ()
        return ca.vertcat(*gravity)

    def evaluate(w: Any) -> None:
        implicit = ca.vertcat(*w[W:SCRATCH]) if method.implicit else ca.SX(0, 1)
        q, v = (ca.vertcat(*w[i : i + n]) for i in (Q, V))
        w[A:W] = ca.vertsplit(graph(q, v, tau, parameters(), implicit))

    def jacobian(w: Any) -> None:
        values = [ca.vertcat(*part) for part in (w[Q:V], w[V:A])]
        rows = graphs.state_jacobian(model.traced)(*values, tau, parameters(), ca.SX(0, 1))
        w[SCRATCH : SCRATCH + 2 * n * n] = ca.vertsplit(rows)

    known = jacobian if method.aid == "jacobian" else aid(method.aid, model.chain)

    def prepared(state: Array, step: float) -> Array:
        w = np.zeros(TAU + model.n_torque)
        w[:keep] = state[:keep]
        method.prepare(w, step, places, known)
        return np.concatenate([w[:keep], state[keep:]])

    def after(function: Callable[..., None], evaluate: Callable[[Any], None]) -> Any:
        """State after a start or a step; after a step a free base's frame is its own again."""
        w = np.zeros(TAU + model.n_torque, dtype=object)
        w[:keep], w[TAU:] = ca.vertsplit(x), ca.vertsplit(tau)
        with warnings.catch_warnings():  # CasADi warns of numpy.cos on symbols, which is intended
            warnings.simplefilter("ignore")
            function(w, h, evaluate, places, known)
        turned = list(attitude)
        if attitude and function is method.step:
            six, rates = (list(w[i : i + SIZE]) for i in (Q, V))
            w[Q : Q + SIZE], w[V : V + SIZE], turned = renewed(six, rates, attitude)
        return ca.vertcat(*w[:keep], *turned)

    results: list[Any] = []

    def given(w: Any) -> None:
        results.append(ca.SX.sym("a", n))
        w[A:W] = ca.vertsplit(results[-1])

    whole = ca.vertcat(x, *attitude)
    functions = (method.start, method.step)
    first, step = (ca.Function("step", [whole, tau, h], [after(f, evaluate)]) for f in functions)
    own = [after(f, given) for f in (method.start, method.step)]
    own = [ca.Function("own", [h, whole, tau, *results], [state]) for state in own]
    return TracedMethod(method, prepared, first, step, graph, own)
