"""The batch of a GPU: state, outputs and random numbers stay in its memory.

A step is one kernel, which restarts ended episodes itself, and nothing waits for it: an action that
is not a number ends its episode as diverged, where the processor's batch raises an error.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch

from dynamics.backends.cuda.kernel_text import START, STEP
from dynamics.backends.cuda.program import KernelSource, generate
from flexarm_env import arguments
from flexarm_env.compiled.restart import restarting
from flexarm_env.compiled.termination import FLAGS, LOST
from flexarm_env.core import DIVERGED, Core
from flexarm_env.interfaces.tensors.results import Info, Results, goal_reward, named_info


class Launcher(Protocol):
    """Compiled kernels, as `dynamics.backends.cuda.compiler.Kernels`."""

    def launch(self, name: str, stream: int, count: int, arguments: Sequence[Any]) -> None:
        """Run a kernel on a stream."""


class DeviceBatch:
    """Kernels of a batch, and its state on the device.

    Parameters
    ----------
    core : the batch of the processor, which draws the episodes of a reset.
    device : of all tensors.
    compiled : function from CUDA C to kernels.

    Attributes
    ----------
    state : (rows, N) state of all environments.

    Raises
    ------
    ValueError : what the kernels cannot do, with the remedy.
    """

    def __init__(
        self, core: Core, device: torch.device, compiled: Callable[[str], Launcher]
    ) -> None:
        self._core, self._device = core, device
        self._source = kernel_source(core)
        self._kernels = compiled(self._source.text)
        self._dtype = torch.float64 if core.model.dtype == "float64" else torch.float32
        self.state = torch.zeros(
            (core.signals.state.total, core.n_env), dtype=self._dtype, device=device
        )
        self._streams = torch.zeros(core.n_env, dtype=torch.int64, device=device)
        self._seeds = core.streams.copy()
        self._no_actions = torch.zeros((core.n_env, core.arm.n_torque), device=device)
        self._fill_numbers()

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
        reward = goal_reward(last.T, goals).to(self._dtype) if goals else info[0]
        return Results(obs.T, last.T, reward, flags[0], flags[1], named)

    def _run(self, kernel: str, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Run a kernel on new output tensors: observations, last ones, info, flags, as columns."""
        core, n = self._core, self._core.n_env
        if self._settings is not core.settings:
            self._fill_numbers()

        def columns(rows: int, dtype: torch.dtype) -> torch.Tensor:
            return torch.empty((rows, n), dtype=dtype, device=self._device)

        obs, last = (columns(core.layout.size, torch.float32) for _ in range(2))
        info, flags = columns(core.signals.info.total, self._dtype), columns(len(FLAGS), torch.bool)
        given = (self.state, self._streams, actions, obs, last, info, flags)
        addresses = [np.uint64(tensor.data_ptr()) for tensor in given]
        values = [self._numbers, np.int32(n), np.int32(core.substeps)]
        self._kernels.launch(kernel, self._stream(), n, [*addresses, *values])
        return obs, last, info, flags

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


def kernel_source(core: Core) -> KernelSource:
    """Kernels that step a batch and restart its ended episodes."""
    added = restarting(core.signals, core.starts)
    return generate(core.model.traced, core.model.dtype, core.integrator, added)
