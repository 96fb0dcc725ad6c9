"""Actor and critic of stable-baselines3 of which the critic alone sees the true state."""

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import (
    BaseFeaturesExtractor,
    CombinedExtractor,
    MlpExtractor,
)
from stable_baselines3.common.vec_env import VecEnvWrapper, VecFrameStack
from stable_baselines3.common.vec_env.stacked_observations import StackedObservations

from dynamics.description import validate


class Sensors(BaseFeaturesExtractor):
    """The part of an observation that the actor sees."""

    def __init__(self, space: gym.spaces.Dict) -> None:
        super().__init__(space, gym.spaces.flatdim(space["observation"]))

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """(N, size) numbers of "observation"."""
        return observations["observation"]


class PrivilegedCriticPolicy(ActorCriticPolicy):
    """Actor of "observation", and critic of "observation" and "privileged", as `MlpPolicy` else.

    It is for `SB3VecEnv(..., privileged=True)`, and for A2C, PPO and TRPO.

    Raises
    ------
    ValueError : for other observations.
    """

    def __init__(
        self,
        observation_space: gym.Space[Any],
        *args: Any,
        features_extractor_class: type[BaseFeaturesExtractor] = Sensors,
        **kwargs: Any,
    ) -> None:
        if set(getattr(observation_space, "spaces", ())) != {"observation", "privileged"}:
            raise ValueError(
                "PrivilegedCriticPolicy takes the observations of SB3VecEnv(..., privileged=True), "
                f"got {validate.shown(observation_space)}."
            )
        super().__init__(
            observation_space,
            *args,
            features_extractor_class=features_extractor_class,
            share_features_extractor=False,
            **kwargs,
        )

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        both = CombinedExtractor(self.observation_space)
        wider = MlpExtractor(both.features_dim, self.net_arch, self.activation_fn, self.device)
        self.vf_features_extractor, self.mlp_extractor.value_net = both, wider.value_net
        self.mlp_extractor.latent_dim_vf = wider.latent_dim_vf


class ActorFrames(VecEnvWrapper):
    """A batch whose actor sees the latest observations, and whose critic the true state besides.

    `VecFrameStack` would repeat the true state too.
    """

    def __init__(self, venv: Any, frames: int) -> None:
        own = venv.observation_space
        self._latest = StackedObservations(venv.num_envs, frames, own["observation"])
        seen = {"observation": self._latest.stacked_observation_space}
        super().__init__(venv, gym.spaces.Dict({**own, **seen}))

    def reset(self) -> Any:
        """Start episodes."""
        seen = self.venv.reset()
        return seen | {"observation": self._latest.reset(seen["observation"])}

    def step_wait(self) -> Any:
        """Advance all by one control step."""
        seen, rewards, dones, infos = self.venv.step_wait()
        last = {i: infos[i]["terminal_observation"] for i in np.flatnonzero(dones)}
        ends = {i: {"terminal_observation": x["observation"]} for i, x in last.items()}
        frames, _ = self._latest.update(seen["observation"], dones, ends)
        for i, end in ends.items():
            last[i]["observation"] = end["terminal_observation"]
        return seen | {"observation": frames}, rewards, dones, infos


def stacked(envs: Any, frames: int) -> Any:
    """A batch of stable-baselines3 whose actor sees the latest observations."""
    if frames == 1:
        return envs
    parts = isinstance(envs.observation_space, gym.spaces.Dict)
    return ActorFrames(envs, frames) if parts else VecFrameStack(envs, frames)
