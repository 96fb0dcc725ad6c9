"""Plant and task for N environments: what the single, the batch and the SB3 environment share."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics import load_arm
from dynamics.description import validate
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource
from dynamics.model import Model, compile_arm
from dynamics.runtime.jit import compiled_for
from dynamics.runtime.thread_pool import ThreadPool, in_use, useful_threads
from dynamics.runtime.work_queue import shares
from dynamics.simulation.stepper import MOST_ENVIRONMENTS, MOST_THREADS
from dynamics.simulation.validity import LARGEST_RATE
from dynamics.types import Array
from flexarm_env import arguments
from flexarm_env.accuracy.certificates import find, fit, kept
from flexarm_env.actuators import load_actuators, mounted, refuse_beside_actuators
from flexarm_env.compiled import episode
from flexarm_env.compiled.actuation import Actuation
from flexarm_env.compiled.outputs import SPARE, BatchOutputs, Outputs, SingleOutputs
from flexarm_env.compiled.signals import FLAGS, LOST, Signals
from flexarm_env.observations import observation_layout
from flexarm_env.rewards import TERMS, resolve_weights
from flexarm_env.scales import (
    BY_RULE,
    DEFLECTION_LIMIT,
    MOVE,
    SLOPE_PER_DEFLECTION,
    integration,
    scales,
)
from flexarm_env.tasks import find_task

FASTEST = 1e12  # [rad/s] of a joint without a limit
DIVERGED = FLAGS.index("diverged")


class Core:
    """N copies of an arm at a task.

    A control step is one compiled call: command, substeps and report of all, see `signals.Signals`.

    Parameters
    ----------
    task : "Reach", "Track" or "Damp".
    arm : whatever `load_arm` takes.
    n_env : number of environments.
    single : whether what it says is `SingleOutputs`, of the one environment, or `BatchOutputs`.
    obs : "state" or "sensors".
    reward : name in `rewards.REWARDS` or weights of `rewards.TERMS`; None: the task's own.
    control_dt : [s] time between actions.
    integrator, substeps : None: the fastest that was measured to be accurate, see certify.py; for
        an arm that was not measured, by rule, see `scales.integration`.
    torque_limit : [N m] one number or one per joint; None: see `scales.Scales`.
    actuator : between action and torque: a name in `actuators.PRESETS`, a dict, or a list of one
        per joint; None: the torque is the action times its limit.
    deflection_limit : [-] deflection over length above which an episode ends as invalid.
    max_steps : control steps after which an episode is truncated; 0: never.
    threads : worker threads at most; a batch with too little work for them takes fewer.
    dtype : number type of the compiled code, the state, rewards and info: "float64" or "float32".
    randomize : ranges (low, high) of free parameters, drawn anew at every reset; names are those
        of `dynamics.free_parameters.FREE_PARAMETERS`.
    fidelity : "auto", the arm as described; "rigid", without modes; or "reference", cut into
        foreshortened segments, and slow.
    tolerance : [m] instead: the cheapest model, integrator and step whose tip error on the
        environment's motions stays below it, by `dynamics.choose_model`.

    Attributes
    ----------
    certificate : measured errors of model and step, see `dynamics.certificate.Certificate`; None
        where this arm and step were never certified.
    q, v : (N, n) coordinates and rates, writable views.
    dt : [s] integration step.
    lock : held while a thread steps or resets, see `claim`.
    shares : chunk counters of a step, see `dynamics.runtime.work_queue.shares`.
    workspaces : one per thread.
    parameters : (N, n_free) values of the randomized parameters, a view.
    """

    def __init__(
        self,
        *,
        task: str,
        arm: ArmSource,
        n_env: int = 1,
        single: bool = False,
        obs: str = "state",
        reward: str | Mapping[str, float] | None = None,
        control_dt: float = 0.02,
        integrator: str | None = None,
        substeps: int | None = None,
        torque_limit: float | Sequence[float] | None = None,
        deflection_limit: float = DEFLECTION_LIMIT,
        max_steps: int = 0,
        threads: int = 1,
        dtype: str = "float64",
        randomize: Mapping[str, tuple[float, float]] | None = None,
        fidelity: str = "auto",
        tolerance: float | None = None,
        actuator: Any = None,
    ) -> None:
        self.arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        self.task_name, self.task = task, find_task(task)
        described = load_arm(arm)
        actuators = load_actuators(actuator, described.n_joint)
        described = mounted(described, actuators)
        if actuators:
            refuse_beside_actuators(torque_limit=torque_limit, tolerance=tolerance)
        self.control_dt = arguments.within("control_dt", control_dt, *arguments.CONTROL_DT, "s")
        deflection_limit = arguments.within(
            "deflection_limit", deflection_limit, *arguments.DEFLECTION_LIMITS, "-"
        )
        if described.base.n:
            raise ValueError(
                f"Base.type must be 'fixed' for an environment, got {described.base.type!r}; "
                "step a free base with dynamics.Stepper."
            )
        self.n_env = validate.integer(n_env, "num_envs", 1, MOST_ENVIRONMENTS)
        self.threads = validate.integer(threads, "threads", 1, MOST_THREADS)
        max_steps = validate.integer(max_steps, "max_episode_steps", 0, arguments.MOST_STEPS)
        self._outputs = SingleOutputs if single else BatchOutputs
        self.randomize = arguments.ranges({} if randomize is None else randomize)
        fitted = fit(described, self.control_dt, fidelity, tolerance)
        self.arm, self.scales = fitted.arm, scales(fitted.arm)
        given = scales(described)  # what a task asks does not depend on the model of the arm
        self.actuation = Actuation(actuators, self.arm, given.torque_limit) if actuators else None
        if self.actuation:
            self.torque_limit = self.actuation.torque_limit
        else:
            self.torque_limit = arguments.torque_limits(torque_limit, given.torque_limit)
        self.integrator, self.substeps = self._integration(
            fitted.integrator if integrator is None else integrator,
            fitted.substeps if substeps is None else substeps,
        )
        self.dt = self.control_dt / self.substeps
        step = self.arm, self.control_dt, self.integrator, self.substeps
        self.certificate = None if self.actuation else fitted.certificate or find(*step)
        weights = resolve_weights(self.task.reward if reward is None else reward)
        inertia = np.array(given.inertia)
        full = self.torque_limit  # of a strong motor, what the arm can stand
        full = np.minimum(full, given.torque_limit) if self.actuation else full
        acceleration = float(np.min(full / inertia))  # [rad/s^2] at full torque
        self.rate_scale = math.sqrt(acceleration * MOVE)  # [rad/s] top speed of a typical move
        self.move_time = 2.0 * math.sqrt(MOVE / acceleration)  # [s] of a bang-bang move by MOVE
        sensed = tuple(self.torque_limit.tolist()) if self.actuation else ()
        self.layout = observation_layout(
            self.arm, self.task, obs, self.scales, self.rate_scale, sensed
        )

        self.model: Model = compile_arm(
            self.arm, dtype=dtype, free_parameters=tuple(self.randomize)
        )
        self.signals = Signals(self.model, self.task.moving, self.layout, self.actuation)
        self._constants = self._fixed_numbers(weights, deflection_limit, max_steps)
        self._start = self._episode_ranges()
        self._allocate()

    def _integration(self, integrator: str | None, substeps: int | None) -> tuple[str, int]:
        if integrator is not None:
            validate.known(integrator, "integrator", INTEGRATORS)
        entry = kept(self.arm, self.control_dt) if integrator is None else None
        if entry is not None:
            best = next(s for s in entry["steps"] if self._as_measured(s["integrator"]))
            name, count = best["integrator"], best["substeps"]
        else:
            name, count = integration(self.arm, self.control_dt, integrator)
        if self.actuation:
            count = max(count, self.actuation.substeps(self.control_dt, name))
        if substeps is not None:
            return name, validate.integer(substeps, "substeps", 1, arguments.MOST_SUBSTEPS)
        if count > arguments.MOST_BY_RULE:
            raise ValueError(
                f"control_dt ({self.control_dt:g} s) would take {count} steps of {name!r}, more "
                f"than {arguments.MOST_BY_RULE}, for an arm of {self.scales.fastest:.3g} rad/s; "
                "leave out modes of its stiffest links, take fidelity='rigid', or set substeps."
            )
        return name, count

    def _as_measured(self, integrator: str) -> bool:
        """Whether a method does here what it did where its error was measured.

        Restarted every substep, for actuators, a method that remembers does not; frozen modes are
        those of the arm as described, not of one with other parameters.
        """
        if self.actuation:
            return integrator in BY_RULE
        return not self.randomize or INTEGRATORS[integrator].aid != "modes"

    def _fixed_numbers(
        self, weights: dict[str, float], deflection_limit: float, max_steps: int
    ) -> Array:
        """What holds for all environments, as `signals.Signals.constants` names it."""
        values: dict[str, Any] = {
            "torque_limit": self.torque_limit,
            "control_dt": self.control_dt,
            "max_steps": max_steps,
            "deflection_limit": deflection_limit,
            "slope_limit": SLOPE_PER_DEFLECTION * deflection_limit,
            "rate_limit": self._rate_limit(),
            "per_rate": 1.0 / self.rate_scale,
            "move_time": self.move_time,
            "weights": [weights.get(name, 0.0) for name in TERMS],
            "factors": self.layout.factors,
        }
        if self.actuation:
            values["command_limit"] = self.actuation.command
            values["actuators"] = self.actuation.constants(self.dt)
        return self.signals.constants.packed(values, self.model.dtype)

    def _rate_limit(self) -> float:
        """[rad/s] joint rate beyond which linear modes lose much of their stiffness."""
        if self.arm.foreshortening or not self.scales.held:
            return FASTEST
        return LARGEST_RATE * min(self.scales.held)

    def _episode_ranges(self) -> tuple[Any, ...]:
        """What `episode.begin` draws from, and where it writes."""
        first = {name: rows.start for name, rows in self.signals.state.slices.items()}
        names = ("q", "v", "centre", "amplitude", "frequency", "phase", "free")  # as episode.py's
        return (
            self.task.ranges(self.move_time),
            np.array(self.scales.home),
            np.array(self.arm.joint_index, dtype=np.uint64),
            np.array(self.scales.modal_scale),
            np.array(self.scales.modal_rate),
            np.array([MOVE, self.rate_scale**2 / MOVE]),
            np.array(list(self.randomize.values()), dtype=np.float64).reshape(-1, 2),
            np.array([first[name] for name in names], dtype=np.uint64),
        )

    def _allocate(self) -> None:
        """The state of all environments, and a workspace per thread."""
        n_env, rows = self.n_env, self.signals.state.slices
        lanes = 1 if n_env == 1 else self.model.lanes
        self._program = self.model.program(lanes, self.integrator, self.signals.addition)
        blocks = -(-n_env // lanes)
        self._width = lanes * (blocks | 1)  # an odd number of blocks spreads rows over the cache
        self._kept: list[Outputs] = []
        self.state = np.zeros((self.signals.state.total, self._width), self.model.dtype)
        self.state[rows["free"]] = self.model.nominal_parameters[:, None]
        self.streams = np.zeros(n_env, dtype=np.int64)
        self.q, self.v = self.state[rows["q"], :n_env].T, self.state[rows["v"], :n_env].T
        self.parameters = self.state[rows["free"], :n_env].T
        threads = useful_threads(self.threads, blocks, n_env * self._operations())
        self.shares = shares(n_env, lanes, threads)
        self.workspaces = [self._workspace() for _ in range(threads)]
        self._no_actions = np.zeros((0, self.arm.n_joint), np.float32)
        self._pool = ThreadPool(threads)
        self.lock = Lock()  # held by whoever steps or resets

    def _operations(self) -> int:
        """How many a control step of one environment takes, but for the method's own."""
        evaluations = INTEGRATORS[self.integrator].evaluations(self.substeps)
        return int(evaluations * self._program.OPERATIONS + self._program.FURTHER_OPERATIONS)

    def _workspace(self) -> Array:
        w = self.model.workspace(self._program)
        lanes = int(self._program.LANES)
        first = int(self._program.CONSTANTS)
        w[first : first + lanes * self._constants.size] = np.repeat(self._constants, lanes)
        return w

    def outputs(self) -> Any:
        """`Outputs` to fill that nobody else holds."""
        for known in self._kept:
            if known.unused:
                return known
        info = self.signals.info
        new = self._outputs(self.n_env, self.layout.size, self._width, self.model.dtype, info)
        self._kept = [*self._kept[-SPARE + 1 :], new]
        return new

    # ---- stepping ----------------------------------------------------------------------------

    def claim(self) -> None:
        """Take the lock, or refuse: two threads would step one batch at once."""
        if not self.lock.acquire(blocking=False):
            raise in_use()

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, int]:
        """One control step of all: what it says, and how many ended."""
        out = self.outputs()
        if len(self.workspaces) == 1:  # as `_turn`, whose call a single environment would feel
            ended = self._control_step(
                self.shares, 0, self.substeps, self.dt, actions, self.state, self.workspaces[0],
                out.obs, out.info, out.flags,
            )  # fmt: skip
        elif not np.isfinite((actions.min(), actions.max())).all():
            ended = -1  # must not find other environments stepped already
        else:
            self._control_step  # compiled by one thread, before several need it  # noqa: B018
            ended = sum(self._pool.run(partial(self._turn, self.shares.copy(), actions, out)))
        if ended < 0:
            bad = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise ValueError(
                f"Actions must be finite numbers, of which [-1, 1] count, got "
                f"{actions[bad].tolist()} for environment {bad}."
            )
        return out, ended

    def _turn(
        self, rows: NDArray[np.int64], actions: NDArray[np.float32], out: Outputs, thread: int
    ) -> int:
        """A thread's part of a step."""
        ended: int = self._control_step(
            rows, thread, self.substeps, self.dt, actions, self.state, self.workspaces[thread],
            out.obs, out.info, out.flags,
        )  # fmt: skip
        return ended

    @cached_property
    def _control_step(self) -> Callable[..., Any]:
        """The compiled step of all environments; returns how many episodes ended."""
        out = self.outputs()
        return compiled_for(
            self._program.control_step, self.shares, 0, self.substeps, self.dt, self._no_actions,
            self.state, self.workspaces[0], out.obs, out.info, out.flags,
        )  # fmt: skip

    def restart(
        self, rows: NDArray[np.int64], out: Outputs, options: Mapping[str, Any] | None = None
    ) -> None:
        """Start new episodes in the environments `rows`; their entries of the outputs.

        Options that are refused leave the environments as they were.
        """
        placed = {} if options is None else arguments.placements(options, self.arm, rows.size)
        before = self.state[:, rows], self.streams[rows]
        episode.begin(rows, *self._start, self.state, self.streams)
        for name, values in placed.items():
            self.state[self.signals.state.slices[name]].T[rows] = values
        if self.actuation:
            states = self.signals.state.slices["actuator"]
            self.state[states, rows] = self.actuation.at_rest(self.q[rows])
        w = self.workspaces[0]
        self._control_step(
            rows, 0, 0, self.dt, self._no_actions, self.state, w, out.obs, out.info, out.flags
        )
        if placed and out.flags[DIVERGED, rows].any():
            self.state[:, rows], self.streams[rows] = before
            raise ValueError(
                f"options['state'] must bend no link by more than {LOST:g} times the "
                "deflection_limit, which no model of this arm can mean."
            )

    def reset(self, rows: NDArray[np.int64], options: Mapping[str, Any] | None = None) -> Any:
        """Start new episodes in `rows` and report on them; the other rows are zero."""
        out = self.outputs()
        for array in (out.obs, out.info, out.flags):
            array[...] = 0
        self.restart(rows, out, options)
        return out

    def seed(self, row: int, generator: np.random.Generator) -> None:
        """Start environment `row`'s own stream of random numbers from one number of a generator."""
        self.streams[row] = generator.integers(1 << 63, dtype=np.int64)

    # ---- reports -----------------------------------------------------------------------------

    def joint_target(self) -> Array:
        """(N, n_joint) [rad] joint angles that put the tip on the target, links straight."""
        return self.state[self.signals.state.slices["target"], : self.n_env].T.copy()

    def joint_state(self) -> tuple[Array, Array]:
        """(N, n_joint) [rad] and [rad/s]: what ideal encoders read."""
        joints = list(self.arm.joint_index)
        return self.q[:, joints], self.v[:, joints]

    def goal(self, row: int) -> Array:
        """(3,) [m] where environment `row`'s tip should be."""
        q = np.zeros(self.arm.n)
        q[list(self.arm.joint_index)] = self.joint_target()[row]
        return self.model.tip(q)

    def elapsed(self, row: int) -> int:
        """Control steps since the start of environment `row`'s episode."""
        return int(self.state[self.signals.state.slices["elapsed"].start, row])

    # ---- copies ------------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        arrays = {"state": self.state.copy(), "streams": self.streams.copy()}
        return {"arguments": self.arguments, "arrays": arrays}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Core.__init__(self, **state["arguments"])
        self.state[...] = state["arrays"]["state"]
        self.streams[...] = state["arrays"]["streams"]
