"""PPO of skrl on torch tensors: `python examples/skrl_ppo.py [--device cuda]`.

The value also sees the true state and drawn parameters, which matters with a laboratory's sensors.
"""

import argparse
from typing import Any

import gymnasium as gym
import torch
from torch import nn

from agents.metrics import evaluated, print_table
from dynamics.extras import missing
from flexarm_env import TorchVecEnv

try:
    from skrl.agents.torch.ppo import PPO
    from skrl.envs.wrappers.torch import Wrapper
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
    from skrl.trainers.torch import SequentialTrainer
    from skrl.utils import set_seed
except ModuleNotFoundError as error:
    raise missing(error, "examples/skrl_ppo.py", "examples") from None

ENV_ID = "FlexArm/OneLink-Reach-v0"
KEYWORDS: dict[str, Any] = {}  # {"hardware": "laboratory"}: sensors, delay, drawn plants
N_ENV, N_STEP = 128, 32
SETTINGS = {
    "rollouts": N_STEP, "learning_epochs": 6, "mini_batches": 2, "discount_factor": 0.97,
    "gae_lambda": 0.9, "learning_rate": 2e-3, "grad_norm_clip": 0.5,
    "experiment": {"write_interval": 0, "checkpoint_interval": 0},
}  # fmt: skip


class Arms(Wrapper):
    """A batch of arms as skrl takes it."""

    def __init__(self, device: str) -> None:
        super().__init__(TorchVecEnv(ENV_ID, num_envs=N_ENV, device=device, **KEYWORDS))
        self._first = self._env.reset(seed=0)[0]
        size = self._env.privileged().shape[1]
        self._states = gym.spaces.Box(-float("inf"), float("inf"), (size,))

    @property
    def observation_space(self) -> gym.Space:
        """Space of the observations of one arm."""
        return self._env.single_observation_space

    @property
    def action_space(self) -> gym.Space:
        """Space of the actions of one arm."""
        return self._env.single_action_space

    @property
    def state_space(self) -> gym.Space:
        """Space of true states and drawn parameters."""
        return self._states

    def reset(self) -> tuple[torch.Tensor, dict[str, Any]]:
        """The first observations: later episodes start by themselves."""
        return self._first, {}

    def step(self, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Advance all arms; reward and flags are columns."""
        obs, reward, terminated, truncated, _ = self._env.step(actions)
        return obs, reward.float()[:, None], terminated[:, None], truncated[:, None], {}

    def state(self) -> torch.Tensor:
        """True states and drawn parameters."""
        return self._env.privileged()

    def render(self) -> None:
        """Pictures come from gymnasium.make."""

    def close(self) -> None:
        """Close the batch."""
        self._env.close()


def perceptron(n_in: int, n_out: int) -> nn.Sequential:
    """Two hidden layers of 64 units with tanh."""
    return nn.Sequential(
        nn.Linear(n_in, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_out)
    )


class Policy(GaussianMixin, Model):
    """Gaussian policy of the observation."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.network = perceptron(self.num_observations, self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -0.5))

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        """Mean and standard deviation."""
        return self.network(inputs["observations"]), {"log_std": self.log_std}

    @torch.no_grad()
    def predict(self, observation: Any, *_: Any) -> tuple[Any, None]:
        """Deterministic actions (N, n_action) for the evaluation."""
        return self.network(torch.as_tensor(observation)).clamp(-1.0, 1.0).numpy(), None


class Value(DeterministicMixin, Model):
    """Value of observation, true state and drawn parameters."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.network = perceptron(self.num_observations + self.num_states, 1)

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        """The value."""
        return self.network(torch.hstack([inputs["observations"], inputs["states"]])), {}


def train(steps: int, device: str) -> Policy:
    """Train on at least this number of steps of an arm."""
    set_seed(0)
    envs = Arms(device)
    spaces = {
        "observation_space": envs.observation_space, "state_space": envs.state_space,
        "action_space": envs.action_space, "device": device,
    }  # fmt: skip
    policy = Policy(**spaces).to(device)
    agent = PPO(
        models={"policy": policy, "value": Value(**spaces).to(device)},
        memory=RandomMemory(memory_size=N_STEP, num_envs=N_ENV, device=device),
        cfg=SETTINGS,
        **spaces,
    )
    updates = -(-steps // (N_ENV * N_STEP))
    cfg = {"timesteps": updates * N_STEP, "headless": True, "disable_progressbar": None}
    SequentialTrainer(env=envs, agents=agent, cfg=cfg).train()
    return policy.to("cpu")


def main() -> None:
    """Train, then judge on a hundred other episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # faster for small networks
    policy = train(arguments.steps, arguments.device)
    found = evaluated(policy, ENV_ID, episodes=arguments.episodes, **KEYWORDS)
    print_table({"skrl": found})


if __name__ == "__main__":
    main()
