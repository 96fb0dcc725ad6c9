"""PPO of RLlib: `python examples/rllib_ppo.py`, on a batch of arms or with --single.

RLlib's workers are other processes, so the id carries the module that registers it.
"""

import argparse
import os
from typing import Any

import gymnasium as gym
import torch

from agents.metrics import evaluated, print_table
from dynamics.extras import missing

try:
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.columns import Columns
except ModuleNotFoundError as error:
    raise missing(error, "examples/rllib_ppo.py", "scale") from None

ENV_ID = "FlexArm/OneLink-Reach-v0"


class Mean:
    """Mean actions of an RLlib module, as the evaluation asks for them."""

    def __init__(self, module: Any) -> None:
        self.module = module

    @torch.no_grad()
    def predict(self, observation: Any, *_: Any) -> tuple[Any, None]:
        """First half of the distribution's inputs, (N, n_action)."""
        out = self.module.forward_inference({Columns.OBS: torch.as_tensor(observation)})
        return out[Columns.ACTION_DIST_INPUTS].chunk(2, dim=-1)[0].numpy(), None


def configured(single: bool, runners: int, batch: int) -> PPOConfig:
    """PPO on `runners` processes with 64 arms each: one compiled batch, or single environments."""
    mode = gym.VectorizeMode.SYNC if single else gym.VectorizeMode.VECTOR_ENTRY_POINT
    return (
        PPOConfig()
        .environment(f"flexarm_env:{ENV_ID}")
        .env_runners(
            num_env_runners=runners, num_envs_per_env_runner=64, gym_env_vectorize_mode=mode
        )
        .training(
            lr=1e-3,
            gamma=0.97,
            lambda_=0.9,
            train_batch_size_per_learner=batch,
            minibatch_size=batch // 2,
            num_epochs=6,
            vf_clip_param=float("inf"),
        )
        .rl_module(model_config={"fcnet_hiddens": [64, 64], "fcnet_activation": "tanh"})
        .debugging(seed=0, log_level="ERROR")
    )


def main() -> None:
    """Train, then judge on a hundred other episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--single", action="store_true", help="single environments, no batch")
    parser.add_argument("--runners", type=int, default=1, help="processes that step arms")
    here = os.environ.get("RAY_ADDRESS", "local")  # else Ray joins any cluster that happens to run
    parser.add_argument("--address", default=here, help="of a Ray cluster (this machine alone)")
    arguments = parser.parse_args()

    ray.init(arguments.address, include_dashboard=False if arguments.address == "local" else None)
    batch = min(4096, max(128, arguments.steps))
    learner = configured(arguments.single, arguments.runners, batch).build_algo()
    steps = 0
    while steps < arguments.steps:
        steps = learner.train()["num_env_steps_sampled_lifetime"]
    policy = Mean(learner.get_module())
    print_table({"RLlib": evaluated(policy, ENV_ID, episodes=arguments.episodes)})
    learner.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
