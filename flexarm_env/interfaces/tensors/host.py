"""The batch of the processor and its derivatives, as tensors on its memory."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from flexarm_env import arguments
from flexarm_env.compiled.outputs import BatchOutputs
from flexarm_env.core import Core
from flexarm_env.derivatives import Derivatives
from flexarm_env.interfaces.tensors.results import Info, Results
from flexarm_env.interfaces.vector import FlexArmVectorEnv


class HostBatch:
    """Steps of a Gymnasium batch, whose arrays become tensors without a copy."""

    def __init__(self, envs: FlexArmVectorEnv) -> None:
        self._envs, self._core = envs, envs.core
        self._all = np.arange(envs.num_envs)

    @property
    def state(self) -> torch.Tensor:
        """(rows, N) state of all environments; of a copied batch, that of the copy."""
        return torch.from_numpy(self._core.state)[:, : self._core.n_env]

    def reset(self, options: Mapping[str, Any] | None) -> tuple[torch.Tensor, Info]:
        """Start episodes in all environments: observations, info."""
        out = self._core.reset(self._all, options)
        return torch.from_numpy(out.obs), _info(out)

    def step(self, actions: torch.Tensor) -> Results:
        """Advance all by one control step; ended episodes restart."""
        out, ended = self._core.step(actions.numpy())
        reward = torch.from_numpy(self._envs.rewarded(out))
        terminated, truncated = map(torch.from_numpy, (out.terminated, out.truncated))
        obs, info = torch.from_numpy(out.obs), _info(out)
        last = obs.clone() if ended else obs
        if ended:
            self._restart(np.flatnonzero(out.terminated | out.truncated), out)
        return Results(obs, last, reward, terminated, truncated, info)

    def padded(self) -> torch.Tensor:
        """Copy of the state (rows, M), M >= N, with unused columns."""
        return torch.from_numpy(self._core.state.copy())

    def restarted(
        self, after: torch.Tensor, flags: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor] | None:
        """State and first observations, of ended episodes, after a step to the state `after`.

        None: no episode has ended.
        """
        core = self._core
        core.state[...] = after.numpy()
        rows = np.flatnonzero((flags[0] | flags[1])[: core.n_env].numpy())
        if not rows.size:
            return None
        fresh = core.outputs()
        core.restart(rows, fresh)
        return torch.from_numpy(core.state), torch.from_numpy(fresh.obs)

    def _restart(self, rows: Any, out: BatchOutputs) -> None:
        """Start new episodes in `rows`; of their outputs only observations are replaced."""
        fresh = self._core.outputs()  # another set: tensors of this one are in use
        self._core.restart(rows, fresh)
        out.obs[rows] = fresh.obs[rows]


class HostDerivatives:
    """`flexarm_env.derivatives.Derivatives` on tensors."""

    def __init__(self, core: Core) -> None:
        self._derivatives = Derivatives(core)

    def record(self, state: torch.Tensor, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """State after a control step, observations, info, flags, and the stack."""
        if not bool(torch.isfinite(actions).all()):
            raise arguments.not_finite(actions.numpy())
        step = self._derivatives.record(state.numpy(), actions.numpy())
        found = (step.after, step.obs, step.info, step.flags, step.stack)
        return tuple(map(torch.from_numpy, found))

    def pull_back(
        self, lost: torch.Tensor, *given: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Cotangents of the state before a recorded step and of its actions; zero where `lost`."""
        before, by = self._derivatives.pull_back(*(x.contiguous().numpy() for x in given))
        rows = lost.numpy()
        if rows.any():
            before[:, rows] = 0.0
            by[rows[: len(by)]] = 0.0
        return torch.from_numpy(before), torch.from_numpy(by)


def _info(out: BatchOutputs) -> Info:
    """Info as tensors on the same memory."""
    named = out.described()
    terms = named.pop("reward_terms")
    info: Info = {name: torch.from_numpy(array) for name, array in named.items()}
    info["reward_terms"] = {name: torch.from_numpy(array) for name, array in terms.items()}
    return info
