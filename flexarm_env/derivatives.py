"""Derivatives of the control steps of a batch: of all that a step stores by all that it loads."""

from typing import Any, NamedTuple

import numpy as np

from dynamics.integrators.table import INTEGRATORS
from dynamics.runtime.recycled import Recycled
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


class Along(NamedTuple):
    """Derivatives of what a step gives along a direction; arrays as those of `Recorded`."""

    after: Array
    obs: AnyArray
    info: Array


class Derivatives:
    """Control steps of the environments of `core`, and their derivatives.

    Arrays have a column per environment, actions and observations a row. They are padded to whole
    blocks as `core.state`; views in any order of memory are taken. Rows of the state are named by
    `core.signals.state`: coordinates, rates, what actuators and sensors remember, targets, free
    parameters.

    Raises
    ------
    ValueError : the integrator has no derivatives, or an array has another shape, or numbers that
        are not real.
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
        self._workspaces = [core.model.workspace(self._program) for _ in core.workspaces]
        self._settings: Settings | None = None  # by which the workspaces are filled
        self._memory = Recycled()

    def __reduce__(self) -> tuple[Any, ...]:
        return Derivatives, (self._core,)

    def record(self, state: Array, actions: AnyArray) -> Recorded:
        """A control step from `state`, which is left as it is."""
        state, actions = self._taken(state=state, actions=actions)
        after, stored = self._memory.copy(state), self._stored(state, actions)
        stack = self._memory.array(self._shapes()["stack"], state.dtype)
        self._run(self._program.record, actions, after, *stored, stack)
        return Recorded(state, actions, after, *stored, stack)

    def pull_back(
        self,
        state: Array,
        actions: AnyArray,
        stack: Array,
        after: Array,
        obs: AnyArray,
        info: Array,
    ) -> tuple[Array, Any]:
        """Cotangents of the state before a step and of its actions.

        Parameters
        ----------
        state, actions, stack : before the step, and what `record` kept of it.
        after, obs, info : cotangents of what `record` gave; they are left as they are.
        """
        state, actions, stack, after, obs, info = self._taken(
            state=state, actions=actions, stack=stack, after=after, obs=obs, info=info
        )
        before = self._memory.copy(after)
        by = self._memory.array(actions.shape, actions.dtype)
        self._run(self._program.pull_back, actions, state, stack, by, before, obs, info)
        return before, by

    def push_forward(self, state: Array, actions: AnyArray, along: Array, by: AnyArray) -> Along:
        """Derivatives of a step's results along a direction of the state and of the actions.

        Parameters
        ----------
        state, actions : before the step.
        along, by : (rows, width) direction of the state, (N, n_torque) direction of the actions.
        """
        state, actions, along, by = self._taken(state=state, actions=actions, along=along, by=by)
        moved, (obs, info, _) = self._memory.copy(along), self._stored(state, actions)
        given = (self._memory.copy(state), *self._stored(state, actions), by, moved, obs, info)
        self._run(self._program.push_forward, actions, *given)
        return Along(moved, obs, info)

    def _taken(self, **given: AnyArray) -> list[AnyArray]:
        """Arrays in one piece, in single or double precision, as compiled code reads them.

        Other shapes are refused: it would go past their ends.
        """
        shapes, taken = self._shapes(), []
        for name, values in given.items():
            array, shape = np.asarray(values), shapes[name]
            if array.dtype.kind not in "biuf":
                raise ValueError(f"{name} must hold real numbers, got dtype {array.dtype}.")
            if array.shape != shape:
                padded = "" if name in ("actions", "by", "obs") else ", padded as core.state"
                raise ValueError(f"{name} must have shape {shape}{padded}, got {array.shape}.")
            single = np.can_cast(array.dtype, np.float32)
            taken.append(np.ascontiguousarray(array, np.float32 if single else np.float64))
        return taken

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of all arrays by name."""
        core, (fixed, per_substep) = self._core, self._program.STACK
        state, width = core.state.shape, core.state.shape[1]
        acting = (core.n_env, core.arm.n_torque)
        return {
            "state": state, "after": state, "along": state, "actions": acting, "by": acting,
            "stack": (fixed + per_substep * core.substeps, width),
            "obs": (core.n_env, core.layout.size),
            "info": (core.signals.info.total, width),
            "flags": (len(FLAGS), width),
        }  # fmt: skip

    def _stored(self, state: Array, actions: AnyArray) -> tuple[AnyArray, Array, AnyArray]:
        """New arrays of observations, info and flags."""
        shapes = self._shapes()
        return (
            self._memory.array(shapes["obs"], actions.dtype),
            self._memory.array(shapes["info"], state.dtype),
            self._memory.array(shapes["flags"], np.bool_),
        )

    def _run(self, entry: Any, actions: AnyArray, state: Array, *arrays: AnyArray) -> None:
        """Run an entry point on all environments."""
        core, rows = self._core, self._core.shares.copy()
        if self._settings is not core.settings:
            self._settings = core.settings
            for w in self._workspaces:
                core.fill_constants(w, self._program)

        given = core.substeps, core.dt, actions, state
        core.pool.run(lambda k: entry(rows, k, *given, self._workspaces[k], *arrays))
