"""Batch of environments with torch tensors in and out."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import torch

from dynamics.description import validate
from flexarm_env.interfaces.env import Changeable
from flexarm_env.interfaces.tensors.device import DeviceBatch
from flexarm_env.interfaces.tensors.differentiable import (
    DifferentiableBatch,
    differentiable_on_device,
    differentiable_on_host,
)
from flexarm_env.interfaces.tensors.host import HostBatch
from flexarm_env.interfaces.tensors.privileged import Privileged
from flexarm_env.interfaces.tensors.results import Info
from flexarm_env.interfaces.vector import FlexArmVectorEnv, restarting_batch

Observation = Any  # a tensor, or with obs="goal" a dict of tensors
RECOMPUTED = "recomputed"
REFUSED = {
    "autoreset_mode": "an environment whose episode ends restarts in the same step",
    "render_mode": "pictures come from gymnasium.make_vec(id, render_mode=...)",
    "vectorization_mode": "there is one compiled batch",
    "wrappers": "wrappers take NumPy arrays; transform the tensors instead",
    "vector_kwargs": "give its entries as keywords",
}


class TorchVecEnv(Changeable):
    """N environments of a registered id, stepped together, as torch tensors.

    An environment whose episode ends restarts in the same step: its observation is the first one of
    the new episode, its reward, flags and info belong to the step that ended, and
    `info["final_obs"]` holds the last observation of that episode (of all others, the present one).
    A later step does not overwrite a tensor that is still in use. On the processor tensors share
    the batch's memory; on a GPU nothing leaves it, and `step` returns before the kernel has ended.

    Parameters
    ----------
    id : a registered id, such as "FlexArm/OneLink-Reach-v0".
    num_envs : number of environments.
    device : "cpu", or "cuda" for one NVIDIA GPU (extra `gpu`).
    differentiable : whether observation, reward and info carry gradients by the actions and by the
        state, back to the last `detach` or the start of the episode; see docs/gradients.md.
        "recomputed" keeps states alone until then, and the way back steps again.
    keywords : those of `gymnasium.make_vec` for this id: `hardware`, `obs`, `threads` and so on;
        `dtype` is "float32" on a GPU unless given.

    Attributes
    ----------
    single_observation_space, single_action_space : Gymnasium's spaces of one environment.
    device : of all tensors.
    core : the batch.

    Raises
    ------
    ValueError : with the keyword, its value and the remedy.
    """

    def __init__(
        self,
        id: str,
        num_envs: int,
        device: str | torch.device = "cpu",
        differentiable: bool | str = False,
        **keywords: Any,
    ) -> None:
        self.device = _known_device(device)
        self.differentiable = _known_gradients(differentiable)
        for name in REFUSED.keys() & keywords.keys():
            raise ValueError(
                f"{name} is not a keyword of TorchVecEnv, got {validate.shown(keywords[name])}; "
                f"leave it out: {REFUSED[name]}."
            )
        if self.device.type == "cuda":
            keywords.setdefault("dtype", "float32")
        envs = restarting_batch(id, num_envs, keywords)
        self.envs, self.num_envs = envs, envs.num_envs
        self.single_observation_space = envs.single_observation_space
        self.single_action_space = envs.single_action_space
        self._shape = (self.num_envs, envs.core.arm.n_torque)
        self._batch = _batch(envs, self.device, differentiable)
        self._privileged = Privileged(envs.core)
        self.core = envs.core

    @property
    def max_episode_steps(self) -> int:
        """Control steps after which an episode is truncated; -1: never."""
        return self.envs.max_episode_steps

    @max_episode_steps.setter
    def max_episode_steps(self, given: int | None) -> None:
        self.envs.max_episode_steps = given

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Observation, Info]:
        """Start episodes in all environments; environment i gets `seed + i` or `seed[i]`.

        `options` are those of `gymnasium.make_vec`: "state" and "target".
        """
        self.core.claim()
        try:
            self.envs.seed_streams(seed)
            obs, info = self._batch.reset(options)
        finally:
            self.core.busy = False
        return self._observed(obs), info

    def step(
        self, actions: torch.Tensor
    ) -> tuple[Observation, torch.Tensor, torch.Tensor, torch.Tensor, Info]:
        """Advance all by one control step.

        Parameters
        ----------
        actions : (N, n_torque) tensor on the device; clipped to [-1, 1].

        Returns
        -------
        Observation (N, size) float32; reward (N,) in the batch's dtype; terminated, truncated (N,)
        bool; info, tensors of N rows by name.
        """
        given = self._checked(actions)
        self.envs.claim_step()
        try:
            obs, last, reward, terminated, truncated, info = self._batch.step(given)
        finally:
            self.core.busy = False
        info["final_obs"] = self._observed(last)
        return self._observed(obs), reward, terminated, truncated, info

    @property
    def state(self) -> torch.Tensor:
        """(rows, N) state of all environments, in the rows `core.signals.state.slices`."""
        return self._batch.state

    def detach(self) -> torch.Tensor:
        """Cut the graph: gradients of later steps go back to the present state, which is returned.

        It is (rows, M) with a column per environment and some unused ones, M >= N, and a leaf:
        after `backward`, its `grad` holds the derivatives by `core.signals.state.slices`.
        """
        if not isinstance(self._batch, DifferentiableBatch):
            raise ValueError("detach needs TorchVecEnv(..., differentiable=True).")
        return self._batch.detach()

    def privileged(self) -> torch.Tensor:
        """(N, size) float32 true state, drawn parameters and delay, scaled; see its slices.

        After a step that ended an episode it is about the new one, as the observation is.
        """
        return self._privileged(self._batch.state)

    @property
    def privileged_slices(self) -> dict[str, slice]:
        """Columns of `privileged` by name: joint angles and rates, modes, target, and so on."""
        return self._privileged.slices

    def close(self) -> None:
        """Close the batch."""
        self.envs.close()

    def _checked(self, actions: torch.Tensor) -> torch.Tensor:
        """Actions in the form that the batch takes: themselves, if contiguous float32."""
        if not isinstance(actions, torch.Tensor):
            raise ValueError(
                f"Actions must be a torch tensor, got {validate.shown(actions)}; "
                "torch.as_tensor(actions, dtype=torch.float32) makes one."
            )
        if actions.is_complex() or actions.layout is not torch.strided:
            raise ValueError(
                f"Actions must be a dense tensor of real numbers, got {actions.dtype} in layout "
                f"{actions.layout}; actions.to_dense() or actions.real makes one."
            )
        if actions.device.type != self.device.type:
            raise ValueError(
                f"Actions must be on {self.device}, where the batch is, got {actions.device}; "
                f"move them with actions.to({str(self.device)!r})."
            )
        if tuple(actions.shape) != self._shape:
            raise ValueError(f"Actions must have shape {self._shape}, got {tuple(actions.shape)}.")
        kept = actions if self.differentiable else actions.detach()
        return kept.to(torch.float32).contiguous()

    def _observed(self, elements: torch.Tensor) -> Observation:
        return self.core.layout.observed(elements)


def _known_gradients(given: Any) -> bool | str:
    if not isinstance(given, bool) and given != RECOMPUTED:
        raise ValueError(
            f"differentiable must be True, False or {RECOMPUTED!r}, got {validate.shown(given)}."
        )
    return given


def _known_device(device: Any) -> torch.device:
    try:
        found = torch.device(device)
    except (RuntimeError, TypeError):
        raise ValueError(f"device must be 'cpu' or 'cuda', got {validate.shown(device)}.") from None
    if found.type not in ("cpu", "cuda"):
        raise ValueError(f"device must be 'cpu' or 'cuda', got {str(found)!r}.")
    if found.type == "cuda" and not torch.cuda.is_available():
        raise ValueError(
            f"device={str(found)!r} needs an NVIDIA GPU and a torch with CUDA, which sees none "
            "here; device='cpu' steps the same batch on the processor."
        )
    return found


def _batch(
    envs: FlexArmVectorEnv, device: torch.device, differentiable: bool | str
) -> HostBatch | DeviceBatch | DifferentiableBatch:
    """The batch of a device."""
    if differentiable and envs.core.layout.goal:
        raise ValueError(
            "obs must be 'state' or 'sensors' with differentiable=True, got 'goal': rewards of "
            "goals are not part of the compiled step; give the target with obs='state'."
        )
    recomputed = differentiable == RECOMPUTED
    if device.type == "cpu":
        return differentiable_on_host(envs, recomputed) if differentiable else HostBatch(envs)
    from dynamics.backends.cuda.compiler import Kernels

    index = torch.cuda.current_device() if device.index is None else device.index
    compiled = partial(Kernels, device=index)
    if differentiable:
        return differentiable_on_device(envs.core, device, compiled, recomputed)
    return DeviceBatch(envs.core, device, compiled)
