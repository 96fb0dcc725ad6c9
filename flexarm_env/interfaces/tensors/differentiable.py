"""Batches whose observations, rewards and info carry gradients."""

from collections.abc import Callable, Mapping
from typing import Any

import torch

from dynamics.backends.cuda.kernel_text import RESTART, START
from flexarm_env.core import DIVERGED, Core
from flexarm_env.interfaces.tensors.device import (
    DeviceBatch,
    DeviceDerivatives,
    Launcher,
    close_copies,
)
from flexarm_env.interfaces.tensors.host import HostBatch, HostDerivatives
from flexarm_env.interfaces.tensors.results import Info, Results, named_info, ordinary
from flexarm_env.interfaces.vector import FlexArmVectorEnv


class DifferentiableBatch:
    """Steps that torch can differentiate by the actions and by the state.

    Gradients stop where an episode starts and where a simulation diverges. The state of every step
    and a stack (`Derivatives.record`) live as long as the graph; if `recomputed`, the state alone.

    Parameters
    ----------
    core : the batch of the processor.
    batch : starts and restarts episodes.
    derivatives : steps, on the memory of `batch`.
    recomputed : whether the way back steps again, in place of keeping the stacks.
    """

    def __init__(
        self,
        core: Core,
        batch: HostBatch | DeviceBatch,
        derivatives: HostDerivatives | DeviceDerivatives,
        recomputed: bool,
    ) -> None:
        self._batch, self._derivatives, self._recomputed = batch, derivatives, recomputed
        self._core = core
        self._n, self._names = core.n_env, core.signals.info
        self._padded = batch.padded()
        self.detach()
        close_copies(self._core)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_padded": self._padded.detach()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.detach()
        close_copies(self._core)

    @property
    def state(self) -> torch.Tensor:
        """(rows, N) state of all environments."""
        return self._padded[:, : self._n]

    @ordinary()
    def reset(self, options: Mapping[str, Any] | None) -> tuple[torch.Tensor, Info]:
        """Start episodes in all environments, without gradients: observations, info."""
        result = self._batch.reset(options)
        self._padded = self._batch.padded()
        self.detach()
        return result

    @ordinary()
    def detach(self) -> torch.Tensor:
        """Cut the graph at the present state (rows, M), which is returned, a leaf."""
        self._padded = self._padded.detach().requires_grad_()
        return self._padded

    @ordinary()
    def step(self, actions: torch.Tensor) -> Results:
        """Advance all by one control step; ended episodes restart."""
        n, given = self._n, actions.clone() if actions.is_inference() else actions
        after, obs, info, flags = _Step.apply(
            self._derivatives, self._core, self._recomputed, self._padded, given
        )
        last, begun = obs, self._batch.restarted(after.detach(), flags)
        if begun is not None:
            ended = flags[0] | flags[1]
            after = torch.where(ended, begun[0], after)
            obs = torch.where(ended[:n, None], begun[1], obs)
        self._padded = after
        named = named_info(info[:, :n], flags[:, :n], self._names)
        return Results(obs, last, info[0, :n], flags[0, :n], flags[1, :n], named)


def differentiable_on_host(envs: FlexArmVectorEnv, recomputed: bool) -> DifferentiableBatch:
    """Batch of the processor."""
    return DifferentiableBatch(envs.core, HostBatch(envs), HostDerivatives(envs.core), recomputed)


def differentiable_on_device(
    core: Core, device: torch.device, compiled: Callable[[str], Launcher], recomputed: bool
) -> DifferentiableBatch:
    """Batch of a device; the first arguments are those of `DeviceBatch`."""
    batch = DeviceBatch(core, device, compiled, (START, RESTART))
    return DifferentiableBatch(core, batch, DeviceDerivatives(core, device, compiled), recomputed)


class _Step(torch.autograd.Function):
    """A control step: (state, actions) to the state after it, observations, info and flags."""

    @staticmethod
    def forward(
        ctx: Any,
        derivatives: HostDerivatives | DeviceDerivatives,
        core: Core,
        recomputed: bool,
        state: torch.Tensor,
        actions: torch.Tensor,
    ) -> tuple[torch.Tensor, ...]:
        """Step and keep what the way back needs."""
        state, actions = state.detach(), actions.detach()
        after, obs, info, flags, stack = derivatives.record(state, actions)
        ctx.derivatives, ctx.core, ctx.numbers = derivatives, core, _numbers(core)
        ctx.save_for_backward(state, actions, flags, *(() if recomputed else (stack,)))
        ctx.mark_non_differentiable(flags)
        return after, obs, info, flags

    @staticmethod
    def backward(ctx: Any, *bars: torch.Tensor) -> tuple[Any, ...]:
        """Cotangents of the state and of the actions; zero where the simulation diverged."""
        if torch.is_grad_enabled():  # create_graph=True
            raise RuntimeError(
                "A step has no second derivatives: take its gradients with create_graph=False, and "
                "for a Hessian differences of them."
            )
        if _numbers(ctx.core) != ctx.numbers:
            raise RuntimeError(
                "The reward or the integration step of the batch changed after this step was "
                "taken; take its gradients before you set reward or randomize."
            )
        state, actions, flags, *stack = ctx.saved_tensors
        if not stack:
            *_, recorded = ctx.derivatives.record(state, actions)
            stack = [recorded]
        given = (state, actions, *stack, *bars[:3])
        return None, None, None, *ctx.derivatives.pull_back(flags[DIVERGED], *given)


def _numbers(core: Core) -> tuple[dict[str, float], int]:
    """Weights of the reward and substeps: changeable settings on which derivatives depend."""
    return core.settings.weights, core.substeps
