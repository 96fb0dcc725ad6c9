"""Algorithms by name, and the settings that a file may give.

They are those of stable-baselines3 and sb3-contrib, and PPO of rsl_rl, which trains on tensors.

A name is that of the class in lower case, with a hyphen before an abbreviation: "ppo", "crossq",
"recurrent-ppo". Settings and their types are those of the class's own signature, so names and
meanings are stable-baselines3's, and settings of RL Zoo can be copied.
"""

import inspect
import re
from collections.abc import Callable, Mapping
from functools import cache
from types import UnionType
from typing import Any, get_args, get_origin

import numpy as np

from dynamics.description import validate

NUMBER = (int, float)
DISCRETE = ("dqn", "maskable-ppo", "qrdqn")  # algorithms without continuous actions
DIFFERENTIATED = ("shac",)  # algorithms that take gradients through the arms
ON_TENSORS = ("rsl-ppo", *DIFFERENTIATED)  # algorithms whose batch is `arms.Arms`
DEVICES = ("cpu", "cuda")
LARGEST_ROLLOUT = 2**24  # steps, summed over all environments
CRITICS = ("a2c", "ppo", "trpo")  # algorithms with `privileged.PrivilegedCriticPolicy`
POLICIES = ("MlpPolicy", "LinearPolicy", "MlpLstmPolicy")  # policies of one vector of observations
# Set by the run, or objects that no file can hold
NOT_IN_FILES = {"policy", "env", "verbose", "tensorboard_log", "seed", "device"}
NOT_IN_FILES |= {"_init_setup_model", "optimize_memory_usage", "action_noise", "lstm_kwargs"}
NOT_IN_FILES |= {"normalize_images"}
NOT_IN_FILES |= {
    f"{owner}_{what}"
    for owner in ("replay_buffer", "rollout_buffer", "features_extractor", "optimizer")
    for what in ("class", "kwargs")
}
NOT_IN_POLICIES = {
    "observation_space",
    "action_space",
    "lr_schedule",
    "normalize_images",
    "use_sde",
}
DAGGER, DISTILLED = "dagger", "distilled"  # an algorithm, and what it makes of a controller
NOISE = {"noise_type": (str,), "noise_std": NUMBER}  # of actions, as in RL Zoo


def name_of(algorithm: type) -> str:
    """Name of an algorithm's class in experiment files."""
    return re.sub("(?<=[a-z])(?=[A-Z]{2})", "-", algorithm.__name__).lower()


@cache
def algorithms() -> dict[str, Any]:
    """Classes of the algorithms with continuous actions, by name; DAgger and SHAC are our own."""
    import sb3_contrib
    import stable_baselines3
    from stable_baselines3.common.base_class import BaseAlgorithm

    from agents.learners.ars import ARS
    from agents.learners.dagger import DAgger
    from agents.learners.recurrent import RecurrentPPO
    from agents.learners.rsl import RslPPO
    from agents.learners.shac import SHAC

    found = [
        thing
        for package in (stable_baselines3, sb3_contrib)
        for thing in vars(package).values()
        if isinstance(thing, type) and issubclass(thing, BaseAlgorithm)
    ]
    own = (ARS, DAgger, RecurrentPPO, RslPPO, SHAC)
    named = {name_of(algorithm): algorithm for algorithm in (*found, *own)}
    return {name: named[name] for name in sorted(named) if name not in DISCRETE}


def check_device(algorithm: str, device: str, given: Mapping[str, Any]) -> None:
    """Refuse a GPU for an algorithm on arrays, and settings that one on tensors does not have.

    `given` are the values of such settings.
    """
    if device not in DEVICES:
        raise ValueError(f"device must be one of {list(DEVICES)}, got {validate.shown(device)}.")
    if algorithm not in ON_TENSORS:
        if device != "cpu":
            raise ValueError(
                f"device must be 'cpu' for {algorithm}, got {device!r}; on a GPU trains "
                f"agent.name: {ON_TENSORS[0]}."
            )
        return
    for where, value in given.items():
        if value:
            raise ValueError(
                f"{where} is not for {algorithm}: leave it out, or take agent.name: ppo."
            )


def check_expert(algorithm: str, learned: str | None) -> None:
    """Refuse an imitation without an expert, and an expert for another algorithm."""
    if (algorithm == DAGGER) != (learned == DISTILLED):
        raise ValueError(
            f"agent.name: {DAGGER} and base.learned: {DISTILLED} go together, got {algorithm} and "
            f"{validate.shown(learned)}; the base is the expert that {DAGGER} imitates."
        )


