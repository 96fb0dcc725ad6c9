"""PPO of TorchRL on torch tensors: `python examples/torchrl_ppo.py [--device cuda]`.

TorchRL asks for a reset where an episode has ended; the batch has begun the next one by then.
"""

import argparse
from typing import Any

import torch
from torch import nn

from agents.metrics import evaluated, print_table
from dynamics.extras import missing
from flexarm_env import TorchVecEnv

try:
    from tensordict import TensorDict, TensorDictBase
    from tensordict.nn import NormalParamExtractor, TensorDictModule
    from torchrl.collectors import Collector
    from torchrl.data import Binary, Bounded, Composite, Unbounded
    from torchrl.envs import EnvBase, InitTracker, TransformedEnv
    from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE
except ModuleNotFoundError as error:
    raise missing(error, "examples/torchrl_ppo.py", "examples") from None

ENV_ID = "FlexArm/OneLink-Reach-v0"
N_ENV, N_STEP, N_EPOCH, N_MINIBATCH = 128, 32, 6, 2
FLAGS = ("done", "terminated", "truncated")
LEARNING_RATE, GAMMA, LAMBDA = 2e-3, 0.97, 0.9


class Arms(EnvBase):
    """A batch of arms as TorchRL takes it."""

    def __init__(self, device: str) -> None:
        super().__init__(device=device, batch_size=[N_ENV])
        self.envs = TorchVecEnv(ENV_ID, num_envs=N_ENV, device=device)
        observed = self.envs.single_observation_space.shape[0]
        acting = self.envs.single_action_space.shape[0]
        flags = {name: Binary(shape=(N_ENV, 1), dtype=torch.bool, device=device) for name in FLAGS}
        self.observation_spec = Composite(
            observation=Unbounded((N_ENV, observed), device=device), shape=(N_ENV,), device=device
        )
        self.action_spec = Bounded(-1.0, 1.0, (N_ENV, acting), device=device)
        self.reward_spec = Unbounded((N_ENV, 1), device=device)
        self.done_spec = Composite(flags, shape=(N_ENV,), device=device)
        self._first = self.envs.reset(seed=0)[0]

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        """The first observations of new episodes, and the present ones of all others."""
        none = torch.zeros((N_ENV, 1), dtype=torch.bool, device=self.device)
        return TensorDict(
            {"observation": self._first, **dict.fromkeys(FLAGS, none)}, self.batch_size
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Results of a step, with the last observation of an episode that has ended."""
        results = self.envs.step(tensordict["action"])
        self._first, reward, terminated, truncated, info = results
        flags = dict(zip(FLAGS, (terminated | truncated, terminated, truncated), strict=True))
        columns = {name: column[:, None] for name, column in flags.items()}
        found = {"observation": info["final_obs"], "reward": reward.float()[:, None], **columns}
        return TensorDict(found, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self._first = self.envs.reset(seed=seed)[0]


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


def train(steps: int, device: str) -> Mean:
    """Train on at least this number of steps of an arm."""
    torch.manual_seed(0)
    envs = TransformedEnv(Arms(device), InitTracker())
    n_observation, n_action = envs.observation_spec["observation"].shape[-1], 1
    network = nn.Sequential(*perceptron(n_observation, 2 * n_action), NormalParamExtractor())
    network = network.to(device)
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        spec=envs.action_spec,
        return_log_prob=True,
    )
    value = nn.Sequential(*perceptron(n_observation, 1)).to(device)
    critic = ValueOperator(value, in_keys=["observation"])
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
            for rows in torch.randperm(frames, device=device).chunk(N_MINIBATCH):
                losses = loss(transitions[rows])
                optimizer.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        schedule.step()
    collector.shutdown()
    return Mean(network.to("cpu"))


def main() -> None:
    """Train, then judge on a hundred other episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # faster for small networks
    policy = train(arguments.steps, arguments.device)
    print_table({"TorchRL": evaluated(policy, ENV_ID, episodes=arguments.episodes)})


if __name__ == "__main__":
    main()
