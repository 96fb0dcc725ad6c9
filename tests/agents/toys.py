"""Small learners for tests of stored policies and checkpoints."""

from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO, SAC


class Toy(gym.Env):
    """Three random observations, two actions, no dynamics."""

    observation_space = gym.spaces.Box(-5.0, 5.0, (3,), np.float32)
    action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        return self.np_random.uniform(-1.0, 1.0, 3).astype(np.float32), {}

    def step(self, action: Any) -> Any:
        observation = self.np_random.uniform(-1.0, 1.0, 3).astype(np.float32)
        return observation, -float(action @ action), False, bool(self.np_random.random() < 0.1), {}


def build(name: str, seed: int = 0) -> Any:
    if name == "ppo":
        network = {"net_arch": [16, 8], "log_std_init": -0.5}
        return PPO("MlpPolicy", Toy(), policy_kwargs=network, n_steps=32, batch_size=32, seed=seed)
    network = {"net_arch": {"pi": [16], "qf": [16, 16]}}
    return SAC("MlpPolicy", Toy(), policy_kwargs=network, learning_starts=10, seed=seed)
