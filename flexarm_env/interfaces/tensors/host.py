"""The batch of the processor, as tensors on its memory."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from flexarm_env.compiled.outputs import BatchOutputs
from flexarm_env.interfaces.tensors.results import Info, Results
from flexarm_env.interfaces.vector import FlexArmVectorEnv


class HostBatch:
    """Steps of a Gymnasium batch, whose arrays become tensors without a copy.

    Attributes
    ----------
    state : (rows, N) state of all environments.
    """

    def __init__(self, envs: FlexArmVectorEnv) -> None:
        self._envs, self._core = envs, envs.core
        self.state = torch.from_numpy(envs.core.state)[:, : envs.num_envs]
        self._all = np.arange(envs.num_envs)

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

    def _restart(self, rows: Any, out: BatchOutputs) -> None:
        """Start new episodes in `rows`; of their outputs only observations are replaced."""
        fresh = self._core.outputs()  # another set: tensors of this one are in use
        self._core.restart(rows, fresh)
        out.obs[rows] = fresh.obs[rows]


def _info(out: BatchOutputs) -> Info:
    """Info as tensors on the same memory."""
    named = out.described()
    terms = named.pop("reward_terms")
    info: Info = {name: torch.from_numpy(array) for name, array in named.items()}
    info["reward_terms"] = {name: torch.from_numpy(array) for name, array in terms.items()}
    return info
