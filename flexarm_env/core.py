"""N environments of an arm and a task: the common part of `env`, `vector` and `sb3`."""

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.description import validate
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource, load_arm
from dynamics.model import compile_arm
from dynamics.runtime.jit import aligned_zeros
from dynamics.runtime.numba_internals import compiled_for
from dynamics.runtime.thread_pool import ThreadPool, in_use, useful_threads
from dynamics.runtime.work_queue import shares
from dynamics.simulation.stepper import MOST_ENVIRONMENTS, MOST_THREADS
from dynamics.types import Array
from flexarm_env import arguments
from flexarm_env.compiled import episode, starts
from flexarm_env.compiled.happening import Happening
from flexarm_env.compiled.outputs import SPARE, BatchOutputs, Outputs, SingleOutputs
from flexarm_env.compiled.sensing import Sensing
from flexarm_env.compiled.settings import Settings, settings
from flexarm_env.compiled.signals import Signals
from flexarm_env.compiled.termination import FLAGS, LOST
from flexarm_env.hardware.sensors import load_hardware, refuse_exact_state
from flexarm_env.plant import Plant, planned, planned_again
from flexarm_env.task.events import check_event, spread
from flexarm_env.task.observations import (
    acceleration_scale,
    curvature_columns,
    curvature_scale,
    observation_layout,
    observation_mode,
    sensed_axes,
)
from flexarm_env.task.scales import DEFLECTION_LIMIT
from flexarm_env.task.tasks import find_task, refuse_floating

DIVERGED = FLAGS.index("diverged")


