"""PPO of rsl_rl on torch tensors: `python examples/rsl_rl_ppo.py [--device cuda]`.

The critic also sees the true state and drawn parameters, which matters with a laboratory's sensors.
"""

import argparse
from typing import Any

import torch

from agents.metrics import evaluated, print_table
from dynamics.extras import missing
from flexarm_env import TorchVecEnv

try:
    from rsl_rl.env import VecEnv
    from rsl_rl.runners import OnPolicyRunner
    from tensordict import TensorDict
except ModuleNotFoundError as error:
    raise missing(error, "examples/rsl_rl_ppo.py", "tensors") from None

ENV_ID = "FlexArm/OneLink-Reach-v0"
KEYWORDS: dict[str, Any] = {}  # {"hardware": "laboratory"}: sensors, delay, drawn plants
N_ENV, N_STEP = 128, 32
NETWORK = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "tanh"}
SETTINGS = {
    "num_steps_per_env": N_STEP,
    "save_interval": 1_000_000,
    "obs_groups": {"actor": ["seen"], "critic": ["seen", "truth"]},
    "actor": NETWORK | {
        "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 0.6},
    },
    "critic": NETWORK,
    "algorithm": {
        "class_name": "PPO", "learning_rate": 2e-3, "gamma": 0.97, "lam": 0.9,
        "num_learning_epochs": 6, "num_mini_batches": 2, "entropy_coef": 0.0,
        "max_grad_norm": 0.5, "schedule": "adaptive", "desired_kl": 0.01,
    },
}  # fmt: skip


class Arms(VecEnv):
    """A batch of arms as rsl_rl takes it."""

    def __init__(self, device: str) -> None:
        self.envs = TorchVecEnv(ENV_ID, num_envs=N_ENV, device=device, **KEYWORDS)
        self.num_envs, self.device, self.cfg = N_ENV, device, {"id": ENV_ID, **KEYWORDS}
        self.num_actions = self.envs.single_action_space.shape[0]
        self.max_episode_length = self.envs.max_episode_steps
        self.episode_length_buf = torch.zeros(N_ENV, dtype=torch.long, device=device)
        self._seen = self._observed(self.envs.reset(seed=0)[0])

    def get_observations(self) -> TensorDict:
        """The present observations."""
        return self._seen

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, Any]:
        """Advance all arms; episodes that ran out of time are in `time_outs`."""
        obs, reward, terminated, truncated, _ = self.envs.step(actions)
        self._seen = self._observed(obs)
        ended = terminated | truncated
        self.episode_length_buf = torch.where(ended, 0, self.episode_length_buf + 1)
        return self._seen, reward.float(), ended, {"time_outs": (truncated & ~terminated).float()}

    def _observed(self, obs: torch.Tensor) -> TensorDict:
        parts = {"seen": obs.clone(), "truth": self.envs.privileged()}
        return TensorDict(parts, batch_size=[N_ENV], device=self.device)


class Actor:
    """Deterministic actions for the evaluation."""

    def __init__(self, network: Any) -> None:
        self.network = network

    @torch.no_grad()
    def predict(self, observation: Any, *_: Any) -> tuple[Any, None]:
        """Mean of the distribution, (N, n_action)."""
        seen = torch.as_tensor(observation)
        batch = TensorDict({"seen": seen}, batch_size=seen.shape[:1])
        return self.network(batch).clamp(-1.0, 1.0).numpy(), None


def main() -> None:
    """Train, then judge on a hundred other episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(1)  # faster for small networks
    runner = OnPolicyRunner(Arms(arguments.device), SETTINGS, device=arguments.device)
    runner.learn(-(-arguments.steps // (N_ENV * N_STEP)))
    policy = Actor(runner.get_inference_policy("cpu"))
    found = evaluated(policy, ENV_ID, episodes=arguments.episodes, **KEYWORDS)
    print_table({"rsl_rl": found})


if __name__ == "__main__":
    main()
