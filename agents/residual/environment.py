"""Batch environment of stable-baselines3 whose actions correct a classical controller's."""

from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper

from agents.residual.controller import Base
from dynamics.types import AnyArray


class ResidualVecEnv(VecEnvWrapper):
    """N environments in which a base acts; the learner sees its actions and corrects them."""

    def __init__(self, venv: Any, base: Base) -> None:
        space, limits = venv.observation_space, venv.action_space
        low, high = (
            np.concatenate(ends) for ends in ((space.low, limits.low), (space.high, limits.high))
        )
        super().__init__(venv, observation_space=gym.spaces.Box(low, high, dtype=np.float32))
        self.base = base
        self._own: AnyArray = np.zeros(0)  # (N, m) the base's actions of this step
        self._state: Any = None

    def reset(self) -> AnyArray:
        """Start episodes; the base forgets the former ones."""
        self._own, seen, self._state = self.base.predict(self.venv.reset(), None, None)
        return seen

    def step_async(self, actions: AnyArray) -> None:
        """Store the corrected actions for `step_wait`."""
        taken, self._state = self.base.corrected(self._own, actions, self._state)
        self.venv.step_async(taken)

    def step_wait(self) -> Any:
        """Advance all by one control step."""
        observation, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if ended.size:
            last = np.array(observation)
            last[ended] = [infos[i]["terminal_observation"] for i in ended]
            _, seen, _ = self.base.predict(last, deepcopy(self._state), None)
            for i in ended:
                infos[i]["terminal_observation"] = seen[i]
        self._own, seen, self._state = self.base.predict(observation, self._state, dones)
        return seen, rewards, dones, infos
