"""PPO of stable-baselines3 on a batch of arms: `python examples/sb3_ppo.py`."""

import argparse

import torch
from stable_baselines3 import PPO

from agents.metrics import evaluated, print_table
from flexarm_env import SB3VecEnv

ENV_ID = "FlexArm/OneLink-Reach-v0"


def main() -> None:
    """Train, then judge on a hundred other episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--episodes", type=int, default=100)
    arguments = parser.parse_args()

    torch.set_num_threads(1)  # faster for small networks
    model = PPO(
        "MlpPolicy",
        SB3VecEnv(ENV_ID, num_envs=128),
        n_steps=32,
        batch_size=2048,
        n_epochs=6,
        learning_rate=lambda remaining: 2e-3 * remaining,
        gamma=0.97,
        gae_lambda=0.9,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -0.5},
        seed=0,
        device="cpu",
    )
    model.learn(arguments.steps)
    print_table({"PPO": evaluated(model, ENV_ID, episodes=arguments.episodes)})


if __name__ == "__main__":
    main()
