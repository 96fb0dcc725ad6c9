"""Derivatives of the control steps of a batch: of all that a step stores by all that it loads."""

from typing import Any, NamedTuple

import numpy as np

from dynamics.integrators.table import INTEGRATORS
from dynamics.runtime.jit import aligned_zeros
from dynamics.types import AnyArray, Array
from flexarm_env.compiled.settings import Settings
from flexarm_env.compiled.termination import FLAGS
from flexarm_env.core import Core

FEWER = 4  # times fewer lanes than in a step: numbers of an adjoint live long, and must fit a cache


class Recorded(NamedTuple):
    """A control step of N environments, from which `Derivatives.pull_back` goes back."""

    before: Array  # (rows, width) state before it
    actions: AnyArray  # (N, n_torque)
    after: Array  # (rows, width) state
    obs: AnyArray  # (N, size)
    info: Array  # (rows of info, width)
    flags: AnyArray  # (len(FLAGS), width) bool
    stack: Array  # (rows, width) numbers that the derivatives need


class Derivatives:
    """Control steps of the environments of `core`, and their derivatives.

    Arrays have a column per environment, actions and observations a row. They are padded to whole
    blocks as `core.state`. Rows of the state are named by `core.signals.state`: coordinates, rates,
    what actuators and sensors remember, targets, free parameters.

    Raises
    ------
    ValueError : the integrator has no derivatives.
    """

    def __init__(self, core: Core) -> None:
        if INTEGRATORS[core.integrator].aid == "jacobian":
            raise ValueError(
                f"integrator {core.integrator!r} has no derivatives, since it is compiled as "
                "loops; leave it out or take 'numerov'."
            )
        self._core = core
        lanes = max(1, core.model.lanes // FEWER) if core.n_env > 1 else 1
        self._program = core.model.program(
            lanes, core.integrator, core.signals.addition, derivatives=True
        )
        fixed, per_substep = self._program.STACK
        self._depth = fixed + per_substep * core.substeps
        self._workspaces = [core.model.workspace(self._program) for _ in core.workspaces]
        self._settings: Settings | None = None  # by which the workspaces are filled

    def record(self, state: Array, actions: AnyArray) -> Recorded:
        """A control step from `state`, which is left as it is."""
        core, dtype = self._core, self._core.model.dtype
        after = aligned_zeros(state.shape, dtype)
        after[...] = state
        made = Recorded(
            state,
            actions,
            after,
            np.zeros((core.n_env, core.layout.size), actions.dtype),
            aligned_zeros((core.signals.info.total, state.shape[1]), dtype),
            aligned_zeros((len(FLAGS), state.shape[1]), np.bool_),
            aligned_zeros((self._depth, state.shape[1]), dtype),
        )
        stored = made.obs, made.info, made.flags, made.stack
        self._run(self._program.record, actions, after, *stored)
        return made

    def pull_back(
        self, step: Recorded, after: Array, obs: AnyArray, info: Array
    ) -> tuple[Array, Any]:
        """Cotangents of the state before a step and of its actions.

        Parameters
        ----------
        step : of `record`.
        after, obs, info : cotangents of the arrays of these names; they are left as they are.
        """
        before, actions = aligned_zeros(after.shape, after.dtype), np.zeros_like(step.actions)
        before[...] = after
        mirrors = actions, before, obs, info
        self._run(self._program.pull_back, step.actions, step.before, step.stack, *mirrors)
        return before, actions

    def push_forward(self, state: Array, actions: AnyArray, along: Array, by: AnyArray) -> Recorded:
        """Derivatives of a step's results along a direction of the state and of the actions.

        Parameters
        ----------
        state, actions : before the step.
        along, by : (rows, width) direction of the state, (N, n_torque) direction of the actions.

        Returns
        -------
        `Recorded` whose `after`, `obs` and `info` are derivatives.
        """
        core, dtype = self._core, self._core.model.dtype
        after, moved = aligned_zeros(state.shape, dtype), aligned_zeros(state.shape, dtype)
        after[...], moved[...] = state, along
        obs, obs_dot = (np.zeros((core.n_env, core.layout.size), actions.dtype) for _ in range(2))
        info, info_dot = (
            aligned_zeros((core.signals.info.total, state.shape[1]), dtype) for _ in range(2)
        )
        flags = aligned_zeros((len(FLAGS), state.shape[1]), np.bool_)
        mirrors = by, moved, obs_dot, info_dot
        self._run(self._program.push_forward, actions, after, obs, info, flags, *mirrors)
        return Recorded(state, actions, moved, obs_dot, info_dot, flags, moved[:0])

    def _run(self, entry: Any, actions: AnyArray, state: Array, *arrays: AnyArray) -> None:
        """Run an entry point on all environments."""
        core, rows = self._core, self._core.shares.copy()
        if self._settings is not core.settings:
            self._settings = core.settings
            for w in self._workspaces:
                core.fill_constants(w, self._program)

        def chunks(thread: int) -> None:
            entry(
                rows,
                thread,
                core.substeps,
                core.dt,
                actions,
                state,
                self._workspaces[thread],
                *arrays,
            )

        core.pool.run(chunks)
