"""Experiment files: YAML that is read safely, checked key by key and held in dataclasses."""

import difflib
import re
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from agents.environments import check_keywords
from agents.learners.algorithms import (
    DAGGER,
    DISCRETE,
    NUMBER,
    algorithms,
    check_device,
    check_expert,
    check_privileged,
    check_rollout,
    default,
    policies,
    policy_settings,
    settings,
)
from agents.learners.limits import LIMITS, NUMBERS_BETWEEN
from agents.learners.normalization import checked_normalization
from agents.learners.ranges import checked_ranges
from agents.learners.zoo import HINTS, translated
from agents.policy import ACTIVATIONS, LARGEST_LAYER, MOST_LAYERS
from dynamics.description import validate
from dynamics.description.data_file import read_mapping
from flexarm_env import IDS, registered

TEXTS = {  # texts of agent keywords that are no schedules, and their description
    # "auto_" and the initial value
    "ent_coef": (re.compile(r"auto(_\d{1,6}(\.\d{1,9})?)?"), "a number, 'auto' or 'auto_NUMBER'"),
    "target_entropy": (re.compile("auto"), "a number or 'auto'"),
    "noise_type": (re.compile("normal|ornstein-uhlenbeck"), "'normal' or 'ornstein-uhlenbeck'"),
}
DROPPED, N_QUANTILES = "top_quantiles_to_drop_per_net", 25  # of tqc; the default of its policy
FOLDER_NAME = re.compile(r"\w[\w .,()+=@-]{0,99}")
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
    normalize: bool | dict[str, Any] = False  # running statistics; DEFAULTS of normalization.py
    privileged: bool = False  # whether the critic sees the true state

    @property
    def make_kwargs(self) -> dict[str, Any]:
        """Keywords for `gym.make`, `gym.make_vec` and `SB3VecEnv`."""
        return self.kwargs | ({} if self.reward is None else {"reward": self.reward})


@dataclass(frozen=True, kw_only=True)
class AgentConfig:
    """Algorithm and its keywords."""

    name: str
    policy: str | None = None  # by default the algorithm's first of a vector of observations
    warm_start: str = ""  # policy with whose weights the training begins; empty: none
    kwargs: dict[str, Any] = field(default_factory=dict)

    @property
    def gamma(self) -> float | None:
        """Discount of rewards; None for algorithms without one."""
        return self.kwargs.get("gamma", default(self.name, "gamma"))


@dataclass(frozen=True, kw_only=True)
class BaseConfig:
    """Classical controller on which the policy acts, or which it imitates, and what is learned."""

    controller: str
    learned: str = "residual"  # or "advised", "alone", "reference", "distilled"
    scale: float = 0.3  # largest learned action, of the torque limit; shift of the target [rad]
    parameters: dict[str, Any] = field(default_factory=dict)  # empty: the tuned ones


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
    base: BaseConfig | None = None  # None: the policy acts alone
    total_steps: int
    seed: int = 0
    device: str = "cpu"  # "cuda": arms and networks on one NVIDIA GPU
    checkpoint_seconds: float = 10.0  # [s] wall time between checkpoints
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    sweep: dict[str, Any] = field(default_factory=dict)  # ranges of agent.kwargs, for agents.sweep

    def to_dict(self) -> dict[str, Any]:
        """Inverse of `config_from_dict`."""
        data = asdict(self)
        if data["env"]["reward"] is None:
            del data["env"]["reward"]
        for section in ("base", "sweep"):
            if not data[section]:
                del data[section]
        return data


SECTIONS: dict[str, type] = {
    "": Config,
    "env": EnvConfig,
    "agent": AgentConfig,
    "base": BaseConfig,
    "evaluation": EvaluationConfig,
}


def accepted_types(annotation: Any) -> tuple[type, ...]:
    """Types of a field's value in a file, from its annotation; tables are dicts."""
    if annotation is float:
        return NUMBER
    options = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    return tuple(
        dict if is_dataclass(t) else get_origin(t) or t for t in options if t is not NoneType
    )


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
    """Return a checked `Config` from plain tables; `name` is the default name.

    Settings of RL Zoo may stand in `agent.kwargs`.
    """
    try:
        return built(translated(data), name)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def built(data: Any, name: str) -> Config:
    """A checked `Config` from tables without settings of RL Zoo; raises ValueError."""
    checked(data, "")
    for section in SECTIONS:
        if section and section in data:
            checked(data[section], section)
    agent = checked_agent(AgentConfig(**data["agent"]))
    env = checked_environment(EnvConfig(**data["env"]), agent)
    check_counts(agent, env)
    for key, value in checked_ranges(data.get("sweep", {})):
        check_table({key: value}, settings(agent.name), "sweep")
    evaluation = EvaluationConfig(**data.get("evaluation", {}))
    base = BaseConfig(**data["base"]) if "base" in data else None
    rest = {k: v for k, v in data.items() if k not in SECTIONS} | {"base": base}
    config = Config(**({"name": name} | rest), env=env, agent=agent, evaluation=evaluation)
    check_expert(agent.name, base.learned if base else None)
    check_privileged(env.privileged, agent, base)
    check_rollout(agent, env.n_envs)
    check_device(agent.name, config.device, {"env.normalize": env.normalize, "base": base})
    check_steps(config.agent, config.total_steps)
    if not FOLDER_NAME.fullmatch(config.name):
        raise ConfigError(
            f"name must be the plain name of a folder, at most 100 characters, got "
            f"{validate.shown(config.name)}."
        )
    return config


