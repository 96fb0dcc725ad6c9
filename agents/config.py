"""Experiment files: YAML that is read safely, checked key by key and held in dataclasses."""

import difflib
import re
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from agents.environments import check_keywords
from agents.policy import ACTIVATIONS, LARGEST_LAYER, MOST_LAYERS, MOST_STACKED
from dynamics.description import validate
from dynamics.description.data_file import read_mapping
from flexarm_env import registered

NUMBER = (int, float)
NUMBER_OR_TEXT = (int, float, str)
# Keys whose value may be "lin_3.0e-4", which falls linearly to zero over the run
SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")

COMMON_KWARGS: dict[str, tuple[type, ...]] = {
    "learning_rate": NUMBER_OR_TEXT,
    "batch_size": (int,),
    "gamma": NUMBER,
    "ent_coef": NUMBER,
    "stats_window_size": (int,),
    "policy_kwargs": (dict,),
}
# Names and meanings are stable-baselines3's, so settings of RL Zoo can be copied.
AGENT_KWARGS: dict[str, dict[str, tuple[type, ...]]] = {
    "ppo": COMMON_KWARGS
    | {
        "n_steps": (int,),
        "n_epochs": (int,),
        "gae_lambda": NUMBER,
        "clip_range": NUMBER_OR_TEXT,
        "clip_range_vf": NUMBER_OR_TEXT,
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
        "ent_coef": NUMBER_OR_TEXT,
        "target_update_interval": (int,),
        "target_entropy": NUMBER_OR_TEXT,
    },
}
POLICY_KWARGS: dict[str, tuple[type, ...]] = {
    "net_arch": (list, dict),
    "activation_fn": (str,),
    "log_std_init": NUMBER,
    "ortho_init": (bool,),
    "n_critics": (int,),
}
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
    "gamma": (0.0, 1.0),
    "stats_window_size": (1, 10**6),
    "n_steps": (1, 2**20),
    "n_epochs": (1, 1000),
    "gae_lambda": (0.0, 1.0),
    "buffer_size": (1, 10**7),
    "learning_starts": (0, 10**9),
    "tau": (0.0, 1.0),
    "train_freq": (1, 10**6),
    "gradient_steps": (-1, 10**6),
    "target_update_interval": (1, 10**9),
    "n_critics": (1, 10),
    "log_std_init": (-20.0, 10.0),
}
NUMBERS_BETWEEN = (-1e6, 1e6)
TEXTS = {  # texts that SAC accepts instead of a number
    "ent_coef": re.compile(r"auto(_\d{1,6}(\.\d{1,9})?)?"),  # "auto_" and the initial value
    "target_entropy": re.compile("auto"),
}
LARGEST_ROLLOUT = 2**24  # steps, summed over all environments
FOLDER_NAME = re.compile(r"\w[\w .,()+=@-]{0,99}")

# Keys of RL Zoo, and their place here
ZOO_NAMES = {
    "n_timesteps": "total_steps",
    "n_envs": "env.n_envs",
    "env_kwargs": "env.kwargs",
    "policy": "agent.policy",
    "policy_kwargs": "agent.kwargs.policy_kwargs",
    "normalize": "nothing: observations are scaled by the environment",
    "env_wrapper": "env.reward (a table of reward terms and weights)",
    "frame_stack": "env.stack",
}
TYPE_NAMES = {int: "an int", float: "a float", str: "text", bool: "true or false"}
TYPE_NAMES |= {list: "a list", dict: "a table"}


