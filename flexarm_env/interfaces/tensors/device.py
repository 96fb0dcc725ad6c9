"""The batch of a GPU: state, outputs and random numbers stay in its memory.

A step is one kernel, which restarts ended episodes itself, and nothing waits for it: an action that
is not a number ends its episode as diverged, where the processor's batch raises an error. With
gradients recording and restarts are a kernel each.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch

from dynamics.backends.cuda.kernel_text import (
    ARRAYS,
    DERIVATIVES,
    PULL_BACK,
    RECORD,
    RESTART,
    START,
    STEP,
)
from dynamics.backends.cuda.program import KernelSource, generate
from dynamics.tracing.statements import Derivatives
from flexarm_env import arguments
from flexarm_env.compiled.restart import restarting
from flexarm_env.compiled.termination import FLAGS, LOST
from flexarm_env.core import DIVERGED, Core
from flexarm_env.interfaces.tensors.results import Info, Results, goal_reward, named_info


class Launcher(Protocol):
    """Compiled kernels, as `dynamics.backends.cuda.compiler.Kernels`."""

    def launch(self, name: str, stream: int, count: int, arguments: Sequence[Any]) -> None:
        """Run a kernel on a stream."""


class DeviceProgram:
    """Some kernels of a batch, launched on tensors of a device.

    Parameters
    ----------
    core : the batch of the processor.
    names : of the kernels.
    compiled : function from CUDA C to kernels.

    Attributes
    ----------
    dtype : number type of the state and of info.

    Raises
    ------
    ValueError : what the kernels cannot do, with the remedy.
    """

    def __init__(
        self,
        core: Core,
        device: torch.device,
        names: Collection[str],
        compiled: Callable[[str], Launcher],
    ) -> None:
        self._core, self._device = core, device
        self._source = kernel_source(core, names)
        self._kernels = compiled(self._source.text)
        self.dtype = torch.float64 if core.model.dtype == "float64" else torch.float32
        self._fill_numbers()

    @property
    def stack(self) -> int:
        """Rows of the stack of a recorded step."""
        entry = self._source.program.entry
        assert isinstance(entry, Derivatives)
        return entry.fixed + entry.per_substep * self._core.substeps

    def columns(self, rows: int, dtype: torch.dtype) -> torch.Tensor:
        """New tensor (rows, N)."""
        return torch.empty((rows, self._core.n_env), dtype=dtype, device=self._device)

    def outputs(self) -> dict[str, torch.Tensor]:
        """New tensors for observations, info and flags, as columns."""
        core = self._core
        return {
            "obs": self.columns(core.layout.size, torch.float32),
            "info": self.columns(core.signals.info.total, self.dtype),
            "flags": self.columns(len(FLAGS), torch.bool),
        }

    def run(self, kernel: str, **arrays: torch.Tensor) -> None:
        """Run a kernel on contiguous tensors by name; returns before it has ended."""
        core = self._core
        if self._settings is not core.settings:
            self._fill_numbers()
        addresses = [np.uint64(arrays[name].data_ptr()) for name in ARRAYS[kernel]]
        values = [self._numbers, np.int32(core.n_env), np.int32(core.substeps)]
        self._kernels.launch(kernel, self._stream(), core.n_env, [*addresses, *values])

    def _stream(self) -> int:
        """Stream on which torch works now."""
        if self._device.type != "cuda":
            return 0
        return int(torch.cuda.current_stream(self._device).cuda_stream)

    def _fill_numbers(self) -> None:
        """Numbers that all environments share, by the present settings."""
        core, self._settings = self._core, self._core.settings
        given = {"CONSTANTS": core.constants, "RANGES": core.starts[7].ravel()}
        self._numbers = self._source.numbers(core.dt, given)


class DeviceBatch:
    """A batch whose state is on a device.

    Parameters
    ----------
    core : the batch of the processor, which draws the episodes of a reset.
    device : of all tensors.
    compiled : function from CUDA C to kernels.
    names : of the kernels that are needed.

    Attributes
    ----------
    state : (rows, N) state of all environments.
    """

    def __init__(
        self,
        core: Core,
        device: torch.device,
        compiled: Callable[[str], Launcher],
        names: Collection[str] = (STEP, START),
    ) -> None:
        self._core = core
        self._program = DeviceProgram(core, device, names, compiled)
        self.state = self._program.columns(core.signals.state.total, self._program.dtype).zero_()
        self._streams = torch.zeros(core.n_env, dtype=torch.int64, device=device)
        self._seeds = core.streams.copy()
        self._no_actions = torch.zeros((core.n_env, core.arm.n_torque), device=device)
        close_copies(core)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        close_copies(self._core)

    def reset(self, options: Mapping[str, Any] | None) -> tuple[torch.Tensor, Info]:
        """Start episodes in all environments, drawn on the processor: observations, info."""
        core = self._core
        seeded = core.streams != self._seeds
        core.streams[~seeded] = self._streams.cpu().numpy()[~seeded]
        placed = core.begin(np.arange(core.n_env), options)
        self.state.copy_(torch.from_numpy(core.state[:, : core.n_env]))
        self._streams.copy_(torch.from_numpy(core.streams))
        self._seeds = core.streams.copy()
        obs, _, info, flags = self._run(START, self._no_actions)
        if placed and bool(flags[DIVERGED].any()):
            raise arguments.too_bent(LOST)
        return obs.T, named_info(info, flags, core.signals.info)

    def step(self, actions: torch.Tensor) -> Results:
        """Advance all by one control step; ended episodes restart."""
        obs, last, info, flags = self._run(STEP, actions)
        named = named_info(info, flags, self._core.signals.info)
        goals = self._core.layout.goal
        reward = goal_reward(last.T, goals).to(info.dtype) if goals else info[0]
        return Results(obs.T, last.T, reward, flags[0], flags[1], named)

    def padded(self) -> torch.Tensor:
        """Copy of the state."""
        return self.state.clone()

    def restarted(
        self, after: torch.Tensor, flags: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """State and first observations, of ended episodes, after a step to the state `after`."""
        self.state.copy_(after)
        obs = self._program.outputs()["obs"]
        self._program.run(RESTART, state=self.state, streams=self._streams, obs=obs, flags=flags)
        return self.state, obs.T

    def _run(self, kernel: str, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Run a kernel on new output tensors: observations, last ones, info, flags, as columns."""
        new = self._program.outputs()
        last = torch.empty_like(new["obs"])
        given = {"state": self.state, "streams": self._streams, "actions": actions}
        self._program.run(kernel, **given, final_obs=last, **new)
        return new["obs"], last, new["info"], new["flags"]


