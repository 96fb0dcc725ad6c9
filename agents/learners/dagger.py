"""Imitation of a classical controller on the states that the learner itself meets.

S. Ross, G. Gordon and D. Bagnell, A reduction of imitation learning and structured prediction to
no-regret online learning, AISTATS 2011. The library `imitation` has the method too, but needs
Gymnasium 0.29 and stable-baselines3 2.2.
"""

from functools import partial
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.type_aliases import Schedule

from agents.learners.recurrent import LstmPolicy
from dynamics.types import AnyArray

LARGEST_GRADIENT = 1.0  # norm of the gradient through whole episodes


class DAgger(OffPolicyAlgorithm):
    """Dataset aggregation: the expert acts for `learning_starts` steps, then the learner does.

    The replay buffer holds observations with what the expert would have done, `advice` of the
    environment, so that all of them must fit in: `buffer_size`. A policy with LSTM cells learns
    from whole episodes, as many as have `batch_size` observations.

    With `estimation` above zero the network also learns to tell the true state and the drawn
    parameters, `true_state` of the environment, by a linear layer behind its cells, or behind the
    last layer of a policy without any, which a stored policy lacks. It weighs the mean square of
    these errors, in units of their spread, beside that of the actions.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        "MlpPolicy": ActorCriticPolicy,
        "MlpLstmPolicy": LstmPolicy,
    }

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
        estimation: float = 0.0,
        policy_kwargs: dict[str, Any] | None = None,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        device: str = "auto",
        seed: int | None = None,
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            policy, env, learning_rate, buffer_size, learning_starts, batch_size,
            train_freq=train_freq, gradient_steps=gradient_steps, policy_kwargs=policy_kwargs,
            tensorboard_log=tensorboard_log, verbose=verbose, device=device, seed=seed,
            sde_support=False, support_multi_env=True,
        )  # fmt: skip
        self.estimation = estimation
        self.estimated = self.env.true_state.shape[1] if estimation else 0  # numbers
        self._memory: Any = None  # of the policy's cells
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        """Build the network, and a buffer of what the expert would have done and the true state."""
        if self.estimation:
            size = self.action_space.shape[0] + self.estimated
            lessons = gym.spaces.Box(-np.inf, np.inf, (size,))
            self.replay_buffer = ReplayBuffer(
                self.buffer_size, self.observation_space, lessons, self.device, self.n_envs
            )
        super()._setup_model()
        self._add_estimator()

    def _add_estimator(self) -> None:
        """Give the network the layer that tells the true state."""
        if not self.estimation:
            return
        policy = self.policy
        recurrent = isinstance(policy, LstmPolicy)
        hidden = policy.lstm_output_dim if recurrent else policy.mlp_extractor.latent_dim_pi
        policy.estimator = torch.nn.Linear(hidden, self.estimated).to(self.device)
        policy.optimizer.add_param_group({"params": list(policy.estimator.parameters())})

    def _setup_learn(self, *given: Any, **keywords: Any) -> Any:
        """Begin a session; one that resets the environment continues no former episode."""
        before, buffer = self._last_obs, self.replay_buffer
        begun = super()._setup_learn(*given, **keywords)
        if buffer.size() and self._last_obs is not before:
            buffer.dones[buffer.pos - 1] = 1.0
        return begun

    def train(self, gradient_steps: int, batch_size: int) -> None:
        """Least squares on the aggregated observations."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        recurrent = isinstance(self.policy, LstmPolicy)
        batch = partial(self._of_episodes, self._episodes()) if recurrent else self._of_steps
        usual = self._usual_state() if self.estimation else None
        losses = []
        for _ in range(gradient_steps):
            memory, advice, true = batch(batch_size)
            loss = total = misses(self._mean(memory), advice).square().mean()
            if usual:
                errors = self.policy.estimator(memory) - (true - usual[0]) / usual[1]
                total = loss + self.estimation * errors.square().mean()
            self.policy.optimizer.zero_grad()
            total.backward()
            if recurrent:
                torch.nn.utils.clip_grad_norm_(self.policy.parameters(), LARGEST_GRADIENT)
            self.policy.optimizer.step()
            losses.append(loss.item())
        self._n_updates += gradient_steps
        self.logger.record("train/loss", np.mean(losses))

    def _mean(self, memory: torch.Tensor) -> torch.Tensor:
        """Means (count, m) of the policy after what its cells, or its last hidden layer, hold."""
        if isinstance(self.policy, LstmPolicy):
            memory = self.policy.mlp_extractor.forward_actor(memory)
        return self.policy.action_net(memory)

    def _usual_state(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and spread of the true states in the buffer; a spread of 1 where none differ."""
        buffer, m = self.replay_buffer, self.action_space.shape[0]
        true = buffer.actions[: buffer.size(), :, m:].reshape(-1, buffer.action_dim - m)
        spread = true.std(axis=0)
        return buffer.to_torch(true.mean(axis=0)), buffer.to_torch(np.where(spread > 0, spread, 1))

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[AnyArray, AnyArray]:
        """Actions to take, and the expert's to store, behind them the true state if it is told."""
        advice, buffer = self.env.advice, self.replay_buffer
        starts = buffer.dones[buffer.pos - 1] if buffer.size() else np.ones(n_envs)
        taken, self._memory = self.policy.predict(
            self._last_obs, self._memory, starts, deterministic=True
        )
        lesson = np.hstack([advice, self.env.true_state]) if self.estimation else advice
        return (advice if self.num_timesteps < learning_starts else taken), lesson

    def _of_steps(self, count: int) -> tuple[torch.Tensor, ...]:
        """Last hidden layer at observations drawn at random, the expert's actions, true states."""
        batch = self.replay_buffer.sample(count, env=self._vec_normalize_env)
        features = self.policy.extract_features(batch.observations)
        return self.policy.mlp_extractor.forward_actor(features), *self._lessons(batch.actions)

    def _lessons(self, stored: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The expert's actions and the true states, without numbers unless they are told."""
        m = self.action_space.shape[0]
        return stored[:, :m], stored[:, m:]

    def _of_episodes(self, episodes: AnyArray, steps: int) -> tuple[torch.Tensor, ...]:
        """`_remembered` of episodes at random, about so many steps in all."""
        _, first, last = episodes.T
        count = max(1, round(steps / (last - first + 1).mean()))
        chosen = np.random.randint(len(episodes), size=count)  # noqa: NPY002
        return self._remembered(episodes[chosen])

    def _episodes(self) -> AnyArray:
        """(n, 3) environment, first and last row of the episodes in the buffer.

        A full buffer may have lost the beginning of its oldest rows, so that their episodes are
        left out; rows count from the oldest.
        """
        buffer, found = self.replay_buffer, []
        dones = np.roll(buffer.dones, -self._oldest, axis=0)[: buffer.size()]
        dones[-1] = 1.0
        for env, ends in enumerate(dones.T):
            lasts = np.flatnonzero(ends)
            firsts = np.append(0, lasts[:-1] + 1)
            episodes = np.stack([np.full_like(lasts, env), firsts, lasts], axis=1)
            found.append(episodes[1:] if buffer.full and len(episodes) > 1 else episodes)
        return np.concatenate(found)

    @property
    def _oldest(self) -> int:
        """Oldest row of the buffer."""
        return int(self.replay_buffer.pos) if self.replay_buffer.full else 0

    def _remembered(self, episodes: AnyArray) -> tuple[torch.Tensor, ...]:
        """State of the cells along whole episodes, the expert's actions and the true states."""
        buffer, (env, first, last) = self.replay_buffer, episodes.T
        rows = first + np.arange((last - first).max() + 1)[:, None]
        lasting = rows <= last
        rows = (np.minimum(rows, last) + self._oldest) % buffer.buffer_size
        seen = buffer._normalize_obs(buffer.observations[rows, env], self._vec_normalize_env)
        held, _ = self.policy.lstm_actor(buffer.to_torch(seen))
        return held[lasting], *self._lessons(buffer.to_torch(buffer.actions[rows, env][lasting]))

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        """Names of what a checkpoint holds."""
        return ["policy", "policy.optimizer"], []


def misses(mean: torch.Tensor, advice: torch.Tensor) -> torch.Tensor:
    """Actions less the expert's; zero beyond a limit that the expert reaches."""
    error = mean - advice
    beyond = (advice.abs() >= 1.0) & (error * advice > 0.0)
    return error.masked_fill(beyond, 0.0)