class ConfigError(ValueError):
    """An experiment file that cannot be used; the message is one sentence for the user."""


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The environment and the size of its batch."""

    id: str
    kwargs: dict[str, Any] = field(default_factory=dict)  # keywords of the environment
    reward: dict[str, float] | None = None  # weights of the reward terms; None: the task's
    n_envs: int = 1
    stack: int = 1  # latest observations that the policy sees

    @property
    def make_kwargs(self) -> dict[str, Any]:
        """Keywords for `gym.make`, `gym.make_vec` and `SB3VecEnv`."""
        return self.kwargs | ({} if self.reward is None else {"reward": self.reward})


@dataclass(frozen=True, kw_only=True)
class AgentConfig:
    """Algorithm of stable-baselines3 and its keywords."""

    name: str
    policy: str = "MlpPolicy"
    kwargs: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """Final evaluation: number of episodes and their first seed (seed, seed + 1, ...)."""

    episodes: int = 100
    seed: int = 10_000


@dataclass(frozen=True, kw_only=True)
class Config:
    """One experiment."""

    name: str = "run"  # by default the name of the file
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


SECTIONS: dict[str, type] = {
    "": Config,
    "env": EnvConfig,
    "agent": AgentConfig,
    "evaluation": EvaluationConfig,
}


def accepted_types(annotation: Any) -> tuple[type, ...]:
    """Types of a field's value in a file, from its annotation; tables are dicts."""
    if is_dataclass(annotation):
        return (dict,)
    if annotation is float:
        return NUMBER
    options = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    return tuple(get_origin(t) or t for t in options if t is not NoneType)


SCHEMA = {  # section: field: accepted types
    name: {key: accepted_types(hint) for key, hint in get_type_hints(section).items()}
    for name, section in SECTIONS.items()
}
REQUIRED = {  # section: fields without a default
    name: [f.name for f in fields(section) if f.default is f.default_factory is MISSING]
    for name, section in SECTIONS.items()
}


def load_config(path: str | Path) -> Config:
    """Read and check one YAML experiment file; raises `ConfigError`."""
    path = Path(path)
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file.")
    try:
        return config_from_dict(read_mapping(path), name=path.stem)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def config_from_dict(data: Any, *, name: str = "run") -> Config:
    """Return a checked `Config` from plain tables; `name` is the default name."""
    checked(data, "")
    for section in SECTIONS:
        if section:
            checked(data.get(section, {}), section)
    agent = AgentConfig(**data["agent"])
    if agent.name not in AGENT_KWARGS:
        raise ConfigError(
            f"agent.name must be one of {sorted(AGENT_KWARGS)}, got {validate.shown(agent.name)}."
        )
    if agent.policy != "MlpPolicy":
        raise ConfigError(f"agent.policy must be 'MlpPolicy', got {validate.shown(agent.policy)}.")
    check_table(agent.kwargs, AGENT_KWARGS[agent.name], "agent.kwargs")
    check_texts(agent)
    check_network(agent.kwargs.get("policy_kwargs", {}))
    env = checked_environment(EnvConfig(**data["env"]))
    check_batch(agent, env)
    evaluation = EvaluationConfig(**data.get("evaluation", {}))
    rest = {k: v for k, v in data.items() if k not in SECTIONS}
    config = Config(**({"name": name} | rest), env=env, agent=agent, evaluation=evaluation)
    if not FOLDER_NAME.fullmatch(config.name):
        raise ConfigError(
            f"name must be the plain name of a folder, at most 100 characters, got "
            f"{validate.shown(config.name)}."
        )
    return config


def checked_environment(env: EnvConfig) -> EnvConfig:
    """The environment with its registered id; refuses unknown ids, keywords and weights."""
    try:
        plain = registered(env.id)
        check_keywords(env.kwargs, "env.kwargs")
    except ValueError as error:
        raise ConfigError(str(error)) from None
    for term, weight in (env.reward or {}).items():
        check_value(weight, NUMBER, f"env.reward.{term}")
    return replace(env, id=plain)


def checked(table: Any, section: str) -> None:
    """Refuse a section with unknown or missing keys, or wrong values."""
    check_table(table, SCHEMA[section], section)
    missing = [key for key in REQUIRED[section] if key not in table]
    if missing:
        raise ConfigError(f"{dotted(section, missing[0])} is missing.")


def check_table(table: Any, known: Mapping[str, tuple[type, ...]], section: str) -> None:
    """Refuse unknown keys and wrong values in one table."""
    if not isinstance(table, Mapping):
        raise ConfigError(f"{section or 'the file'} must be a table, got {validate.shown(table)}.")
    for key, value in table.items():
        if key not in known:
            raise ConfigError(
                f"unknown key {validate.shown(dotted(section, str(key)))}. {hint(key, known)}"
            )
        check_value(value, known[key], dotted(section, key))


