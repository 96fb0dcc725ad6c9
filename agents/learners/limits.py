"""Smallest and largest values of numbers in an experiment file."""

from agents.policy import LARGEST_LAYER, MOST_LAYERS, MOST_STACKED

COUNTS = "policy_delay cg_max_steps line_search_max_iter n_critic_updates sub_sampling_factor "
COUNTS += "n_delta n_top n_eval_episodes"
POSITIVE = "clip_range clip_range_vf max_grad_norm target_kl delta_std"
NOT_NEGATIVE = "vf_coef cg_damping rms_prop_eps target_policy_noise target_noise_clip clip_mean "
NOT_NEGATIVE += "top_quantiles_to_drop_per_net"
# Smallest and largest value by key; NUMBERS_BETWEEN for all other keys.
LIMITS: dict[str, tuple[float, float]] = {
    "total_steps": (1, 10**11),
    "n_envs": (1, 65_536),
    "stack": (1, MOST_STACKED),
    "seed": (0, 2**31 - 1),
    "checkpoint_seconds": (1e-3, 1e6),
    "episodes": (1, 10_000),
    "learning_rate": (0.0, 10.0),
    "batch_size": (1, 2**20),
    "stats_window_size": (1, 10**6),
    "n_steps": (1, 2**20),
    "n_epochs": (1, 1000),
    "buffer_size": (1, 10**7),
    "learning_starts": (0, 10**9),
    "train_freq": (1, 10**6),
    "gradient_steps": (-1, 10**6),
    "estimation": (0.0, 1e3),
    "target_update_interval": (1, 10**9),
    "n_critics": (1, 10),
    "log_std_init": (-20.0, 10.0),
    "noise_std": (0.0, 10.0),
    "scale": (0.0, 2.0),
    "n_quantiles": (1, 1000),
    "lstm_hidden_size": (1, LARGEST_LAYER),
    "n_lstm_layers": (1, MOST_LAYERS - 2),
    **dict.fromkeys(("gamma", "gae_lambda", "tau", "critic_first"), (0.0, 1.0)),
    **dict.fromkeys(COUNTS.split(), (1, 10_000)),
    **dict.fromkeys(("desired_kl", "std_floor"), (1e-6, 10.0)),
    "line_search_shrinking_factor": (0.01, 0.99),
    **dict.fromkeys(POSITIVE.split(), (1e-9, 1e6)),
    **dict.fromkeys(NOT_NEGATIVE.split(), (0.0, 1e6)),
}
NUMBERS_BETWEEN = (-1e6, 1e6)
