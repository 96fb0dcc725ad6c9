"""PPO of TorchRL on a batch of arms: `python examples/torchrl_ppo.py`.

TorchRL restarts ended episodes itself, so the batch is made with autoreset_mode="Disabled".
"""

import argparse
from typing import Any

import gymnasium as gym
import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper, InitTracker, TransformedEnv
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import flexarm_env  # noqa: F401  registers the ids
from agents.metrics import evaluated, print_table

ENV_ID = "FlexArm/OneLink-Reach-v0"
N_ENV, N_STEP, N_EPOCH, N_MINIBATCH = 128, 32, 6, 2
LEARNING_RATE, GAMMA, LAMBDA = 2e-3, 0.97, 0.9


def perceptron(n_in: int, n_out: int) -> list[nn.Module]:
    """Two hidden layers of 64 units with tanh."""
    return [nn.Linear(n_in, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_out)]


class Mean:
    """Deterministic actions of an actor, as the evaluation asks for them."""

    def __init__(self, network: nn.Module) -> None:
        self.network = network

    @torch.no_grad()
    def predict(self, observation: Any, *_: Any) -> tuple[Any, None]:
        """Squashed mean of the distribution, (N, n_action)."""
        location, _ = self.network(torch.as_tensor(observation))
        return torch.tanh(location).numpy(), None


def train(steps: int) -> Mean:
    """Train on at least this number of steps of an arm."""
    torch.manual_seed(0)
    batch = GymWrapper(gym.make_vec(ENV_ID, num_envs=N_ENV, autoreset_mode="Disabled"))
    envs = TransformedEnv(batch, InitTracker())
    envs.set_seed(0)
    n_observation, n_action = envs.observation_spec["observation"].shape[-1], 1
    network = nn.Sequential(*perceptron(n_observation, 2 * n_action), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        spec=envs.action_spec,
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Sequential(*perceptron(n_observation, 1)), in_keys=["observation"])
    advantage = GAE(gamma=GAMMA, lmbda=LAMBDA, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.0, critic_coeff=0.5)
    optimizer = torch.optim.Adam(loss.parameters(), LEARNING_RATE)
    frames = N_ENV * N_STEP
    n_update = -(-steps // frames)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, n_update)
    collector = Collector(envs, actor, frames_per_batch=frames, total_frames=n_update * frames)
    for rollout in collector:
        with torch.no_grad():
            rollout = advantage(rollout)
        transitions = rollout.reshape(-1)
        for _ in range(N_EPOCH):
            for rows in torch.randperm(frames).chunk(N_MINIBATCH):
                losses = loss(transitions[rows])
                optimizer.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        schedule.step()
    collector.shutdown()
    return Mean(network)


def main() -> None:
    """Train, then judge on a hundred other episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--episodes", type=int, default=100)
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # faster for small networks
    policy = train(arguments.steps)
    print_table({"TorchRL": evaluated(policy, ENV_ID, episodes=arguments.episodes)})


if __name__ == "__main__":
    main()
