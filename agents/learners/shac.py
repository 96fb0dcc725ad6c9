"""Short-horizon actor-critic: the actor climbs returns by gradients through the arms themselves.

J. Xu, V. Makoviychuk, Y. Narang, F. Ramos, W. Matusik, A. Garg and M. Macklin, Accelerated policy
learning with parallel differentiable simulation, ICLR 2022. The return of a rollout is that of
equation 6; the critic learns TD(lambda), and a slow copy of it values what follows the rollout.
"""

import copy
from collections.abc import Callable
from typing import Any, ClassVar

import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import polyak_update

from agents.learners.arms import Arms, on_host

Schedule = Callable[[float], float]  # of the remaining share of the run


class SHAC(OnPolicyAlgorithm):
    """Keywords are those of stable-baselines3's PPO; `tau` is of the critic's copy.

    An update of the actor takes one gradient of the whole rollout, then the critic takes `n_epochs`
    on minibatches of it (`batch_size` None: on all of it).
    """

    policy_aliases: ClassVar[dict[str, Any]] = {"MlpPolicy": ActorCriticPolicy}

    def __init__(
        self,
        policy: str,
        env: Arms,
        learning_rate: float | Schedule = 2e-3,
        n_steps: int = 32,
        batch_size: int | None = None,
        n_epochs: int = 8,
        gamma: float = 0.99,
        gae_lambda: float = 0.95,
        tau: float = 0.2,
        max_grad_norm: float = 1.0,
        policy_kwargs: dict[str, Any] | None = None,
        seed: int | None = None,
        device: str = "cpu",
    ) -> None:
        super().__init__(
            policy, None, learning_rate, n_steps, gamma, gae_lambda, 0.0, 0.5, max_grad_norm,
            False, -1, policy_kwargs=policy_kwargs, seed=seed, device=device,
            _init_setup_model=False,
        )  # fmt: skip
        self.env, self.n_envs = env, env.num_envs
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self.batch_size, self.n_epochs, self.tau = batch_size, n_epochs, tau
        self.rollout_buffer = None
        self._setup_model()

    def _setup_model(self) -> None:
        """Build the policy, its critic's copy, and start episodes."""
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self.policy = self.policy_class(
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        ).to(self.device)
        self.slow = copy.deepcopy(self.policy)
        self._last_obs = self.env.reset()

    def collect_rollouts(
        self, env: Arms, callback: Any, rollout_buffer: None, n_rollout_steps: int
    ) -> bool:
        """Play a rollout and keep its graph; False if the callback ends the training."""
        callback.on_rollout_start()
        obs = env.detach()["observation"]
        self._seen, self._rewards, self._ended, self._next = [], [], [], []
        for _ in range(n_rollout_steps):
            self._seen.append(obs.detach())
            actions = self.policy.get_distribution(obs).get_actions()
            given, reward, ended, late, info = env.step(actions)
            value = self.slow.predict_values(env.last(info)).squeeze(1)
            self._next.append(torch.where(ended & ~late, 0.0, value))
            self._rewards.append(reward)
            self._ended.append(ended)
            obs = given["observation"]
            self.num_timesteps += env.num_envs
            rewards, dones, infos = on_host(reward.detach(), ended, late, info)
            callback.update_locals({"rewards": rewards, "dones": dones, "infos": infos})
            if not callback.on_step():
                return False
        self._ended[-1] = torch.ones_like(self._ended[-1])  # what follows is the copy's value
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """Update the actor by the rollout's return, then the critic."""
        optimizer = self.policy.optimizer
        self._update_learning_rate(optimizer)
        self._descend(-self._returned().mean() / self.n_steps)
        seen, wanted = torch.cat(self._seen), torch.cat(self._wanted())
        losses = []
        for _ in range(self.n_epochs):
            for rows in torch.randperm(len(seen)).split(self.batch_size or len(seen)):
                found = self.policy.predict_values(seen[rows]).squeeze(1)
                losses.append(torch.nn.functional.mse_loss(found, wanted[rows]))
                self._descend(losses[-1])
        polyak_update(self.policy.parameters(), self.slow.parameters(), self.tau)
        self._n_updates += 1
        self.logger.record("train/value_loss", torch.stack(losses).mean().item())
        self.logger.record("train/std", self.policy.log_std.exp().mean().item())

    def _descend(self, loss: torch.Tensor) -> None:
        self.policy.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
        self.policy.optimizer.step()

    def _returned(self) -> torch.Tensor:
        """(N,) returns of the rollout, each episode's from its own start."""
        total, weight = torch.zeros_like(self._rewards[0]), torch.ones_like(self._rewards[0])
        for reward, ended, value in zip(self._rewards, self._ended, self._next, strict=True):
            total = total + weight * (reward + torch.where(ended, self.gamma * value, 0.0))
            weight = torch.where(ended, 1.0, self.gamma * weight)
        return total

    def _wanted(self) -> list[torch.Tensor]:
        """TD(lambda) targets of the critic, (N,) per step."""
        targets: list[torch.Tensor] = []
        for reward, ended, value in zip(
            self._rewards[::-1], self._ended[::-1], self._next[::-1], strict=True
        ):
            follows = targets[-1] if targets else value
            mixed = torch.where(ended, value, value + self.gae_lambda * (follows - value))
            targets.append((reward + self.gamma * mixed).detach())
        return targets[::-1]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        """Names of what a checkpoint holds."""
        return ["policy", "policy.optimizer", "slow"], []
