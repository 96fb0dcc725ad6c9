"""Plant and task for N environments: what the single, the batch and the SB3 environment share."""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics import Arm, load_arm
from dynamics.integrators import INTEGRATORS
from dynamics.kernels import LANES
from dynamics.model import Model, compile_arm
from dynamics.stepper import Stepper
from flexarm_env import kernels
from flexarm_env.observations import curvature_columns, observation_layout
from flexarm_env.physics import (
    DEFLECTION_LIMIT,
    MOVE,
    SLOPE_PER_DEFLECTION,
    integration,
    physics,
)
from flexarm_env.rewards import resolve_weights
from flexarm_env.tasks import find_task

Array = NDArray[np.float64]
N_FLAG = int(kernels.N_FLAG)
TERMS = slice(int(kernels.FIRST_TERM), int(kernels.FIRST_TERM) + len(kernels.TERMS))
ArmSource = str | PathLike[str] | Mapping[str, Any] | Arm


class Core:
    """N copies of an arm at a task.

    A control step is three compiled calls: `kernels.command`, `Stepper.advance`, `kernels.judge`
    (and one to `Stepper.measure` where the target moves).

    Parameters
    ----------
    task : "Reach", "Track" or "Damp".
    arm : whatever `load_arm` takes.
    n_env : number of environments.
    obs : "state" or "sensors".
    reward : name in `rewards.REWARDS` or weights of `kernels.TERMS`; None: the task's own.
    control_dt : [s] time between actions.
    integrator, substeps : None: chosen for the arm, see `physics.integration`.
    torque_limit : [N m] one number or one per joint; None: see `physics.Physics`.
    deflection_limit : [-] deflection over length above which an episode ends as invalid.
    max_steps : control steps after which an episode is truncated; 0: never.
    threads : worker threads.
    """

    def __init__(
        self,
        *,
        task: str,
        arm: ArmSource,
        n_env: int = 1,
        obs: str = "state",
        reward: str | Mapping[str, float] | None = None,
        control_dt: float = 0.02,
        integrator: str | None = None,
        substeps: int | None = None,
        torque_limit: float | Sequence[float] | None = None,
        deflection_limit: float = DEFLECTION_LIMIT,
        max_steps: int = 0,
        threads: int = 1,
    ) -> None:
        self.arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        self.task_name, self.task = task, find_task(task)
        self.arm = load_arm(arm)
        _require_positive("control_dt", control_dt, "s")
        _require_positive("deflection_limit", deflection_limit, "-")
        for name, value, least in (
            ("n_env", n_env, 1),
            ("max_episode_steps", max_steps, 0),
            ("threads", threads, 1),
        ):
            _require_whole(name, value, least)
        self.n_env, self.threads, self.control_dt = int(n_env), int(threads), float(control_dt)
        self.physics = physics(self.arm)
        self.torque_limit = self._torque_limit(torque_limit)
        self.integrator, self.substeps = self._integration(integrator, substeps)
        weights = resolve_weights(self.task.reward if reward is None else reward)
        inertia = np.array(self.physics.inertia)
        acceleration = float(np.min(self.torque_limit / inertia))  # [rad/s^2] at full torque
        self.rate_scale = math.sqrt(acceleration * MOVE)  # [rad/s] top speed of a typical move
        self.move_time = 2.0 * math.sqrt(MOVE / acceleration)  # [s] of a bang-bang move by MOVE
        self.layout = observation_layout(self.arm, self.task, obs, self.physics, self.rate_scale)

        self.model: Model = compile_arm(self.arm)
        self._set_constants(weights, float(deflection_limit), int(max_steps))
        self._allocate()

    def _torque_limit(self, given: float | Sequence[float] | None) -> Array:
        if given is None:
            return np.array(self.physics.torque_limit)
        limit = np.asarray(given, dtype=np.float64)
        if limit.shape not in ((), (self.arm.n_joint,)):
            raise ValueError(
                f"torque_limit must be one number or {self.arm.n_joint} (one per joint), "
                f"got {given!r}. Unit: [N m]."
            )
        if not (np.isfinite(limit).all() and (limit > 0.0).all()):
            raise ValueError(f"torque_limit must be positive, got {given!r}. Unit: [N m].")
        return np.full(self.arm.n_joint, limit) if limit.shape == () else limit.copy()

    def _integration(self, integrator: str | None, substeps: int | None) -> tuple[str, int]:
        if integrator is not None and integrator not in INTEGRATORS:
            raise ValueError(f"Unknown integrator {integrator!r}. Known: {sorted(INTEGRATORS)}.")
        if substeps is not None:
            _require_whole("substeps", substeps, 1)
        name, count = integration(self.arm, self.control_dt, integrator)
        return name, count if substeps is None else int(substeps)

    def _set_constants(
        self, weights: dict[str, float], deflection_limit: float, max_steps: int
    ) -> None:
        """What the kernels know of the arm, the task and the reward."""
        arm, model = self.arm, self.model
        first = {name: part.start for name, part in model.measurements.items()}
        self.gauges = curvature_columns(arm)
        whole = [arm.n_joint, arm.n, int(self.task.moving), max_steps, len(self.gauges)]
        whole += [first[k] for k in ("tip", "tip_velocity", "rigid_tip", "deflection", "slope")]
        whole += [*arm.joint_index, *(first["curvature"] + k for k in self.gauges)]
        real = [self.control_dt, arm.reach, deflection_limit]
        real += [SLOPE_PER_DEFLECTION * deflection_limit, arm.reach * self.rate_scale]
        real += [self.rate_scale, MOVE, self.move_time]
        real += [x for row in arm.links[0].joint.rotation for x in row]
        real += [weights.get(name, 0.0) for name in kernels.TERMS]
        self._whole, self._real = np.array(whole, dtype=np.uint64), np.array(real)
        self._report = (self.layout.picks, self.layout.table, self.layout.n_signal)
        self._start = (
            np.int64(self.task.code),
            self.task.ranges(self.move_time),
            np.array(self.physics.home),
            np.array(self.physics.modal_scale),
            np.array(self.physics.modal_rate),
        )
        self.n_obs = self.layout.picks.size
        self.n_info = TERMS.stop + len(self.gauges) + arm.n_joint

    def _allocate(self) -> None:
        """The state of all environments, and one stepper per thread on its share of the rows."""
        arm, n_env = self.arm, self.n_env
        self.q, self.v = np.zeros((n_env, arm.n)), np.zeros((n_env, arm.n))
        self.torque = np.zeros((n_env, arm.n_joint))
        self.status = np.zeros(n_env, dtype=np.int64)
        self.measured = np.zeros((n_env, self.model.n_measure))
        self.memory = np.zeros((n_env, int(kernels.WIDTH) * arm.n_joint))
        self.counters = np.zeros((n_env, 2), dtype=np.int64)
        self.ref_q, self.ref_v = np.zeros((n_env, arm.n)), np.zeros((n_env, arm.n))
        self.ref_measured = np.zeros((n_env, self.model.n_measure))
        blocks = max(1, n_env // LANES)  # of lanes; the rest joins the last share
        count = min(self.threads, blocks)
        bounds = [*(LANES * (k * blocks // count) for k in range(count)), n_env]
        self._shares = [_Share(self, slice(a, b)) for a, b in pairwise(bounds)]
        self._pool = ThreadPoolExecutor(count - 1) if count > 1 else None

    # ---- stepping ----------------------------------------------------------------------------

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], int]:
        """One control step of all; new arrays (N, n_obs), (N, n_info), (N, n_flag), ended count."""
        obs = np.empty((self.n_env, self.n_obs), np.float32)
        info = np.empty((self.n_env, self.n_info))
        flags = np.empty((self.n_env, N_FLAG), np.bool_)
        first, *others = self._shares
        if not others:
            ended = first.step(actions, obs, info, flags)
        else:
            assert self._pool is not None
            waiting = [self._pool.submit(s.step, actions, obs, info, flags) for s in others]
            counts = [first.step(actions, obs, info, flags), *(w.result() for w in waiting)]
            ended = -1 if -1 in counts else sum(counts)
        if ended < 0:
            bad = int(np.flatnonzero(np.isnan(actions).any(axis=1))[0])
            raise ValueError(
                f"Actions must be numbers in [-1, 1], got {actions[bad].tolist()} for "
                f"environment {bad}."
            )
        return obs, info, flags, ended

    def restart(
        self,
        rows: NDArray[np.int64],
        obs: NDArray[np.float32],
        info: Array,
        flags: NDArray[np.bool_],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Start new episodes in the environments `rows`; their entries of obs, info, flags."""
        kernels.begin(
            rows, *self._start, self.q, self.v, self.memory, self.counters, self.ref_q, self.ref_v,
            self._whole, self._real,
        )  # fmt: skip
        if options:
            self._place(rows, options)
        for q, v, measured in (
            (self.q, self.v, self.measured),
            (self.ref_q, self.ref_v, self.ref_measured),
        ):
            out = np.empty((rows.size, measured.shape[1]))
            self._shares[0].stepper.measure(q[rows], v[rows], out)
            measured[rows] = out
        kernels.judge(
            rows, True, self.q, self.v, self.torque, self.status, self.measured, self.memory,
            self.counters, self.ref_q, self.ref_v, self.ref_measured, self._whole, self._real,
            *self._report, obs, info, flags,
        )  # fmt: skip

    def reset(
        self, rows: NDArray[np.int64], options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_]]:
        """Start new episodes in `rows` and report on all; rows not started are left undefined."""
        obs = np.zeros((self.n_env, self.n_obs), np.float32)
        info = np.zeros((self.n_env, self.n_info))
        flags = np.zeros((self.n_env, N_FLAG), np.bool_)
        self.restart(rows, obs, info, flags, options)
        return obs, info, flags

    def seed(self, row: int, generator: np.random.Generator) -> None:
        """Start environment `row`'s own stream of random numbers from one number of a generator."""
        self.counters[row, kernels.STREAM] = generator.integers(1 << 63, dtype=np.int64)

    def _place(self, rows: NDArray[np.int64], options: Mapping[str, Any]) -> None:
        """Replace drawn states and targets by given ones."""
        unknown = sorted(set(options) - {"state", "target"})
        if unknown:
            raise ValueError(f"Unknown reset options {unknown}. Known: ['state', 'target'].")
        n_joint, joints = self.arm.n_joint, list(self.arm.joint_index)
        state = options.get("state")
        if state is not None:
            if not isinstance(state, Mapping) or not set(state) <= {"q", "v"}:
                raise ValueError(f"options['state'] must be a dict of 'q' and 'v', got {state!r}.")
            q = _checked("options['state']['q']", state.get("q"), self.arm.n, rows.size)
            v = _checked("options['state']['v']", state.get("v"), self.arm.n, rows.size)
            self.q[rows], self.v[rows] = q, v
        target = options.get("target")
        if target is not None:
            angles = _checked("options['target']", target, n_joint, rows.size)
            centre = slice(int(kernels.CENTRE) * n_joint, int(kernels.CENTRE + 1) * n_joint)
            self.memory[rows, centre] = angles
            self.ref_q[rows[:, None], joints] = angles

    # ---- reports -----------------------------------------------------------------------------

    def joint_target(self) -> Array:
        """(N, n_joint) [rad] joint angles that put the tip on the target, links straight."""
        return self.ref_q[:, list(self.arm.joint_index)]

    def joint_state(self) -> tuple[Array, Array]:
        """(N, n_joint) [rad] and [rad/s]: what ideal encoders read."""
        joints = list(self.arm.joint_index)
        return self.q[:, joints], self.v[:, joints]

    def describe(self, info: Array, flags: NDArray[np.bool_]) -> dict[str, Any]:
        """Info arrays of all environments by name, views of `info` and `flags`."""
        gauges = TERMS.stop + len(self.gauges)
        return {
            "time": info[:, kernels.TIME],
            "tip_error": info[:, kernels.TIP_ERROR],
            "tip_speed": info[:, kernels.TIP_SPEED],
            "deflection": info[:, kernels.MAX_DEFLECTION],
            "tip_deflection": info[:, kernels.TIP_DEFLECTION],
            "root_curvature": info[:, TERMS.stop : gauges],
            "torque": info[:, gauges:],
            "reward_terms": dict(zip(kernels.TERMS, info[:, TERMS].T, strict=True)),
            "settled": flags[:, kernels.SETTLED],
            "diverged": flags[:, kernels.DIVERGED],
            "invalid": flags[:, kernels.INVALID],
        }

    # ---- copies ------------------------------------------------------------------------------

    def _arrays(self) -> dict[str, NDArray[Any]]:
        names = ("q", "v", "torque", "status", "measured", "memory", "counters")
        return {name: getattr(self, name) for name in (*names, "ref_q", "ref_v", "ref_measured")}

    def __getstate__(self) -> dict[str, Any]:
        arrays = {name: array.copy() for name, array in self._arrays().items()}
        return {"arguments": self.arguments, "arrays": arrays}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Core.__init__(self, **state["arguments"])
        for name, array in self._arrays().items():
            array[...] = state["arrays"][name]


class _Share:
    """The rows of one thread: its stepper, and views of the core's arrays."""

    def __init__(self, core: Core, rows: slice) -> None:
        n_env = rows.stop - rows.start
        self.rows, self.whole_batch = rows, n_env == core.n_env
        self.stepper = Stepper(
            core.model,
            n_env,
            dt=core.control_dt / core.substeps,
            substeps=core.substeps,
            integrator=core.integrator,
        )
        for name in ("q", "v", "torque", "status", "measured"):
            setattr(self.stepper, name, getattr(core, name)[rows])
        s = self.stepper
        memory, counters = core.memory[rows], core.counters[rows]
        self.reference = core.ref_q[rows], core.ref_v[rows], core.ref_measured[rows]
        self.moving = core.task.moving
        self.command = (
            core.torque_limit, s.torque, memory, counters, *self.reference[:2], core._whole,
            core._real,
        )  # fmt: skip
        self.judge = (
            np.arange(n_env), False, s.q, s.v, s.torque, s.status, s.measured, memory, counters,
            *self.reference, core._whole, core._real, *core._report,
        )  # fmt: skip

    def step(
        self,
        actions: NDArray[np.float32],
        obs: NDArray[np.float32],
        info: Array,
        flags: NDArray[np.bool_],
    ) -> int:
        """One control step; the number of ended episodes, or -1 for an action that is NaN."""
        if not self.whole_batch:
            actions, obs = actions[self.rows], obs[self.rows]
            info, flags = info[self.rows], flags[self.rows]
        if kernels.command(actions, *self.command) >= 0:
            return -1
        self.stepper.advance()
        if self.moving:
            self.stepper.measure(*self.reference)
        return kernels.judge(*self.judge, obs, info, flags)


def _require_positive(name: str, value: Any, unit: str) -> None:
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not number or not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be positive, got {value!r}. Unit: [{unit}].")


def _require_whole(name: str, value: Any, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}, got {value!r}.")


def _checked(name: str, values: Any, size: int, n_row: int) -> Array:
    """Numbers for each of `n_row` environments, or a sentence; None means zeros."""
    if values is None:
        return np.zeros(size)
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be {size} numbers, got {values!r}.") from None
    if array.shape not in ((size,), (n_row, size)) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be {size} finite numbers, got {values!r}.")
    return array