def check_privileged(wanted: bool, agent: Any, base: Any) -> None:
    """Refuse observations with a part for the critic where the learner takes one vector."""
    if not wanted:
        return
    if agent.name not in CRITICS:
        raise ValueError(
            f"env.privileged is for {', '.join(CRITICS)}, got {agent.name}; leave it out "
            "(rsl-ppo has agent.kwargs.privileged_critic)."
        )
    sampled = agent.kwargs.get("sub_sampling_factor", 1) > 1
    for where, given in {"base": base, "agent.kwargs.sub_sampling_factor": sampled}.items():
        if given:
            raise ValueError(f"env.privileged and {where} exclude each other; leave one out.")


def check_rollout(agent: Any, n_envs: int) -> None:
    """Refuse a rollout too large, and minibatches that do not make it up."""
    if "gae_lambda" not in settings(agent.name):  # only on-policy algorithms have rollouts
        return
    steps, batch = (
        agent.kwargs.get(key, default(agent.name, key)) for key in ("n_steps", "batch_size")
    )
    if batch is not None and steps * n_envs % batch:
        raise ValueError(
            f"agent.kwargs.batch_size ({batch}) must divide n_steps x n_envs ({steps * n_envs})."
        )
    whole = agent.name in ON_TENSORS and agent.policy == "MlpLstmPolicy"
    if batch is not None and whole and batch % steps:
        raise ValueError(
            f"agent.kwargs.batch_size ({batch}) must be a multiple of n_steps ({steps}) for "
            f"MlpLstmPolicy of {agent.name}, whose minibatches are rollouts of some environments."
        )
    if steps * n_envs > LARGEST_ROLLOUT:
        raise ValueError(
            f"n_steps x n_envs must be at most {LARGEST_ROLLOUT:_}, got {steps * n_envs:_}."
        )


def policies(name: str) -> list[str]:
    """Names of the policies that an algorithm has for one vector of observations."""
    known = algorithms()[name].policy_aliases
    return [policy for policy in POLICIES if policy in known]


@cache
def settings(name: str) -> dict[str, tuple[type, ...]]:
    """Keywords of an algorithm that a file may give, with the types of their values."""
    algorithm = algorithms()[name]
    takes_noise = "action_noise" in inspect.signature(algorithm).parameters
    return typed(algorithm) | (NOISE if takes_noise else {})


@cache
def policy_settings(name: str, policy: str) -> dict[str, tuple[type, ...]]:
    """Keywords of an algorithm's policy that a file may give, with the types of their values."""
    found = typed(algorithms()[name].policy_aliases[policy])
    return {key: types for key, types in found.items() if key not in NOT_IN_POLICIES}


def default(name: str, key: str) -> Any:
    """Default of an algorithm's keyword; None if it has no such keyword."""
    parameter = inspect.signature(algorithms()[name]).parameters.get(key)
    return None if parameter is None else parameter.default


def typed(thing: Any) -> dict[str, tuple[type, ...]]:
    """Keywords of a class that a file can hold, with the types of their values."""
    parameters = inspect.signature(thing).parameters.items()
    kinds = {key: plain_types(parameter.annotation) for key, parameter in parameters}
    return {key: types for key, types in kinds.items() if types and key not in NOT_IN_FILES}


def plain_types(annotation: Any) -> tuple[type, ...]:
    """Types of a keyword's value in a file; schedules and classes are named by a text."""
    options = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    found: list[type] = []
    for option in options:
        kind = get_origin(option) or option
        if kind is float:
            found += NUMBER
        elif kind in (int, bool, str, list, dict):
            found.append(kind)
        elif kind in (Callable, type):
            found.append(str)
    return tuple(dict.fromkeys(found))


def learner_kwargs(given: Mapping[str, Any], action_shape: tuple[int, ...]) -> dict[str, Any]:
    """Keywords of the learner's class: texts of the file become schedules, classes and noise."""
    import torch
    from stable_baselines3.common import noise

    activations = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU, "elu": torch.nn.ELU}
    noises = {
        "normal": noise.NormalActionNoise,
        "ornstein-uhlenbeck": noise.OrnsteinUhlenbeckActionNoise,
    }
    kwargs = dict(given)
    network = kwargs["policy_kwargs"] = dict(kwargs.pop("policy_kwargs", {}))
    if "activation_fn" in network:
        network["activation_fn"] = activations[network["activation_fn"]]
    for key, value in kwargs.items():
        if isinstance(value, str) and value.startswith("lin_"):
            kwargs[key] = falling(float(value.removeprefix("lin_")))
    kind, deviation = kwargs.pop("noise_type", "normal"), kwargs.pop("noise_std", None)
    if deviation is not None:
        zero = np.zeros(action_shape)
        kwargs["action_noise"] = noises[kind](mean=zero, sigma=zero + deviation)
    return kwargs


def falling(start: float) -> Any:
    """Schedule from `start` to zero, a function of the remaining share of the run.

    The last update may come after the last step asked for, at a share below zero.
    """
    return lambda remaining: start * max(remaining, 0.0)
