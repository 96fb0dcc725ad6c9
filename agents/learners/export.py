"""Actors of trained learners as stored policies, which need neither torch nor pickle."""

import json
import pickle
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile, is_zipfile

import numpy as np

from agents.environments import observation_kind
from agents.learners.algorithms import CRITICS, DAGGER, algorithms, name_of
from agents.learners.wrapped import lost_normalization, other_actions
from agents.policy import (
    ACTIVATIONS,
    LARGEST_LAYER,
    MOST_LAYERS,
    Normalization,
    Policy,
    PolicyError,
)
from agents.sentences import one_line
from dynamics.description import validate
from dynamics.types import AnyArray

# Algorithms of zips by the module of their policy; TD3 and DDPG share theirs.
ZIPPED = {
    "agents.learners.recurrent": "recurrent-ppo",
    "stable_baselines3.sac.policies": "sac",
    "stable_baselines3.td3.policies": "td3",
    "sb3_contrib.ars.policies": "ars",
    "sb3_contrib.common.recurrent.policies": "recurrent-ppo",
    "sb3_contrib.crossq.policies": "crossq",
    "sb3_contrib.tqc.policies": "tqc",
}
LOADED = sorted({*ZIPPED.values(), *CRITICS, DAGGER, "ddpg"})  # algorithms of zips
ON_POLICY = ("agents.learners.privileged", "stable_baselines3.common.policies")  # a2c, ppo, trpo
COLD = ("ars", "crossq")  # algorithms without a warm start
LAYOUT = {  # what a policy and a model it begins share, and the remedy otherwise
    "observation": "change env, or take a policy of this observation",
    "base": "change base, or take a policy that acts on the same one",
    "stack": "change env.stack",
    "recurrent": "change agent.policy, or agent.kwargs.policy_kwargs.n_lstm_layers",
    "layer_sizes": "change agent.kwargs.policy_kwargs.net_arch, or env",
    "activation": "change agent.kwargs.policy_kwargs.activation_fn",
    "squashing": "take an algorithm that limits actions alike",
}


def export_policy(model: Any, about: dict[str, Any]) -> Policy:
    """The actor of a model of one of the algorithms, with the statistics of its VecNormalize.

    Raises
    ------
    PolicyError : for what a stored policy does not have, and for a model without its VecNormalize.
    """
    if lost_normalization(model):
        raise PolicyError(
            "The model was trained with VecNormalize, whose statistics it does not hold; load it "
            "with env=VecNormalize.load(file, envs)."
        )
    return network(model, about)


def network(model: Any, about: dict[str, Any]) -> Policy:
    """The actor of a model, with statistics of observations if its environment is there."""
    refuse_extractor(model)
    space = observed(model)
    lstm, modules = actor(model)
    cells = lstm_cells(lstm) if lstm else []
    modules, output = without_output(modules)
    layers, activation = folded(modules)
    policy = Policy(
        weights=tuple(W.astype(np.float32) for W, _ in (*cells, *layers)),
        biases=tuple(b.astype(np.float32) for _, b in (*cells, *layers)),
        recurrent=len(cells),
        activation=activation,
        **output,
        observation_low=space.low.copy(),
        observation_high=space.high.copy(),
        normalization=normalization(model.get_vec_normalize_env()),
        about={"algorithm": name_of(type(model))} | about,
    )
    refuse_size(policy)
    return policy


def observed(model: Any) -> Any:
    """Space of what the actor sees; refuses what a stored policy cannot see or do."""
    from agents.learners.privileged import PrivilegedCriticPolicy

    actions = other_actions(model)
    if actions is not None:
        raise PolicyError(
            f"Only policies of actions in [-1, 1] can be stored, got {actions}; train without a "
            "wrapper that converts them."
        )
    space = model.observation_space
    if isinstance(model.policy, PrivilegedCriticPolicy):
        space = space["observation"]
    if len(space.shape or ()) != 1:
        raise PolicyError(
            f"Only policies of one vector of observations can be stored, got shape {space.shape}; "
            "let it see the latest ones by VecFrameStack, or by env.stack of an experiment."
        )
    return space


