"""PPO in one file of plain torch, in the manner of CleanRL: `python examples/cleanrl_ppo.py`.

The batch restarts ended episodes in the same step, so every observation belongs to a transition,
and the value of the last observation of an episode that ran out of time is in its info.
"""

import argparse
import itertools
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import flexarm_env  # noqa: F401  registers the ids
from agents.metrics import evaluated, print_table

ENV_ID = "FlexArm/OneLink-Reach-v0"
N_ENV, N_STEP, N_EPOCH, N_MINIBATCH = 128, 32, 6, 2
LEARNING_RATE, GAMMA, LAMBDA, CLIP = 2e-3, 0.97, 0.9, 0.2


def network(*sizes: int, last_gain: float) -> nn.Sequential:
    """Perceptron with tanh and orthogonal weights."""
    layers: list[nn.Module] = []
    for n_in, n_out in itertools.pairwise(sizes):
        linear = nn.Linear(n_in, n_out)
        nn.init.orthogonal_(linear.weight, 2**0.5)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.Tanh()]
    nn.init.orthogonal_(layers[-2].weight, last_gain)
    return nn.Sequential(*layers[:-1])


class Agent(nn.Module):
    """Gaussian policy and value of an observation."""

    def __init__(self, n_observation: int, n_action: int) -> None:
        super().__init__()
        self.mean = network(n_observation, 64, 64, n_action, last_gain=0.01)
        self.value = network(n_observation, 64, 64, 1, last_gain=1.0)
        self.log_std = nn.Parameter(torch.full((n_action,), -0.5))

    def policy(self, observation: torch.Tensor) -> Normal:
        """Distribution of the actions."""
        return Normal(self.mean(observation), self.log_std.exp())

    @torch.no_grad()
    def predict(self, observation: Any, *_: Any) -> tuple[Any, None]:
        """Mean actions, as the evaluation asks for them."""
        return self.mean(torch.as_tensor(observation)).numpy(), None


def train(steps: int) -> Agent:
    """Train on at least this number of steps of an arm."""
    torch.manual_seed(0)
    envs = gym.make_vec(ENV_ID, num_envs=N_ENV, autoreset_mode="SameStep")
    observation = torch.as_tensor(envs.reset(seed=0)[0])
    shape = observation.shape[1], envs.action_space.sample().shape[1]
    agent = Agent(*shape)
    optimizer = torch.optim.Adam(agent.parameters(), LEARNING_RATE, eps=1e-5)
    observations = torch.zeros(N_STEP, N_ENV, shape[0])
    actions = torch.zeros(N_STEP, N_ENV, shape[1])
    log_probs, rewards, values = (torch.zeros(N_STEP, N_ENV) for _ in range(3))
    running = torch.zeros(N_STEP, N_ENV)

    n_update = -(-steps // (N_ENV * N_STEP))
    for update in range(n_update):
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - update / n_update)
        for t in range(N_STEP):
            with torch.no_grad():
                policy = agent.policy(observation)
                action = policy.sample()
                values[t] = agent.value(observation).squeeze(-1)
            observations[t], actions[t] = observation, action
            log_probs[t] = policy.log_prob(action).sum(-1)
            after, reward, terminated, truncated, info = envs.step(action.clamp(-1, 1).numpy())
            rewards[t] = torch.as_tensor(reward)
            for i in np.flatnonzero(truncated & ~terminated):  # time ran out: the arm moves on
                with torch.no_grad():
                    last = agent.value(torch.as_tensor(info["final_obs"][i]))
                rewards[t, i] += GAMMA * last.item()
            running[t] = torch.as_tensor(~(terminated | truncated))
            observation = torch.as_tensor(after)

        with torch.no_grad():
            following = agent.value(observation).squeeze(-1)
        advantages, advantage = torch.zeros(N_STEP, N_ENV), torch.zeros(N_ENV)
        for t in reversed(range(N_STEP)):
            error = rewards[t] + GAMMA * running[t] * following - values[t]
            advantage = error + GAMMA * LAMBDA * running[t] * advantage
            advantages[t], following = advantage, values[t]
        targets = (advantages + values).flatten()
        flat = [x.flatten(0, 1) for x in (observations, actions, log_probs, advantages)]

        for _ in range(N_EPOCH):
            for rows in torch.randperm(N_ENV * N_STEP).chunk(N_MINIBATCH):
                seen, taken, old, gain = (x[rows] for x in flat)
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                ratio = (agent.policy(seen).log_prob(taken).sum(-1) - old).exp()
                improved = torch.min(gain * ratio, gain * ratio.clamp(1 - CLIP, 1 + CLIP))
                error = agent.value(seen).squeeze(-1) - targets[rows]
                optimizer.zero_grad()
                (0.5 * error.square().mean() - improved.mean()).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
    envs.close()
    return agent


def main() -> None:
    """Train, then judge on a hundred other episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--episodes", type=int, default=100)
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # faster for small networks
    agent = train(arguments.steps)
    print_table({"PPO, plain torch": evaluated(agent, ENV_ID, episodes=arguments.episodes)})


if __name__ == "__main__":
    main()