class Core:
    """N environments of one arm and one task.

    A control step of all environments is one compiled call, see `compiled.control_step`.

    Parameters
    ----------
    task : "Reach", "Track" or "Damp".
    arm : an `Arm`, or a source that `load_arm` takes.
    n_env : number of environments.
    single : whether `step` and `reset` return `SingleOutputs`, else `BatchOutputs`.
    obs : "state", "sensors" or "goal", which gives dicts for hindsight replay and the reward of
        `rewards.goal_reward`; None: "sensors" with imperfect hardware, else "state".
    reward : name in `rewards.REWARDS` or weights of `rewards.TERMS`; None: the task's default.
    control_dt : [s] time between actions.
    integrator, substeps : None: the fastest method and step that `flexarm certify` measured as
        accurate; for an arm that was not measured, the rule of `scales.integration`.
    torque_limit : [N m] one number or one per joint; None: see `scales.Scales`.
    base_torque : [N m] largest torque on a floating base, the last action; None: no torque acts.
    actuator : a name in `actuators.PRESETS`, a dict, or a list with one of these per joint; None:
        the torque is the action times its limit.
    deflection_limit : [-] deflection over length above which an episode ends as invalid.
    max_steps : control steps after which an episode is truncated; 0: never.
    threads : largest number of worker threads; a batch with little work uses fewer.
    dtype : number type of the compiled code, the state, rewards and info: "float64" or "float32".
    randomize : (low, high) by free parameter (`FREE_PARAMETERS`), drawn at every reset.
    event : "drop", "jump" or "push", what happens once in an episode, see `task.events`.
    curvature_limit : [-] root curvature over that of a tip force at 10 % deflection, above which
        `info["cost"]` grows; None: no cost.
    hardware : sensors and spread of the plant: a name in `hardware.PRESETS`, or a dict of fields of
        `hardware.Hardware`. None: "ideal". Its ranges yield to those of `randomize`.
    fidelity : "auto", the arm as described; "rigid", without modes; or "reference", links cut into
        foreshortened segments (slow).
    tolerance : [m] replaces `fidelity`: `dynamics.choose_model` takes the cheapest model,
        integrator and step whose tip error on the environment's motions stays below it.

    Attributes
    ----------
    certificate : errors of model and step over episodes that cover the `conditions`, see
        `certify.certificate`; None where none holds; `uncertified` says why, and the remedy.
    q, v : (N, n) coordinates and rates, writable views.
    dt : [s] integration step.
    rate_scale, move_time : peak joint rate [rad/s] and duration [s] of the move `scales.MOVE`.
    busy : whether a thread steps or resets, see `claim`; `begun` : whether episodes have begun.
    shares, workspaces : chunk counters of `dynamics.runtime.work_queue`; one per thread.
    action : (1, n_torque) action that `alone` takes.
    parameters : (N, n_free) values of the randomized parameters, a view.
    settings, arguments : keywords that may change, and all, by which a copy is built.
    constants, starts : numbers that all environments share; arguments of `episode.begin`.
    """

    def __init__(
        self,
        *,
        task: str,
        arm: ArmSource,
        n_env: int = 1,
        single: bool = False,
        obs: str | None = None,
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
        hardware: Any = None,
        base_torque: float | None = None,
        event: str | None = None,
        curvature_limit: float | None = None,
    ) -> None:
        given = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        self.task_name, self.task = task, find_task(task)
        self._n_env = validate.integer(n_env, "num_envs", 1, MOST_ENVIRONMENTS)
        self._threads = validate.integer(threads, "threads", 1, MOST_THREADS)
        given["arm"] = described = load_arm(arm)  # a copy does not read a file again
        fitted = load_hardware(hardware)
        check_event(event, described)
        self._spread = spread(event, described) | (fitted.spread(described) if fitted else {})
        self._outputs = SingleOutputs if single else BatchOutputs
        self.settings = settings(self.task, self._spread, given)
        plant = planned(given, self.randomize)
        refuse_floating(self.task, plant.arm)
        self.arm, self.scales, self.actuation = plant.arm, plant.scales, plant.actuation
        self._integrator, self.control_dt = plant.integrator, plant.control_dt
        self.torque_limit = plant.torque_limit
        self._take_step(plant)
        self.rate_scale, self.move_time = plant.rate_scale, plant.move_time
        self._rate_limit, self._impulse = plant.rate_limit, plant.impulse
        torques = tuple(self.actuation.torque_limit.tolist()) if self.actuation else ()
        obs = observation_mode(obs, fitted is not None)
        refuse_exact_state(obs, fitted)
        self.layout = observation_layout(
            self.arm, self.task, obs, self.scales, self.rate_scale, torques,
            bool(fitted and fitted.accelerometer_noise is not None),
        )  # fmt: skip
        gauges, axes = curvature_columns(self.arm), sensed_axes(self.arm)
        self.sensing = Sensing(fitted, self.arm.n_joint, gauges, axes) if fitted else None
        move = self.move_time / self.control_dt
        self.happening = Happening(event, axes[1:], self.arm.n_joint, move) if event else None
        self.gauge_scale = np.array(curvature_scale(self.arm, gauges))
        self.curvature_limit = arguments.curvature_limit(curvature_limit, gauges)
        self.model = compile_arm(self.arm, dtype=dtype, free_parameters=tuple(self.randomize))
        self.signals = Signals(
            self.model, self.task.moving, self.layout, self.actuation, self.sensing,
            self.happening, self.curvature_limit is not None,
        )  # fmt: skip
        self.constants = self._fixed_numbers(self.settings, self.dt)
        self.starts = self._episode_ranges()
        self._allocate()
        self.arguments = copy.deepcopy(given)

    # read-only: the step is compiled for them
    n_env = property(lambda self: self._n_env)
    threads = property(lambda self: self._threads)
    integrator = property(lambda self: self._integrator)
    randomize = property(lambda self: self.settings.ranges)
    max_steps = property(lambda self: self.settings.max_steps)

    def _take_step(self, plant: Plant) -> None:
        """Take the integration step of a plant, and what is known of its errors."""
        self.substeps, self.dt, self.conditions = plant.substeps, plant.dt, plant.conditions
        self.certificate, self.uncertified = plant.certificate, plant.uncertified
        vars(self).pop("alone", None)  # it has the former step

    def change(self, **keywords: Any) -> None:
        """Take new values of `reward`, `deflection_limit`, `max_steps` or `randomize`.

        They are checked as at construction, and a refused value changes nothing. Weights and limits
        hold from the next step, ranges from the next episode. The integration step gets finer where
        the new ranges need it, and the certificate is that of the new values, if there is one.
        """
        self.claim()
        try:
            given = self.arguments | keywords
            changed = settings(self.task, self._spread, given).after(self.settings)
            given["randomize"] = changed.ranges
            plant = planned_again(given, changed.ranges, self.integrator, self.substeps)
            self.constants = self._fixed_numbers(changed, plant.dt)
            self.arguments, self.settings = copy.deepcopy(given), changed
            self._take_step(plant)
            self.starts = self._episode_ranges()
            for w in self.workspaces:
                self.fill_constants(w, self.program)
        finally:
            self.busy = False

    def _fixed_numbers(self, settings: Settings, dt: float) -> Array:
        """Constants of all environments, in the order of `signals.Signals.constants`."""
        values: dict[str, Any] = {
            "torque_limit": self.torque_limit,
            "control_dt": self.control_dt,
            "rate_limit": self._rate_limit,
            "per_rate": 1.0 / self.rate_scale,
            "move_time": self.move_time,
            "factors": self.layout.factors,
            **settings.constants,
        }
        if self.actuation:
            values["command_limit"] = self.actuation.command
            values["actuators"] = self.actuation.constants(dt)
        if self.sensing:
            acceleration = acceleration_scale(self.arm, self.scales, self.rate_scale)
            values |= self.sensing.numbers(self.gauge_scale, acceleration)
        if self.curvature_limit is not None:
            values["curvature_limit"] = self.curvature_limit * self.gauge_scale
        return self.signals.constants.packed(values, self.model.dtype)

    def _episode_ranges(self) -> tuple[Any, ...]:
        """Arguments of `episode.begin`: ranges to draw from, and the rows to write."""
        drawn = [np.array(list(self.randomize.values()), dtype=np.float64).reshape(-1, 2)]
        if self.sensing:
            drawn.append(self.sensing.ranges(self.gauge_scale))
        if self.happening:
            drawn.append(self.happening.ranges(self._impulse / self.control_dt))
        return starts.arguments(
            self.task.ranges(self.move_time), self.arm, self.scales, self.rate_scale,
            np.concatenate(drawn), self.signals.state,
        )  # fmt: skip

    def _allocate(self) -> None:
        """Create the state of all environments, and a workspace per thread."""
        n_env, rows = self.n_env, self.signals.state.slices
        lanes = 1 if n_env == 1 else self.model.lanes
        self.program = self.model.program(lanes, self.integrator, self.signals.addition)
        blocks = -(-n_env // lanes)
        self._width = lanes * (blocks | 1)  # an odd number of blocks spreads rows over the cache
        self._kept: list[Outputs] = []
        self.state = aligned_zeros((self.signals.state.total, self._width), self.model.dtype)
        self.state[rows["free"]] = self.model.nominal_parameters[:, None]
        self.streams = np.zeros(n_env, dtype=np.int64)
        self.q, self.v = self.state[rows["q"], :n_env].T, self.state[rows["v"], :n_env].T
        self.parameters = self.state[rows["free"], :n_env].T
        threads = useful_threads(self.threads, blocks, n_env * self._operations())
        self.shares = shares(n_env, lanes, threads)
        self.workspaces = [self.model.workspace(self.program) for _ in range(threads)]
        for w in self.workspaces:
            self.fill_constants(w, self.program)
        self.action = np.zeros((1, self.arm.n_torque), np.float32)
        self._no_actions = self.action[:0]
        self.pool = ThreadPool(threads)
        self.busy = self.begun = False

    def _operations(self) -> int:
        """Operations of a control step of one environment, without the integrator's own."""
        evaluations = INTEGRATORS[self.integrator].evaluations(self.substeps)
        return int(evaluations * self.program.OPERATIONS + self.program.FURTHER_OPERATIONS)

    def fill_constants(self, w: Array, program: ModuleType) -> None:
        """Write the numbers that all environments share into a workspace of a program."""
        lanes, first = int(program.LANES), int(program.CONSTANTS)
        w[first : first + lanes * self.constants.size] = np.repeat(self.constants, lanes)

    def outputs(self) -> Any:
        """Outputs to fill: some that no caller refers to (docs/results/tricks.md), or new ones."""
        for spare in self._kept:
            if spare.unused:
                return spare
        info = self.signals.info
        new = self._outputs(self.n_env, self.layout.size, self._width, self.model.dtype, info)
        self._kept = [*self._kept[-SPARE + 1 :], new]
        return new

    # ---- stepping ----------------------------------------------------------------------------

    def claim(self) -> None:
        """Mark the batch as busy; a RuntimeError if another thread steps or resets it."""
        if self.busy:  # CPython lets threads and signals in at calls, not between these lines
            raise in_use()
        self.busy = True

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, int]:
        """Advance all by one control step; return outputs and the number of ended episodes."""
        out, compiled = self.outputs(), self._control_step  # compiled in this thread
        if len(self.workspaces) == 1:
            ended = compiled(*self._bound(self.shares, 0, actions, out))
        elif not np.isfinite((actions.min(), actions.max())).all():
            ended = -1  # refuse before any environment is stepped
        else:
            rows = self.shares.copy()
            ended = sum(self.pool.run(lambda k: compiled(*self._bound(rows, k, actions, out))))
        if ended < 0:
            raise arguments.not_finite(actions)
        return out, ended

    @cached_property
    def alone(self) -> tuple[Callable[[], int], Any]:
        """Step of a single environment by `action`, all arguments bound, and what it fills.

        It returns a negative number if the action is not finite. Gain: docs/results/tricks.md.
        """
        out = self.outputs()
        return partial(self._control_step, *self._bound(self.shares, 0, self.action, out)), out

    def _bound(
        self, rows: NDArray[np.int64], thread: int, actions: NDArray[np.float32], out: Outputs
    ) -> tuple[Any, ...]:
        """Arguments of the compiled step of the chunks that one thread takes."""
        return (
            rows, thread, self.substeps, self.dt, actions, self.state, self.workspaces[thread],
            out.obs, out.info, out.flags,
        )  # fmt: skip

    @cached_property
    def _control_step(self) -> Callable[..., Any]:
        """Compiled step of all environments; it returns the number of ended episodes."""
        out = self.outputs()
        return compiled_for(
            self.program.control_step, *self._bound(self.shares, 0, self._no_actions, out)
        )

    def restart(
        self, rows: NDArray[np.int64], out: Outputs, options: Mapping[str, Any] | None = None
    ) -> None:
        """Start new episodes in the environments `rows`, and write their entries of the outputs.

        Refused options leave the environments unchanged.
        """
        before = self.state[:, rows], self.streams[rows], self.begun
        placed = self.begin(rows, options)
        w = self.workspaces[0]
        self._control_step(
            rows, 0, 0, self.dt, self._no_actions, self.state, w, out.obs, out.info, out.flags
        )
        if placed and out.flags[DIVERGED, rows].any():
            self.state[:, rows], self.streams[rows], self.begun = before
            raise arguments.too_bent(LOST)

    def begin(self, rows: NDArray[np.int64], options: Mapping[str, Any] | None) -> bool:
        """Draw episodes for the environments `rows`; whether options placed some of their state."""
        placed = {} if options is None else arguments.placements(options, self.arm, rows.size)
        episode.begin(rows, *self.starts, self.state, self.streams)
        slices = self.signals.state.slices
        for name, values in placed.items():
            self.state[slices[name]].T[rows] = values
        if self.signals.bent and "q" not in placed:
            self.state[slices["elapsed"], rows] = episode.STRAIGHT
        if self.actuation:
            self.state[slices["actuator"], rows] = self.actuation.at_rest(self.q[rows])
        self.begun = True
        return bool(placed)

    def reset(self, rows: NDArray[np.int64], options: Mapping[str, Any] | None = None) -> Any:
        """Start new episodes in `rows` and return their outputs; other rows are zero."""
        out = self.outputs()
        for array in (out.obs, out.info, out.flags):
            array[...] = 0
        self.restart(rows, out, options)
        return out

    def seed(self, row: int, generator: np.random.Generator) -> None:
        """Seed the random stream of environment `row` with one number of a generator."""
        self.streams[row] = generator.integers(1 << 63, dtype=np.int64)

    # ---- reports -----------------------------------------------------------------------------

    def joint_target(self) -> Array:
        """(N, n_joint) [rad] joint angles that put the straight-link tip on the target."""
        return self.state[self.signals.state.slices["target"], : self.n_env].T.copy()

    def joint_state(self) -> tuple[Array, Array]:
        """(N, n_joint) [rad] and [rad/s] joint angles and rates, as ideal encoders read."""
        return self.q @ self.model.encoders.T, self.v @ self.model.encoders.T

    def goal(self, row: int) -> Array:
        """(3,) [m] target of the tip of environment `row`."""
        q = np.zeros(self.arm.n)
        q[list(self.arm.joint_index)] = self.joint_target()[row]
        q[: self.arm.base.n] = self.state[self.signals.state.slices["anchor"], row]
        return self.model.tip(q)

    def elapsed(self, row: int) -> int:
        """Control steps since the episode of environment `row` began."""
        return int(self.state[self.signals.state.slices["elapsed"].start, row])

    # ---- copies ------------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        arrays = {"state": self.state.copy(), "streams": self.streams.copy()}
        step = {"integrator": self.integrator, "substeps": self.substeps}
        return {"arguments": self.arguments, "step": step, "arrays": arrays, "begun": self.begun}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Core.__init__(self, **(state["arguments"] | state["step"]))
        self.arguments = state["arguments"]
        self.state[...] = state["arrays"]["state"]
        self.streams[...] = state["arrays"]["streams"]
        self.begun = state["begun"]