def without_output(modules: list[Any]) -> tuple[list[Any], dict[str, Any]]:
    """Modules of an actor up to its mean, and what is done with the mean."""
    import torch

    squashing, mean_limit = "clip", None
    if isinstance(modules[-1], torch.nn.Tanh):
        squashing, modules = "tanh", modules[:-1]
    if isinstance(modules[-1], torch.nn.Hardtanh):  # of exploration noise that depends on the state
        mean_limit, modules = float(modules[-1].max_val), modules[:-1]
    return modules, {"squashing": squashing, "mean_limit": mean_limit}


def folded(modules: list[Any]) -> tuple[list[tuple[AnyArray, AnyArray]], str]:
    """Weights and biases of every linear layer, and the activation between them.

    Batch renormalisation, which is affine in a trained network, becomes part of the next layer.
    """
    import torch

    layers: list[tuple[AnyArray, AnyArray]] = []
    activations: set[str] = set()
    factor, shift = np.ones(1), np.zeros(1)  # of the next layer's input
    for module in modules:
        kind = type(module).__name__.lower()
        if isinstance(module, torch.nn.Linear):
            W = array(module.weight)
            b = np.zeros(len(W)) if module.bias is None else array(module.bias)
            layers.append((W * factor, b + W @ np.broadcast_to(shift, W.shape[1:])))
            factor, shift = np.ones(1), np.zeros(1)
        elif kind == "batchrenorm1d":
            factor = array(module.scale) / np.sqrt(array(module.ra_var) + module.eps)
            shift = array(module.bias) - array(module.ra_mean) * factor
        else:
            alpha = getattr(module, "alpha", 1.0)
            activations.add(kind if alpha == 1.0 else f"{kind} of alpha {alpha:g}")
    if len(activations) > 1 or not activations <= set(ACTIVATIONS):
        raise PolicyError(
            f"Only networks with one activation out of {sorted(ACTIVATIONS)} can be stored, got "
            f"{sorted(activations)}."
        )
    return layers, activations.pop() if activations else "tanh"


def refuse_size(policy: Policy) -> None:
    """Refuse a policy that a file cannot hold."""
    sizes = policy.layer_sizes
    if len(sizes) > MOST_LAYERS or max(sizes) > LARGEST_LAYER:
        raise PolicyError(
            f"A policy can have at most {MOST_LAYERS} layers of at most {LARGEST_LAYER} units, "
            f"observation and action included, got {sizes}."
        )
    statistics = policy.normalization
    if statistics is not None and statistics.mean.shape != (policy.n_observation,):
        raise PolicyError(
            f"VecNormalize must be inside VecFrameStack: it has {statistics.mean.size} means, but "
            f"one observation has {policy.n_observation} numbers."
        )


def refuse_extractor(model: Any) -> None:
    """Refuse a network before the actor's own layers, which would be left out."""
    from stable_baselines3.common.torch_layers import FlattenExtractor

    from agents.learners.privileged import Sensors

    actor = getattr(model, "actor", None) or model.policy
    extractor = getattr(actor, "features_extractor", None)
    if type(extractor) not in (type(None), FlattenExtractor, Sensors):
        raise PolicyError(
            "Only policies of one vector of observations can be stored, without an extractor of "
            f"features, got {type(extractor).__name__}."
        )


