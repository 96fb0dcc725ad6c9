"""Experiment files: one YAML each, read safely, checked key by key, kept as dataclasses."""

import difflib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import yaml

NUMBER = (int, float)
SCHEDULE = (int, float, str)  # 3.0e-4, or "lin_3.0e-4": falls linearly to zero over the run

COMMON_KWARGS: dict[str, tuple[type, ...]] = {
    "learning_rate": SCHEDULE,
    "batch_size": (int,),
    "gamma": NUMBER,
    "ent_coef": NUMBER,
    "stats_window_size": (int,),
    "policy_kwargs": (dict,),
}
# Names and meaning are stable-baselines3's, so settings move over from RL Zoo unchanged.
AGENT_KWARGS: dict[str, dict[str, tuple[type, ...]]] = {
    "ppo": COMMON_KWARGS
    | {
        "n_steps": (int,),
        "n_epochs": (int,),
        "gae_lambda": NUMBER,
        "clip_range": SCHEDULE,
        "clip_range_vf": SCHEDULE,
        "normalize_advantage": (bool,),
        "vf_coef": NUMBER,
        "max_grad_norm": NUMBER,
        "target_kl": NUMBER,
    },
    "sac": COMMON_KWARGS
    | {
        "buffer_size": (int,),
        "learning_starts": (int,),
        "tau": NUMBER,
        "train_freq": (int,),
        "gradient_steps": (int,),
        "ent_coef": (int, float, str),
        "target_update_interval": (int,),
        "target_entropy": (int, float, str),
    },
}
POLICY_KWARGS: dict[str, tuple[type, ...]] = {
    "net_arch": (list, dict),
    "activation_fn": (str,),
    "log_std_init": NUMBER,
    "ortho_init": (bool,),
    "n_critics": (int,),
}
ACTIVATIONS = ("tanh", "relu", "elu")

# Where RL Zoo writes a setting, and where it stands here.
ZOO_NAMES = {
    "n_timesteps": "total_steps",
    "n_envs": "env.n_envs",
    "env_kwargs": "env.kwargs",
    "policy": "agent.policy",
    "policy_kwargs": "agent.kwargs.policy_kwargs",
    "normalize": "nothing: observations are scaled by the environment",
    "env_wrapper": "env.reward (a table of reward terms and weights)",
}
TYPE_NAMES = {int: "an int", float: "a float", str: "text", bool: "true or false"}
TYPE_NAMES |= {list: "a list", dict: "a table"}


class ConfigError(ValueError):
    """An experiment file that cannot be used; the message is one sentence for the user."""


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """Which environment, how many copies in one batch."""

    id: str
    kwargs: dict[str, Any] = field(default_factory=dict)  # keywords of the environment
    reward: dict[str, float] | None = None  # weights of the reward terms; None: the task's own
    n_envs: int = 1

    @property
    def make_kwargs(self) -> dict[str, Any]:
        """Keywords for `gym.make` and its batch siblings."""
        return self.kwargs | ({} if self.reward is None else {"reward": self.reward})


@dataclass(frozen=True, kw_only=True)
class AgentConfig:
    """Which algorithm of stable-baselines3, with its own keywords."""

    name: str
    policy: str = "MlpPolicy"
    kwargs: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """The final judgement: how many episodes, from which seeds (seed, seed + 1, ...)."""

    episodes: int = 100
    seed: int = 10_000


@dataclass(frozen=True, kw_only=True)
class Config:
    """One experiment."""

    name: str
    env: EnvConfig
    agent: AgentConfig
    total_steps: int
    seed: int = 0
    checkpoint_seconds: float = 10.0  # [s] wall time between checkpoints
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)

    def to_dict(self) -> dict[str, Any]:
        """Inverse of `config_from_dict`."""
        data = asdict(self)
        if data["env"]["reward"] is None:
            del data["env"]["reward"]
        return data


SCHEMA: dict[str, dict[str, tuple[type, ...]]] = {
    "": {
        "name": (str,),
        "env": (dict,),
        "agent": (dict,),
        "total_steps": (int,),
        "seed": (int,),
        "checkpoint_seconds": NUMBER,
        "evaluation": (dict,),
    },
    "env": {"id": (str,), "kwargs": (dict,), "reward": (dict,), "n_envs": (int,)},
    "agent": {"name": (str,), "policy": (str,), "kwargs": (dict,)},
    "evaluation": {"episodes": (int,), "seed": (int,)},
}
REQUIRED = {"": ("env", "agent", "total_steps"), "env": ("id",), "agent": ("name",)}
POSITIVE = {"total_steps", "n_envs", "episodes", "checkpoint_seconds", "batch_size", "n_steps"}
POSITIVE |= {"n_epochs", "buffer_size", "train_freq", "n_critics"}
NOT_NEGATIVE = {"seed", "learning_starts"}


