"""Imitation of a classical controller on the states that the learner itself meets.

S. Ross, G. Gordon and D. Bagnell, A reduction of imitation learning and structured prediction to
no-regret online learning, AISTATS 2011. The library `imitation` has the method too, but needs
Gymnasium 0.29 and stable-baselines3 2.2.
"""

from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.type_aliases import Schedule

from dynamics.types import AnyArray


class DAgger(OffPolicyAlgorithm):
    """Dataset aggregation: the expert acts for `learning_starts` steps, then the learner does.

    The replay buffer holds observations with what the expert would have done, `advice` of the
    environment, so that all of them must fit in: `buffer_size`.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ActorCriticPolicy}

    def __init__(
        self,
        policy: str | type[BasePolicy],
        env: Any,
        learning_rate: float | Schedule = 1e-3,
        buffer_size: int = 1_000_000,
        learning_starts: int = 5_000,
        batch_size: int = 512,
        train_freq: int = 100,
        gradient_steps: int = 200,
        policy_kwargs: dict[str, Any] | None = None,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        device: str = "auto",
        seed: int | None = None,
    ) -> None:
        super().__init__(
            policy, env, learning_rate, buffer_size, learning_starts, batch_size,
            train_freq=train_freq, gradient_steps=gradient_steps, policy_kwargs=policy_kwargs,
            tensorboard_log=tensorboard_log, verbose=verbose, device=device, seed=seed,
            sde_support=False, support_multi_env=True,
        )  # fmt: skip
        self._setup_model()

    def train(self, gradient_steps: int, batch_size: int) -> None:
        """Least squares on the aggregated observations."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        losses = []
        for _ in range(gradient_steps):
            batch = self.replay_buffer.sample(batch_size, env=self._vec_normalize_env)
            mean = self.policy.get_distribution(batch.observations).mode()
            loss = misses(mean, batch.actions).square().mean()
            self.policy.optimizer.zero_grad()
            loss.backward()
            self.policy.optimizer.step()
            losses.append(loss.item())
        self._n_updates += gradient_steps
        self.logger.record("train/loss", np.mean(losses))

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[AnyArray, AnyArray]:
        """Actions to take, and the expert's to store."""
        advice = self.env.advice
        if self.num_timesteps < learning_starts:
            return advice, advice
        taken, _ = self.policy.predict(self._last_obs, deterministic=True)
        return taken, advice


def misses(mean: torch.Tensor, advice: torch.Tensor) -> torch.Tensor:
    """Actions less the expert's; zero beyond a limit that the expert reaches."""
    error = mean - advice
    beyond = (advice.abs() >= 1.0) & (error * advice > 0.0)
    return error.masked_fill(beyond, 0.0)