def begin_with(model: Any, policy: Policy, about: Mapping[str, Any]) -> None:
    """Give a model's actor the weights of a policy with the same layers and observations.

    `about` is the origin of the model's own policy.

    Raises
    ------
    PolicyError : for an algorithm of COLD, another layout, or normalized observations.
    """
    import torch

    algorithm, own = name_of(type(model)), export_policy(model, dict(about))
    if algorithm in COLD or policy.normalization or own.normalization:
        raise PolicyError(
            f"agent.warm_start is not for {list(COLD)} or env.normalize, got a policy of "
            f"{policy.about.get('algorithm')} for {algorithm}; take others."
        )
    theirs, ours = layout(policy), layout(own)
    for what, remedy in LAYOUT.items():
        if theirs[what] != ours[what] and theirs[what] is not None and ours[what] is not None:
            raise PolicyError(
                f"agent.warm_start: {what} of the policy is {validate.shown(theirs[what])}, that "
                f"of the experiment {validate.shown(ours[what])}; {remedy}."
            )
    lstm, modules = actor(model)
    for k in range(policy.recurrent):
        set_cells(lstm, k, policy.weights[k], policy.biases[k])
    layers = [x for x in modules if isinstance(x, torch.nn.Linear)]
    behind = slice(policy.recurrent, None)
    for layer, weight, bias in zip(
        layers, policy.weights[behind], policy.biases[behind], strict=True
    ):
        layer.weight.data.copy_(torch.as_tensor(weight))
        layer.bias.data.copy_(torch.as_tensor(bias))
    if hasattr(model, "actor_target"):
        model.actor_target.load_state_dict(model.actor.state_dict())


def layout(policy: Policy) -> dict[str, Any]:
    """Values of LAYOUT; None for an observation of which the policy's origin tells nothing.

    The base is the controller on which a policy acts and what was learned on it, if there is one.
    """
    try:
        observed = observation_kind(policy.about)
    except ValueError as error:
        raise PolicyError(f"agent.warm_start: {error}") from None
    base = policy.about.get("base")
    acts = "none"
    if isinstance(base, dict):
        acts = f"{base.get('learned')} on {base.get('controller')}"
    origin = {"observation": observed, "base": acts}
    return origin | {name: getattr(policy, name) for name in LAYOUT if name not in origin}


def normalization(envs: Any) -> Normalization | None:
    """Statistics by which a VecNormalize normalizes observations; None if it does not."""
    if envs is None or not envs.norm_obs:
        return None
    found = envs.obs_rms
    if isinstance(found, dict):
        found = found["observation"]
    return Normalization(
        mean=found.mean.copy(),
        variance=found.var.copy(),
        epsilon=float(envs.epsilon),
        clip=float(envs.clip_obs),
    )


def actor(model: Any) -> tuple[Any, list[Any]]:
    """torch's LSTM, or None, and the modules behind it up to the action.

    A Tanh at the end stands for a squashed action.
    """
    import torch
    from sb3_contrib.ars.policies import ARSPolicy
    from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.td3.policies import TD3Policy

    policy = model.policy
    squashed = [torch.nn.Tanh()]
    if isinstance(policy, torch.nn.ModuleDict):
        lstm = policy["actor"].rnn.rnn if policy["actor"].is_recurrent else None
        return lstm, list(policy["actor"].mlp)
    if isinstance(policy, ActorCriticPolicy):
        recurrent = isinstance(policy, RecurrentActorCriticPolicy)
        modules = [*policy.mlp_extractor.policy_net, policy.action_net]
        return (
            policy.lstm_actor if recurrent else None,
            modules + (squashed if policy.squash_output else []),
        )
    if isinstance(policy, ARSPolicy):
        return None, list(policy.action_net)
    if isinstance(policy, TD3Policy):
        return None, list(policy.actor.mu)
    if name_of(type(model)) in ("sac", "tqc", "crossq"):
        mean = policy.actor.mu
        last = list(mean) if isinstance(mean, torch.nn.Sequential) else [mean]
        return None, [*policy.actor.latent_pi, *last, *squashed]
    raise PolicyError(f"The policy of {type(model).__name__} cannot be stored.")


