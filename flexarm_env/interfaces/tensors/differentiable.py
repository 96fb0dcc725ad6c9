"""The batch of the processor, whose observations, rewards and info carry gradients."""

from typing import Any

import numpy as np
import torch

from flexarm_env.core import DIVERGED
from flexarm_env.derivatives import Derivatives, Recorded
from flexarm_env.interfaces.tensors.host import HostBatch
from flexarm_env.interfaces.tensors.results import Results, named_info
from flexarm_env.interfaces.vector import FlexArmVectorEnv


class DifferentiableBatch(HostBatch):
    """Steps that torch can differentiate by the actions and by the state.

    Gradients stop where an episode starts and where a simulation diverges. The state of every step
    and a stack (`Derivatives.record`) live as long as the graph.
    """

    def __init__(self, envs: FlexArmVectorEnv) -> None:
        super().__init__(envs)
        self._names = envs.core.signals.info
        self.derivatives = Derivatives(envs.core)
        self._padded = torch.from_numpy(envs.core.state)  # with unused columns

    def reset(self, options: Any) -> Any:
        """Start episodes in all environments, without gradients: observations, info."""
        result = super().reset(options)
        self.detach(torch.from_numpy(self._core.state.copy()))
        return result

    def detach(self, state: torch.Tensor | None = None) -> torch.Tensor:
        """Cut the graph, at `state` (rows, width) or the present one; returns it, a leaf."""
        self._padded = (self._padded if state is None else state).detach().requires_grad_()
        self.state = self._padded[:, : self._core.n_env]
        return self._padded

    def step(self, actions: torch.Tensor) -> Results:
        """Advance all by one control step; ended episodes restart."""
        if not bool(torch.isfinite(actions).all()):
            super().step(actions.detach())  # refuses them
        core, n = self._core, self._core.n_env
        after, obs, info, flags = _Step.apply(self.derivatives, self._padded, actions)
        core.state[...] = after.detach().numpy()
        last, ended = obs, flags[0, :n] | flags[1, :n]
        if ended.any():
            rows = np.flatnonzero(ended.numpy())
            fresh = core.outputs()
            core.restart(rows, fresh)
            obs = torch.where(ended[:, None], torch.from_numpy(fresh.obs.copy()), obs)
            columns = torch.zeros(after.shape[1], dtype=torch.bool)
            columns[:n] = ended
            after = torch.where(columns, torch.from_numpy(core.state.copy()), after)
        self._padded, self.state = after, after[:, :n]
        named = named_info(info[:, :n], flags[:, :n], self._names)
        return Results(obs, last, info[0, :n], flags[0, :n], flags[1, :n], named)


class _Step(torch.autograd.Function):
    """A control step: (state, actions) to the state after it, observations, info and flags."""

    @staticmethod
    def forward(
        ctx: Any, derivatives: Derivatives, state: torch.Tensor, actions: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        """Step and keep what the way back needs."""
        step = derivatives.record(state.detach().numpy(), actions.detach().numpy())
        ctx.derivatives, ctx.step = derivatives, step
        after, obs, info, flags = map(
            torch.from_numpy, (step.after, step.obs, step.info, step.flags)
        )
        ctx.mark_non_differentiable(flags)
        return after, obs, info, flags

    @staticmethod
    def backward(ctx: Any, *bars: torch.Tensor) -> tuple[None, torch.Tensor, torch.Tensor]:
        """Cotangents of the state and of the actions; zero where the simulation diverged."""
        step: Recorded = ctx.step
        after, obs, info = (x.contiguous().numpy() for x in bars[:3])
        before, actions = ctx.derivatives.pull_back(step, after, obs, info)
        lost = step.flags[DIVERGED]
        if lost.any():
            before[:, lost] = 0.0
            actions[lost[: len(actions)]] = 0.0
        return None, torch.from_numpy(before), torch.from_numpy(actions)