def load_config(path: str | Path) -> Config:
    """Read one YAML experiment file; refuse anything doubtful with a `ConfigError`."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not UTF-8 text.") from None
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" near line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{path}: is not valid YAML{where}.") from None
    try:
        return config_from_dict(data, name=path.stem)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def config_from_dict(data: Any, *, name: str = "run") -> Config:
    """A checked `Config` from plain tables; `name` is used where the data gives none."""
    checked(data, "")
    for section in ("env", "agent", "evaluation"):
        checked(data.get(section, {}), section)
    agent = AgentConfig(**data["agent"])
    if agent.name not in AGENT_KWARGS:
        raise ConfigError(f"agent.name must be one of {sorted(AGENT_KWARGS)}, got {agent.name!r}.")
    if agent.policy != "MlpPolicy":
        raise ConfigError(f"agent.policy must be 'MlpPolicy', got {agent.policy!r}.")
    check_table(agent.kwargs, AGENT_KWARGS[agent.name], "agent.kwargs")
    check_schedules(agent)
    check_network(agent.kwargs.get("policy_kwargs", {}))
    env = EnvConfig(**data["env"])
    for term, weight in (env.reward or {}).items():
        check_type(weight, NUMBER, f"env.reward.{term}")
    check_batch(agent, env)
    evaluation = EvaluationConfig(**data.get("evaluation", {}))
    rest = {k: v for k, v in data.items() if k not in ("env", "agent", "evaluation")}
    return Config(**({"name": name} | rest), env=env, agent=agent, evaluation=evaluation)


def checked(table: Any, section: str) -> None:
    """Refuse a section with unknown or missing keys, or values of the wrong type."""
    check_table(table, SCHEMA[section], section)
    missing = [key for key in REQUIRED.get(section, ()) if key not in table]
    if missing:
        raise ConfigError(f"{dotted(section, missing[0])} is missing.")


def check_table(table: Any, known: Mapping[str, tuple[type, ...]], section: str) -> None:
    """Refuse unknown keys and wrong types in one table."""
    if not isinstance(table, Mapping):
        raise ConfigError(f"{section or 'the file'} must be a table, got {table!r}.")
    for key, value in table.items():
        if key not in known:
            raise ConfigError(f"unknown key {dotted(section, str(key))!r}. {hint(key, known)}")
        check_type(value, known[key], dotted(section, key))
        if key in POSITIVE and not value > 0:
            raise ConfigError(f"{dotted(section, key)} must be positive, got {value!r}.")
        if key in NOT_NEGATIVE and not value >= 0:
            raise ConfigError(f"{dotted(section, key)} must not be negative, got {value!r}.")


def check_type(value: Any, types: tuple[type, ...], where: str) -> None:
    """Refuse a value of the wrong type; a bool is never a number."""
    stray_bool = isinstance(value, bool) and bool not in types
    nan = isinstance(value, float) and value != value
    if isinstance(value, types) and not stray_bool and not nan:
        return
    wanted = "a number" if types == NUMBER else " or ".join(TYPE_NAMES[t] for t in types)
    raise ConfigError(f"{where} must be {wanted}, got {value!r}{number_remedy(value, types)}.")


def number_remedy(value: Any, types: tuple[type, ...]) -> str:
    """What to write when YAML 1.1 has read a number as text, or a float stands for an int."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return ""
    if isinstance(value, bool):
        return ""
    if float not in types and int in types:
        return f" (write {int(number):_})" if number.is_integer() else ""
    if isinstance(value, str) and "e" in value.lower():
        mantissa, exponent = value.lower().split("e")
        exponent = exponent if exponent[0] in "+-" else f"+{exponent}"
        return f" (YAML reads this as text: write {float(mantissa)}e{exponent})"
    return ""


def hint(key: Any, known: Mapping[str, Any]) -> str:
    """Where an RL Zoo name belongs, the closest known key, or all of them."""
    if key in ZOO_NAMES:
        return f"Here it is {ZOO_NAMES[key]}."
    if any(key in kwargs for kwargs in AGENT_KWARGS.values()) and "env" in known:
        return f"It belongs to agent.kwargs.{key}."
    close = difflib.get_close_matches(str(key), list(known), n=1)
    return f"Did you mean {close[0]!r}?" if close else f"Known: {sorted(known)}."


def dotted(section: str, key: str) -> str:
    """The path of a key as it is written in messages."""
    return f"{section}.{key}" if section else key


def check_schedules(agent: AgentConfig) -> None:
    """Text is allowed for a schedule only as 'lin_NUMBER'."""
    for key, types in AGENT_KWARGS[agent.name].items():
        value = agent.kwargs.get(key)
        if types == SCHEDULE and isinstance(value, str):
            start = value.removeprefix("lin_")
            where = f"agent.kwargs.{key}"
            try:
                float(start)
            except ValueError:
                raise ConfigError(
                    f"{where} must be a number or 'lin_NUMBER', got {value!r}."
                ) from None
            if start == value:
                check_type(value, NUMBER, where)


def check_network(policy_kwargs: dict[str, Any]) -> None:
    """The network: sizes per layer, and an activation this package can store."""
    check_table(policy_kwargs, POLICY_KWARGS, "agent.kwargs.policy_kwargs")
    activation = policy_kwargs.get("activation_fn", "tanh")
    if activation not in ACTIVATIONS:
        raise ConfigError(f"activation_fn must be one of {list(ACTIVATIONS)}, got {activation!r}.")
    net_arch = policy_kwargs.get("net_arch", [])
    for sizes in net_arch.values() if isinstance(net_arch, dict) else [net_arch]:
        if not isinstance(sizes, list) or not all(type(n) is int and n > 0 for n in sizes):
            raise ConfigError(f"net_arch must list layer sizes such as [64, 64], got {sizes!r}.")


def check_batch(agent: AgentConfig, env: EnvConfig) -> None:
    """PPO's minibatches must tile the rollout."""
    if agent.name != "ppo":
        return
    rollout = agent.kwargs.get("n_steps", 2048) * env.n_envs
    batch = agent.kwargs.get("batch_size", 64)
    if rollout % batch:
        raise ConfigError(
            f"agent.kwargs.batch_size ({batch}) must divide n_steps x n_envs ({rollout})."
        )