def check_value(value: Any, types: tuple[type, ...], where: str) -> None:
    """Refuse a value of the wrong type or size; a bool is never a number."""
    if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
        wanted = "a number" if types == NUMBER else " or ".join(TYPE_NAMES[t] for t in types)
        remedy = number_remedy(value, types)
        raise ConfigError(f"{where} must be {wanted}, got {validate.shown(value)}{remedy}.")
    if isinstance(value, int | float) and not isinstance(value, bool):
        low, high = LIMITS.get(where.rpartition(".")[2], NUMBERS_BETWEEN)
        if not low <= value <= high:  # also refuses NaN
            raise ConfigError(
                f"{where} must be between {low:_} and {high:_}, got {validate.shown(value)}."
            )


def number_remedy(value: Any, types: tuple[type, ...]) -> str:
    """Remedy for a number that YAML 1.1 reads as text, or a float in place of an int."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
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
    """Remedy for an unknown key: its place here, the closest known key, or all known keys."""
    if key in ZOO_NAMES:
        return f"Here it is {ZOO_NAMES[key]}."
    if any(key in kwargs for kwargs in AGENT_KWARGS.values()) and "env" in known:
        return f"It belongs to agent.kwargs.{key}."
    close = difflib.get_close_matches(str(key), list(known), n=1)
    return f"Did you mean {close[0]!r}?" if close else f"Known: {sorted(known)}."


def dotted(section: str, key: str) -> str:
    """Path of a key, as in error messages."""
    return f"{section}.{key}" if section else key


def check_texts(agent: AgentConfig) -> None:
    """Refuse texts in place of numbers, except schedules 'lin_NUMBER' and SAC's 'auto'."""
    for key, pattern in TEXTS.items():
        value = agent.kwargs.get(key)
        if isinstance(value, str) and not pattern.fullmatch(value):
            raise ConfigError(
                f"agent.kwargs.{key} must be a number or 'auto', for ent_coef also 'auto_NUMBER', "
                f"got {validate.shown(value)}."
            )
    for key in SCHEDULES:
        value = agent.kwargs.get(key)
        if isinstance(value, str):
            start = value.removeprefix("lin_")
            where = f"agent.kwargs.{key}"
            try:
                number = float(start)
            except ValueError:
                raise ConfigError(
                    f"{where} must be a number or 'lin_NUMBER', got {validate.shown(value)}."
                ) from None
            check_value(number if start != value else value, NUMBER, where)


def check_network(policy_kwargs: dict[str, Any]) -> None:
    """Refuse layer sizes and activations that a stored policy cannot have."""
    check_table(policy_kwargs, POLICY_KWARGS, "agent.kwargs.policy_kwargs")
    activation = policy_kwargs.get("activation_fn", "tanh")
    if activation not in ACTIVATIONS:
        raise ConfigError(
            f"activation_fn must be one of {list(ACTIVATIONS)}, got {validate.shown(activation)}."
        )
    net_arch = policy_kwargs.get("net_arch", [])
    for sizes in net_arch.values() if isinstance(net_arch, dict) else [net_arch]:
        if not isinstance(sizes, list) or not all(type(n) is int and n > 0 for n in sizes):
            raise ConfigError(
                f"net_arch must list layer sizes such as [64, 64], got {validate.shown(sizes)}."
            )
        if len(sizes) > MOST_LAYERS - 2 or max(sizes, default=1) > LARGEST_LAYER:
            raise ConfigError(
                f"net_arch must have at most {MOST_LAYERS - 2} layers of at most {LARGEST_LAYER} "
                f"units, got {validate.shown(sizes)}."
            )


def check_batch(agent: AgentConfig, env: EnvConfig) -> None:
    """Refuse a PPO rollout that is too large or not a multiple of the minibatch."""
    if agent.name != "ppo":
        return
    rollout = agent.kwargs.get("n_steps", 2048) * env.n_envs
    batch = agent.kwargs.get("batch_size", 64)
    if rollout % batch:
        raise ConfigError(
            f"agent.kwargs.batch_size ({batch}) must divide n_steps x n_envs ({rollout})."
        )
    if rollout > LARGEST_ROLLOUT:
        raise ConfigError(f"n_steps x n_envs must be at most {LARGEST_ROLLOUT:_}, got {rollout:_}.")
