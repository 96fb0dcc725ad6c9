"""Small learners for tests of stored policies and checkpoints, and an arm for filters."""

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from agents.learners.algorithms import algorithms, policies
from agents.run_folder.checkpoints import save_checkpoint
from dynamics import ARMS, Arm


def light_hub() -> Arm:
    """One link on a hub so light that its second mode is faster than control steps of 20 ms."""
    (link,) = ARMS["slim"].links
    return replace(
        ARMS["slim"], links=(replace(link, joint=replace(link.joint, rotor_inertia=2e-4)),)
    )


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


OFF_POLICY = {"learning_starts": 10, "batch_size": 16, "buffer_size": 1000}
NETWORK = {"net_arch": {"pi": [16], "qf": [16, 16]}}
# Keywords per algorithm, for updates within a few steps
KWARGS: dict[str, dict[str, Any]] = {
    "a2c": {},
    "ars": {"n_delta": 2, "zero_policy": False, "policy_kwargs": {"net_arch": [16, 8]}},
    "crossq": OFF_POLICY | {"policy_kwargs": NETWORK},
    "ddpg": OFF_POLICY | {"policy_kwargs": NETWORK},
    "ppo": {
        "n_steps": 32,
        "batch_size": 32,
        "policy_kwargs": {"net_arch": [16, 8], "log_std_init": -0.5},
    },
    "recurrent-ppo": {
        "n_steps": 32,
        "batch_size": 32,
        "policy_kwargs": {"net_arch": [8], "lstm_hidden_size": 12, "n_lstm_layers": 2},
    },
    "sac": OFF_POLICY | {"policy_kwargs": NETWORK},
    "td3": OFF_POLICY | {"policy_kwargs": NETWORK},
    "tqc": OFF_POLICY | {"policy_kwargs": NETWORK},
    "trpo": {"n_steps": 32, "batch_size": 32},
}


def build(name: str, seed: int = 0, env: Any = None, **kwargs: Any) -> Any:
    """An untrained model of an algorithm on `Toy`, or on another environment."""
    given = deepcopy(KWARGS[name] | kwargs)  # learners write into policy_kwargs
    return algorithms()[name](policies(name)[0], env or Toy(), seed=seed, device="cpu", **given)


def trained(name: str, env: Any = None, **kwargs: Any) -> Any:
    """A model after a few updates, with outputs so large that some actions reach their limits."""
    model = build(name, env=env, **kwargs)
    model.learn(256)
    actor = model.actor.mu if hasattr(model, "actor") else model.policy.action_net
    last = [module for module in actor.modules() if isinstance(module, torch.nn.Linear)][-1]
    last.weight.data *= 2.0 / last.weight.abs().max()
    return model


def check_alike(models: list[Any], steps: int, folder: Path) -> list[str]:
    """Both models go on alike, bit for bit, in new episodes; names of the arrays they hold."""
    written = []
    for number, model in enumerate(models):
        model.set_random_seed(7)
        model._last_obs = None  # new episodes
        model.learn(steps, reset_num_timesteps=False)
        progress = {"session": 0, "seconds": 1.0}
        written.append(save_checkpoint(model, folder / str(number), progress) / "arrays.npz")
    with np.load(written[0]) as first, np.load(written[1]) as second:
        assert first.files == second.files
        for name in first.files:
            np.testing.assert_array_equal(first[name], second[name])
        return list(first.files)
