"""Batch environment of stable-baselines3 in which a learner completes a classical controller."""

from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper

from agents.controllers.models.memory import part_of
from agents.hybrid.controller import Base
from dynamics.types import AnyArray
from flexarm_env.interfaces.tensors.privileged import Privileged
from flexarm_env.task.observations import BOUND


class HybridVecEnv(VecEnvWrapper):
    """N environments in which a base acts with the learner's actions."""

    def __init__(self, venv: Any, base: Base) -> None:
        space, added = venv.observation_space, np.full(base.added, BOUND)
        low, high = np.append(space.low, -added), np.append(space.high, added)
        super().__init__(venv, gym.spaces.Box(np.float32(low), np.float32(high)))
        self.base = base
        self._true_state = Privileged(venv.envs.core)
        self._begun: Any = None  # the base's step that waits for the learner
        self._state: Any = None

    @property
    def advice(self) -> AnyArray:
        """(N, m) actions of the controller itself at the present observations."""
        own, _ = self._begun
        return np.clip(own, -1.0, 1.0)

    @property
    def true_state(self) -> AnyArray:
        """(N, size) numbers of `TorchVecEnv.privileged` at the present states."""
        return self._true_state.on_host()

    def reset(self) -> AnyArray:
        """Start episodes; the base forgets the former ones."""
        seen, self._begun = self.base.begin(self.venv.reset(), None, None)
        return seen

    def step_async(self, actions: AnyArray) -> None:
        """Complete the base's actions for `step_wait`."""
        taken, self._state = self.base.complete(self._begun, actions)
        self.venv.step_async(taken)

    def step_wait(self) -> Any:
        """Advance all by one control step."""
        observation, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if ended.size and self.base.added:
            last = np.array([infos[i]["terminal_observation"] for i in ended])
            completed, _ = self.base.begin(last, part_of(self._state, ended), None)
            for i, seen in zip(ended, completed, strict=True):
                infos[i]["terminal_observation"] = seen
        seen, self._begun = self.base.begin(observation, self._state, dones)
        return seen, rewards, dones, infos