class DeviceDerivatives:
    """Control steps and their derivatives, as `flexarm_env.derivatives`, on tensors of a device."""

    def __init__(
        self, core: Core, device: torch.device, compiled: Callable[[str], Launcher]
    ) -> None:
        self._program = DeviceProgram(core, device, (RECORD, PULL_BACK), compiled)

    def record(self, state: torch.Tensor, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """State after a control step, observations, info, flags, and the stack."""
        after, new = state.clone(), self._program.outputs()
        stack = self._program.columns(self._program.stack, self._program.dtype)
        self._program.run(RECORD, state=after, actions=actions, stack=stack, **new)
        return after, new["obs"].T, new["info"], new["flags"], stack

    def pull_back(
        self,
        lost: torch.Tensor,
        state: torch.Tensor,
        actions: torch.Tensor,
        stack: torch.Tensor,
        after: torch.Tensor,
        obs: torch.Tensor,
        info: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Cotangents of the state before a recorded step and of its actions; zero where `lost`.

        `after`, `obs` and `info` are cotangents of what `record` gave.
        """
        before, by = after.clone(memory_format=torch.contiguous_format), torch.zeros_like(actions)
        mirrors = {"obs_mirror": obs.T.contiguous(), "info_mirror": info.contiguous()}
        mirrors |= {"state_mirror": before, "actions_mirror": by}
        self._program.run(PULL_BACK, state=state, actions=actions, stack=stack, **mirrors)
        return before.masked_fill_(lost, 0.0), by.masked_fill_(lost[:, None], 0.0)


def close_copies(core: Core) -> None:
    """Make the states of a core, which are not those that tensors hold, read-only."""
    for copied in (core.q, core.v, core.parameters):
        copied.flags.writeable = False


def kernel_source(core: Core, names: Collection[str] = (STEP, START)) -> KernelSource:
    """Kernels of a batch: of its step, which restarts ended episodes, or of its derivatives."""
    added = core.signals.addition
    if not DERIVATIVES.issuperset(names):
        added = restarting(core.signals, core.starts)
    return generate(core.model.traced, core.model.dtype, core.integrator, added, names)
