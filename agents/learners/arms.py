"""A batch of arms as algorithms on tensors take it."""

from typing import Any

import gymnasium as gym
import numpy as np
import torch

from flexarm_env import TorchVecEnv

Observations = dict[str, torch.Tensor]


class Arms:
    """A batch of arms with dicts of tensors: "observation", and "privileged" for the critic.

    Parameters
    ----------
    envs : the batch.
    stack : number of latest observations that are given; zeros precede an episode's first.
    """

    def __init__(self, envs: TorchVecEnv, stack: int) -> None:
        space = envs.single_observation_space
        if not isinstance(space, gym.spaces.Box):
            raise ValueError("obs='goal' gives dicts, which rsl-ppo does not take; leave obs out.")
        self.envs, self.num_envs = envs, envs.num_envs
        low, high = np.tile(space.low, stack), np.tile(space.high, stack)
        self.observation_space = gym.spaces.Box(low, high)
        self.action_space = envs.single_action_space
        self._latest = torch.zeros((self.num_envs, low.size), device=envs.device)
        self._seed: int | None = None

    def detach(self) -> Observations:
        """Cut the graph of a differentiable batch; the present observation without it."""
        self.envs.detach()
        self._latest = self._latest.detach()
        return self._given()

    def seed(self, seed: int | None) -> None:
        """Seed the next reset."""
        self._seed = seed

    def reset(self) -> Observations:
        """Start episodes in all environments."""
        obs, _ = self.envs.reset(seed=self._seed)
        self._seed = None
        return self._observed(obs, torch.ones_like(self._latest[:, 0], dtype=torch.bool))

    def spread(self) -> None:
        """Let the present episodes end at times spread over the length of an episode."""
        rows = self.envs.core.signals.state.slices["elapsed"]
        most = self.envs.max_episode_steps
        if most > 0:
            elapsed = self.envs.state[rows]
            elapsed.copy_(torch.randint_like(elapsed, most))

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Observation, reward, ended, out of time, and info."""
        given = torch.as_tensor(actions, device=self.envs.device)
        obs, reward, terminated, truncated, info = self.envs.step(given)
        ended = terminated | truncated
        return self._observed(obs, ended), reward.float(), ended, truncated & ~terminated, info

    def last(self, info: dict[str, Any]) -> torch.Tensor:
        """Frames that the step has led to, before restarts."""
        newest = info["final_obs"]
        return torch.cat([self._before[:, newest.shape[1] :], newest], dim=1)

    def close(self) -> None:
        """Close the batch."""
        self.envs.close()

    def _observed(self, obs: torch.Tensor, begun: torch.Tensor) -> Observations:
        self._before = self._latest
        before = self._latest[:, obs.shape[1] :].masked_fill(begun[:, None], 0.0)
        self._latest = torch.cat([before, obs], dim=1)
        return self._given()

    def _given(self) -> Observations:
        return {"observation": self._latest, "privileged": self.envs.privileged()}


def on_host(
    reward: torch.Tensor, ended: torch.Tensor, late: torch.Tensor, info: dict[str, Any]
) -> tuple[Any, Any, dict[int, dict[str, Any]]]:
    """Rewards, ends, and the info of ended episodes by environment; one transfer."""
    columns = (reward, ended, late, info["tip_error"], info["settled"])
    rewards, dones, timed, error, settled = (
        torch.stack([x.detach().float() for x in columns]).cpu().numpy()
    )
    infos = {
        i: {"TimeLimit.truncated": bool(timed[i]), "tip_error": error[i], "settled": settled[i]}
        for i in np.flatnonzero(dones).tolist()
    }
    return rewards, dones, infos
