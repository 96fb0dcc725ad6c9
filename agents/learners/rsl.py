"""PPO of rsl_rl on a batch of tensors, in the frame of stable-baselines3's algorithms.

Rollouts and updates stay on the device; runs, checkpoints and logs take it as any other algorithm.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from agents.learners.arms import Arms, on_host
from dynamics.description import validate
from dynamics.extras import missing

Schedule = Callable[[float], float]  # of the remaining share of the run
FLOOR_HELD = 0.7  # share of a run with the whole floor of the standard deviation
FLOOR_END = 0.2  # share of the floor that is left at the end


def networks(
    net_arch: list[int] | dict[str, list[int]] = [64, 64],  # noqa: B006
    activation_fn: type[torch.nn.Module] = torch.nn.Tanh,
    log_std_init: float = 0.0,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Keywords of rsl_rl's models of actor and critic, from those of a stable-baselines3 policy."""
    sizes = net_arch if isinstance(net_arch, dict) else {"pi": net_arch, "vf": net_arch}
    if sizes.keys() != {"pi", "vf"} or not all(sizes.values()):
        raise ValueError(
            "net_arch must list layers of the actor (pi) and of the critic (vf), such as [64, 64], "
            f"got {validate.shown(net_arch)}."
        )
    activation = activation_fn.__name__.lower()
    actor, critic = ({"hidden_dims": sizes[x], "activation": activation} for x in ("pi", "vf"))
    distribution = {
        "class_name": "GaussianDistribution",
        "std_type": "log",
        "init_std": float(np.exp(log_std_init)),
    }
    return {**actor, "distribution_cfg": distribution}, critic


