"""Ray Tune over learning rates of PPO: `python examples/ray_tune.py`.

`python -m agents.sweep` is the complete form: any experiment file, checkpoints, retries.
"""

import argparse
from typing import Any

from dynamics.extras import missing

try:
    from ray import tune
    from ray.tune.schedulers import ASHAScheduler
except ModuleNotFoundError as error:
    raise missing(error, "examples/ray_tune.py", "scale") from None

ENV_ID = "FlexArm/OneLink-Reach-v0"
REPORTS = 4  # of a trial; the scheduler stops poor ones early


def trial(settings: dict[str, Any]) -> None:
    """Train with one learning rate and report the mean score of twenty episodes as it goes."""
    import torch
    from stable_baselines3 import PPO

    from agents.metrics import evaluated
    from flexarm_env import SB3VecEnv

    torch.set_num_threads(1)  # a trial has one core
    envs = SB3VecEnv(ENV_ID, num_envs=64)
    model = PPO(
        "MlpPolicy", envs, learning_rate=settings["learning_rate"], n_steps=32, batch_size=1024,
        gamma=0.97, gae_lambda=0.9, seed=0, device="cpu",
    )  # fmt: skip
    for _ in range(REPORTS):
        model.learn(settings["steps"] // REPORTS, reset_num_timesteps=False)
        score = evaluated(model, ENV_ID, episodes=20)["score"].mean()
        tune.report({"score": float(score), "steps": model.num_timesteps})


def main() -> None:
    """Search, then print the best learning rate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200_000, help="of every trial")
    parser.add_argument("--trials", type=int, default=8)
    arguments = parser.parse_args()
    space = {"learning_rate": tune.loguniform(1e-4, 1e-2), "steps": arguments.steps}
    results = tune.Tuner(
        trial,
        param_space=space,
        tune_config=tune.TuneConfig(
            metric="score", mode="max", num_samples=arguments.trials, scheduler=ASHAScheduler()
        ),
    ).fit()
    best = results.get_best_result()
    print(f"best score {best.metrics['score']:.3f} with {best.config}")


if __name__ == "__main__":
    main()