def lstm_cells(lstm: Any) -> list[tuple[AnyArray, AnyArray]]:
    """Weights (4 n, n_in + n) and biases (4 n,) of every layer of torch's LSTM."""
    if lstm.bidirectional or lstm.proj_size or not lstm.bias:
        raise PolicyError("Only LSTM layers with biases, in one direction, can be stored.")
    return [
        (
            np.hstack([array(getattr(lstm, f"weight_{x}_l{k}")) for x in ("ih", "hh")]),
            sum((array(getattr(lstm, f"bias_{x}_l{k}")) for x in ("ih", "hh")), np.zeros(1)),
        )
        for k in range(lstm.num_layers)
    ]


def set_cells(lstm: Any, k: int, weight: AnyArray, bias: AnyArray) -> None:
    """Give layer k of torch's LSTM the weights (4 n, n_in + n) and the bias (4 n,)."""
    import torch

    W_in, W_out = np.hsplit(weight, [weight.shape[1] - lstm.hidden_size])
    parts = {"weight_ih": W_in, "weight_hh": W_out, "bias_ih": bias, "bias_hh": np.zeros_like(bias)}
    for name, part in parts.items():
        getattr(lstm, f"{name}_l{k}").data.copy_(torch.as_tensor(part))


def array(tensor: Any) -> AnyArray:
    """A tensor's numbers in float64."""
    numbers: AnyArray = tensor.detach().cpu().numpy().astype(np.float64)
    return numbers


def load_zip(path: str | Path, *, trust: bool = False) -> Policy:
    """Load the policy of a stable-baselines3 zip; requires `trust`, because it is unpickled.

    Statistics that RL Zoo has put beside NAME.zip, in NAME/vecnormalize.pkl, are loaded with it; a
    policy of normalized observations is refused without them.
    """
    path = Path(path)
    if not is_zipfile(path):
        raise PolicyError(f"{path}: is no zip of stable-baselines3; name a run's folder or a zip.")
    if not trust:
        raise PolicyError(
            f"{path}: a stable-baselines3 zip is unpickled when loaded and can run any code; "
            "pass --trust if you trust its author."
        )
    file = path
    try:
        with ZipFile(path) as archive:
            name = zipped_algorithm(json.loads(archive.read("data")))
        model = algorithms()[name].load(path, device="cpu")
        policy = network(model, {"source": path.name})
        statistics = path.with_suffix("") / "vecnormalize.pkl"
        if not statistics.exists():
            # statistics of RL Zoo, whose folder need not have the zip's name
            if lost_normalization(model) or any(path.parent.glob("*/vecnormalize.pkl")):
                raise PolicyError(
                    "was trained with VecNormalize, whose statistics the zip does not hold; put "
                    f"the file of VecNormalize.save at {statistics}."
                )
            return policy
        file = statistics
        return replace(policy, normalization=normalization(pickle.loads(file.read_bytes())))
    except PolicyError as error:
        raise PolicyError(f"{file}: {error}") from None
    except Exception as error:  # unpickling can raise anything
        raise PolicyError(
            f"{file}: cannot be loaded as a file of stable-baselines3 "
            f"({type(error).__name__}: {one_line(error)})."
        ) from None


def zipped_algorithm(settings: Any) -> str:
    """Name of the algorithm of a zip, from its JSON settings without unpickling."""
    replay = settings.get("replay_buffer_class") or {}
    if replay.get("__module__", "").startswith("stable_baselines3.her"):
        raise PolicyError(
            "Only policies of one vector of observations can be loaded, got one of goals "
            "(HerReplayBuffer); load it by stable-baselines3 with an environment."
        )
    module = settings["policy_class"].get("__module__")
    if "estimation" in settings:
        return DAGGER
    if module in ON_POLICY:
        return "ppo" if "n_epochs" in settings else "trpo" if "cg_max_steps" in settings else "a2c"
    if module not in ZIPPED:
        raise PolicyError(
            f"Only zips of {LOADED} can be loaded, got a policy of {validate.shown(module)}."
        )
    return ZIPPED[module]