def cells_first(
    lstm_hidden_size: int = 256,
    n_lstm_layers: int = 1,
    net_arch: list[int] | dict[str, list[int]] = [64, 64],  # noqa: B006
    activation_fn: type[torch.nn.Module] = torch.nn.Tanh,
    log_std_init: float = 0.0,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Keywords as of `networks`, with LSTM cells before the actor's layers; the critic has none."""
    actor, critic = networks(net_arch, activation_fn, log_std_init)
    cells = {"rnn_hidden_dim": lstm_hidden_size, "rnn_num_layers": n_lstm_layers}
    return actor | cells, critic


class RslPPO(OnPolicyAlgorithm):
    """PPO of rsl_rl on tensors.

    Keywords have the names of stable-baselines3's PPO, except these.

    Parameters
    ----------
    n_steps : of every environment in a rollout; with LSTM cells the length of an episode, and no
        spread starts, or their gradient ends where a rollout begins.
    batch_size : None: the whole rollout. A policy with LSTM cells learns from whole rollouts of
        environments, as many as have so many steps.
    desired_kl : divergence of an update to which the learning rate adapts; None: it does not.
    std_floor : least standard deviation of actions, which falls at the end of the run; None: none.
    critic_first : share of the run in which the critic learns alone, for actors that are good
        already.
    privileged_critic : whether the critic also sees the true state and drawn parameters.
    bootstrap_timeouts : whether returns go on with the critic's value where time ends an episode.
    spread_starts : whether first episodes begin at elapsed times drawn over the length of an
        episode, so that later ones do not end together.
    """

    policy_aliases: ClassVar[dict[str, Any]] = {
        "MlpPolicy": networks,
        "MlpLstmPolicy": cells_first,
    }

    def __init__(
        self,
        policy: str,
        env: Arms,
        learning_rate: float | Schedule = 1e-3,
        n_steps: int = 32,
        batch_size: int | None = None,
        n_epochs: int = 5,
        gamma: float = 0.99,
        gae_lambda: float = 0.95,
        clip_range: float = 0.2,
        ent_coef: float = 0.0,
        vf_coef: float = 1.0,
        max_grad_norm: float = 1.0,
        desired_kl: float | None = None,
        std_floor: float | None = None,
        critic_first: float = 0.0,
        privileged_critic: bool = True,
        bootstrap_timeouts: bool = True,
        spread_starts: bool = True,
        policy_kwargs: dict[str, Any] | None = None,
        seed: int | None = None,
        device: str = "cpu",
    ) -> None:
        super().__init__(
            policy, None, learning_rate, n_steps, gamma, gae_lambda, ent_coef, vf_coef,
            max_grad_norm, False, -1, policy_kwargs=policy_kwargs, seed=seed, device=device,
            _init_setup_model=False,
        )  # fmt: skip
        self.env, self.n_envs = env, env.num_envs
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self.batch_size, self.n_epochs, self.clip_range = batch_size, n_epochs, clip_range
        self.desired_kl, self.std_floor, self.rollout_buffer = desired_kl, std_floor, None
        self.privileged_critic, self.bootstrap_timeouts = privileged_critic, bootstrap_timeouts
        self.spread_starts, self.critic_first = spread_starts, critic_first
        self._setup_model()

    def _setup_model(self) -> None:
        """Build the networks and rsl_rl's algorithm."""
        try:
            from rsl_rl.algorithms import PPO
            from rsl_rl.models import MLPModel, RNNModel
            from rsl_rl.storage import RolloutStorage
        except ModuleNotFoundError as error:
            raise missing(error, "agent.name: rsl-ppo", "tensors") from None
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self._last_obs = obs = grouped(self.env.reset())
        size, rollout = self.action_space.shape[0], self.n_steps * self.n_envs
        true_state = ["privileged"] if self.privileged_critic else []
        groups = {"actor": ["observation"], "critic": ["observation", *true_state]}
        actor, critic = self.policy_class(**self.policy_kwargs)
        model = MLPModel if self.policy_class is networks else RNNModel
        self.policy = torch.nn.ModuleDict({
            "actor": model(obs, groups, "actor", size, **actor),
            "critic": MLPModel(obs, groups, "critic", 1, **critic),
        }).to(self.device)  # fmt: skip
        self.ppo = PPO(
            self.policy["actor"],
            self.policy["critic"],
            RolloutStorage("rl", self.n_envs, self.n_steps, obs, [size], self.device),
            num_learning_epochs=self.n_epochs,
            num_mini_batches=rollout // (self.batch_size or rollout),
            clip_param=self.clip_range,
            gamma=self.gamma,
            lam=self.gae_lambda,
            value_loss_coef=self.vf_coef,
            entropy_coef=self.ent_coef,
            learning_rate=self.lr_schedule(1.0),
            max_grad_norm=self.max_grad_norm,
            schedule="fixed" if self.desired_kl is None else "adaptive",
            desired_kl=self.desired_kl,
            device=self.device,
        )

    def _setup_learn(self, *args: Any, **kwargs: Any) -> Any:
        """Begin a session of training."""
        before = self._last_obs
        begun = super()._setup_learn(*args, **kwargs)
        if self._last_obs is not before:
            with torch.inference_mode():  # zeros: the storage would keep former states for none
                self.policy["actor"].reset(torch.ones(self.n_envs))
        if self.spread_starts:
            self.env.spread()
        return begun

    @torch.inference_mode()
    def collect_rollouts(
        self, env: Arms, callback: Any, rollout_buffer: None, n_rollout_steps: int
    ) -> bool:
        """Fill rsl_rl's storage with a rollout; False if the callback ends the training."""
        callback.on_rollout_start()
        for _ in range(n_rollout_steps):
            actions = self.ppo.act(self._last_obs)
            obs, reward, ended, late, info = env.step(actions)
            self._last_obs = grouped(obs)
            time_outs = {"time_outs": late.float()} if self.bootstrap_timeouts else {}
            self.ppo.process_env_step(self._last_obs, reward, ended, time_outs)
            self.num_timesteps += env.num_envs
            rewards, dones, infos = on_host(reward, ended, late, info)
            callback.update_locals({"rewards": rewards, "dones": dones, "infos": infos})
            if not callback.on_step():
                return False
        self.ppo.compute_returns(self._last_obs)
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """Update the networks with the rollout."""
        if self.desired_kl is None:
            self._update_learning_rate(self.ppo.optimizer)
        self.ppo.learning_rate = self.ppo.optimizer.param_groups[0]["lr"]  # also after a restore
        done = 1.0 - self._current_progress_remaining
        self.policy["actor"].requires_grad_(done >= self.critic_first)
        losses = self.ppo.update()
        self._n_updates += self.n_epochs
        log_std = self.policy["actor"].distribution.log_std_param.data
        if self.std_floor is not None:
            least = self.std_floor * floor_share(done)
            log_std.clamp_(min=float(np.log(least)))
        losses["std"] = float(log_std.exp().mean())
        for name, value in (losses | {"learning_rate": self.ppo.learning_rate}).items():
            self.logger.record(f"train/{name}", value)

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        """Names of what a checkpoint holds."""
        return ["policy", "ppo.optimizer"], []


def floor_share(done: float) -> float:
    """Share of the floor of the standard deviation, by the share of the run that is done.

    The last update may come after the last step asked for.
    """
    late = np.clip((done - FLOOR_HELD) / (1.0 - FLOOR_HELD), 0.0, 1.0)
    return float(FLOOR_END**late)


def grouped(observations: dict[str, torch.Tensor]) -> Any:
    """Observations as rsl_rl takes them."""
    from tensordict import TensorDict

    return TensorDict(observations, batch_size=[len(observations["observation"])])
