"""Plant and task for N environments: what the single, the batch and the SB3 environment share."""

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np
from dynamics import Arm, load_arm
from dynamics.integrators import INTEGRATORS
from dynamics.model import Model, compile_arm
from dynamics.stepper import Stepper
from numpy.typing import NDArray

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
        self.stepper = Stepper(
            self.model,
            self.n_env,
            dt=self.control_dt / self.substeps,
            substeps=self.substeps,
            integrator=self.integrator,
            threads=self.threads,
        )
        self._allocate(weights, float(deflection_limit), int(max_steps))

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

    def _allocate(self, weights: dict[str, float], deflection_limit: float, max_steps: int) -> None:
        arm, model, n_env = self.arm, self.model, self.n_env
        first = {name: part.start for name, part in model.measurements.items()}
        self.gauges = curvature_columns(arm)
        whole = [arm.n_joint, arm.n, int(self.task.moving), max_steps, len(self.gauges)]
        whole += [first[k] for k in ("tip", "tip_velocity", "rigid_tip", "deflection", "slope")]
        whole += [*arm.joint_index, *(first["curvature"] + k for k in self.gauges)]
        self._whole = np.array(whole, dtype=np.int64)
        mount = [x for row in arm.links[0].joint.rotation for x in row]
        self._real = np.array(
            [
                self.control_dt, arm.reach, deflection_limit,
                SLOPE_PER_DEFLECTION * deflection_limit, arm.reach * self.rate_scale,
                self.rate_scale, MOVE, self.move_time, *mount,
                *(weights.get(name, 0.0) for name in kernels.TERMS),
            ]
        )  # fmt: skip
        self._table = self.layout.table
        self._start = (
            np.int64(self.task.code),
            self.task.ranges(self.move_time),
            np.array(self.physics.home),
            np.array(self.physics.modal_scale),
            np.array(self.physics.modal_rate),
        )
        self.memory = np.zeros((n_env, kernels.WIDTH * arm.n_joint))
        self.counters = np.zeros((n_env, 2), dtype=np.int64)
        self.ref_q, self.ref_v = np.zeros((n_env, arm.n)), np.zeros((n_env, arm.n))
        self.ref_measured = np.zeros((n_env, model.n_measure))
        stepper = self.stepper
        self._state = (
            stepper.q, stepper.v, stepper.torque, stepper.status, stepper.measured, self.memory,
            self.counters, self.ref_q, self.ref_v, self.ref_measured, self._whole, self._real,
            self._table, self.layout.n_signal,
        )  # fmt: skip
        self._command = (
            self.torque_limit, stepper.torque, self.memory, self.counters, self.ref_q, self.ref_v,
            self._whole, self._real,
        )  # fmt: skip
        self._judge = kernels.judge if self.threads == 1 else kernels.judge_parallel
        self._moving = self.task.moving
        self.n_obs = self._table.shape[1]
        self.n_info = kernels.FIRST_TERM + kernels.N_TERM + len(self.gauges) + arm.n_joint

    # ---- stepping ----------------------------------------------------------------------------

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], int]:
        """One control step of all; new arrays (N, n_obs), (n_info, N), (n_flag, N), ended count."""
        bad = kernels.command(actions, *self._command)
        if bad >= 0:
            raise ValueError(
                f"Actions must be numbers in [-1, 1], got NaN for environment {bad}: "
                f"{actions[bad].tolist()}."
            )
        self.stepper.advance()
        if self._moving:
            self.stepper.measure(self.ref_q, self.ref_v, self.ref_measured)
        obs = np.empty((self.n_env, self.n_obs), np.float32)
        info = np.empty((self.n_info, self.n_env))
        flags = np.empty((kernels.N_FLAG, self.n_env), np.bool_)
        return obs, info, flags, self._judge(*self._state, obs, info, flags)

    def restart(
        self,
        rows: NDArray[np.int64],
        obs: NDArray[np.float32],
        info: Array,
        flags: NDArray[np.bool_],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Start new episodes in the environments `rows`; their entries of obs, info, flags."""
        s = self.stepper
        kernels.begin(
            rows, *self._start, s.q, s.v, self.memory, self.counters, self.ref_q, self.ref_v,
            self._whole, self._real,
        )  # fmt: skip
        if options:
            self._place(rows, options)
        for q, v, measured in (
            (s.q, s.v, s.measured),
            (self.ref_q, self.ref_v, self.ref_measured),
        ):
            out = np.empty((rows.size, measured.shape[1]))
            s.measure(q[rows], v[rows], out)
            measured[rows] = out
        kernels.look(rows, *self._state, obs, info, flags)

    def reset(
        self, rows: NDArray[np.int64], options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_]]:
        """Start new episodes in `rows` and report on all; rows not started are left undefined."""
        obs = np.zeros((self.n_env, self.n_obs), np.float32)
        info = np.zeros((self.n_info, self.n_env))
        flags = np.zeros((kernels.N_FLAG, self.n_env), np.bool_)
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
                raise ValueError(f"options['state'] must be a dict with 'q' and 'v', got {state!r}.")
            q = _checked("options['state']['q']", state.get("q"), self.arm.n, rows.size)
            v = _checked("options['state']['v']", state.get("v"), self.arm.n, rows.size)
            self.stepper.q[rows], self.stepper.v[rows] = q, v
        target = options.get("target")
        if target is not None:
            angles = _checked("options['target']", target, n_joint, rows.size)
            centre = slice(kernels.CENTRE * n_joint, (kernels.CENTRE + 1) * n_joint)
            self.memory[rows, centre] = angles
            self.ref_q[rows[:, None], joints] = angles

    # ---- reports -----------------------------------------------------------------------------

    def joint_target(self) -> Array:
        """(N, n_joint) [rad] joint angles that put the tip on the target, links straight."""
        return self.ref_q[:, list(self.arm.joint_index)]

    def joint_state(self) -> tuple[Array, Array]:
        """(N, n_joint) [rad] and [rad/s]: what ideal encoders read."""
        joints = list(self.arm.joint_index)
        return self.stepper.q[:, joints], self.stepper.v[:, joints]

    def describe(self, info: Array, flags: NDArray[np.bool_]) -> dict[str, Any]:
        """Info arrays of all environments by name, views of `info` and `flags`."""
        terms = kernels.FIRST_TERM + kernels.N_TERM
        gauges = terms + len(self.gauges)
        return {
            "time": info[kernels.TIME],
            "tip_error": info[kernels.TIP_ERROR],
            "tip_speed": info[kernels.TIP_SPEED],
            "deflection": info[kernels.MAX_DEFLECTION],
            "tip_deflection": info[kernels.TIP_DEFLECTION],
            "root_curvature": info[terms:gauges].T,
            "torque": info[gauges:].T,
            "reward_terms": dict(
                zip(kernels.TERMS, info[kernels.FIRST_TERM : terms], strict=True)
            ),
            "settled": flags[kernels.SETTLED],
            "diverged": flags[kernels.DIVERGED],
            "invalid": flags[kernels.INVALID],
        }

    # ---- copies ------------------------------------------------------------------------------

    def _arrays(self) -> dict[str, Array]:
        s = self.stepper
        return {
            "q": s.q, "v": s.v, "torque": s.torque, "status": s.status, "measured": s.measured,
            "memory": self.memory, "counters": self.counters, "ref_q": self.ref_q,
            "ref_v": self.ref_v, "ref_measured": self.ref_measured,
        }  # fmt: skip

    def __getstate__(self) -> dict[str, Any]:
        arrays = {name: array.copy() for name, array in self._arrays().items()}
        return {"arguments": self.arguments, "arrays": arrays}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Core.__init__(self, **state["arguments"])
        for name, array in self._arrays().items():
            array[...] = state["arrays"][name]


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