def checked_agent(agent: AgentConfig) -> AgentConfig:
    """The agent with its policy's name; refuses keywords that its algorithm does not have."""
    if agent.name in DISCRETE:
        raise ConfigError(
            f"agent.name: {agent.name} chooses among discrete actions, but an arm takes torques; "
            f"choose one of {list(algorithms())}."
        )
    if agent.name not in algorithms():
        raise ConfigError(
            f"agent.name must be one of {list(algorithms())}, got {validate.shown(agent.name)}."
        )
    known = policies(agent.name)
    policy = known[0] if agent.policy is None else agent.policy
    if policy not in known:
        raise ConfigError(f"agent.policy must be one of {known}, got {validate.shown(policy)}.")
    check_table(agent.kwargs, settings(agent.name), "agent.kwargs")
    check_texts(agent)
    network = agent.kwargs.get("policy_kwargs", {})
    check_table(network, policy_settings(agent.name, policy), "agent.kwargs.policy_kwargs")
    check_network(network)
    return replace(agent, policy=policy)


def checked_environment(env: EnvConfig, agent: AgentConfig) -> EnvConfig:
    """The environment with its registered id; refuses unknown ids, keywords and weights."""
    plain = registered(env.id)
    check_keywords(env.kwargs, "env.kwargs")
    if {**IDS[plain]["kwargs"], **env.kwargs}.get("obs") == "goal":
        raise ConfigError(
            f"env.id: {plain} with obs: goal has dicts as observations, which experiments do not "
            "take; choose an id without goals, or train from Python."
        )
    normalize = checked_normalization(env.normalize, agent.name, agent.gamma, env.stack)
    if env.reward is not None and "reward" in env.kwargs:
        raise ConfigError("env.reward and env.kwargs.reward are one setting; keep one of them.")
    for term, weight in (env.reward or {}).items():
        check_value(weight, NUMBER, f"env.reward.{term}")
    return replace(env, id=plain, normalize=normalize)


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
    if key in HINTS:
        return f"Here it is {HINTS[key]}."
    if "env" in known and any(key in settings(name) for name in algorithms()):
        return f"It belongs to agent.kwargs.{key}."
    close = difflib.get_close_matches(str(key), list(known), n=1)
    return f"Did you mean {close[0]!r}?" if close else f"Known: {sorted(known)}."


def dotted(section: str, key: str) -> str:
    """Path of a key, as in error messages."""
    return f"{section}.{key}" if section else key


def check_texts(agent: AgentConfig) -> None:
    """Refuse texts in place of numbers, except those of TEXTS and schedules 'lin_NUMBER'."""
    for key, value in agent.kwargs.items():
        where = f"agent.kwargs.{key}"
        if not isinstance(value, str):
            continue
        if key in TEXTS:
            pattern, words = TEXTS[key]
            if not pattern.fullmatch(value):
                raise ConfigError(f"{where} must be {words}, got {validate.shown(value)}.")
            continue
        start = value.removeprefix("lin_")
        try:
            number = float(start)
        except ValueError:
            raise ConfigError(
                f"{where} must be a number or 'lin_NUMBER', got {validate.shown(value)}."
            ) from None
        check_value(number if start != value else value, NUMBER, where)
    if "noise_type" in agent.kwargs and "noise_std" not in agent.kwargs:
        raise ConfigError("agent.kwargs.noise_type needs agent.kwargs.noise_std, such as 0.1.")


def check_network(policy_kwargs: dict[str, Any]) -> None:
    """Refuse layer sizes and activations that a stored policy cannot have."""
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
        most = MOST_LAYERS - 2 - policy_kwargs.get("n_lstm_layers", 0)
        if len(sizes) > most or max(sizes, default=1) > LARGEST_LAYER:
            raise ConfigError(
                f"net_arch must have at most {most} layers of at most {LARGEST_LAYER} "
                f"units, got {validate.shown(sizes)}."
            )


def check_steps(agent: AgentConfig, total_steps: int) -> None:
    """Refuse a run that ends before its learner begins, or whose imitation forgets observations."""
    starts, size = (
        agent.kwargs.get(key, default(agent.name, key))
        for key in ("learning_starts", "buffer_size")
    )
    if starts is not None and starts >= total_steps:
        raise ConfigError(
            f"agent.kwargs.learning_starts ({starts:_}) must be below total_steps "
            f"({total_steps:_}), or nothing is learned."
        )
    if agent.kwargs.get("gradient_steps") == 0:
        raise ConfigError(
            "agent.kwargs.gradient_steps must not be 0, or nothing is learned; -1 takes as many as "
            "a rollout has steps."
        )
    if agent.name == DAGGER and size < total_steps:
        raise ConfigError(
            f"agent.kwargs.buffer_size ({size:_}) must be at least total_steps ({total_steps:_}) "
            f"for {DAGGER}, which learns from all observations."
        )


def check_counts(agent: AgentConfig, env: EnvConfig) -> None:
    """Refuse several environments of an algorithm that takes one, and no quantile to learn."""
    if agent.name == "ars" and env.n_envs > 1:
        raise ConfigError(
            f"env.n_envs must be 1 for ars, which runs one episode at a time, got {env.n_envs}."
        )
    drop = agent.kwargs.get(DROPPED, default(agent.name, DROPPED))
    quantiles = agent.kwargs.get("policy_kwargs", {}).get("n_quantiles", N_QUANTILES)
    if drop is not None and drop >= quantiles:
        raise ConfigError(
            f"agent.kwargs.{DROPPED} ({drop}) must be below the number of quantiles ({quantiles})."
        )
