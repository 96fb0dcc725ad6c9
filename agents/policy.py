"""Policies as weights plus JSON: stored, loaded and run without unpickling and without torch."""

import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

POLICY_FORMAT = "flexarm-policy-1"
JSON_FILE, WEIGHTS_FILE = "policy.json", "weights.npz"

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, np.float32(0.0)),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
}
SQUASHINGS: dict[
    str, Callable[[Array], Array]
] = {  # what turns the last layer's output into an action in [-1, 1]
    "clip": lambda x: np.clip(x, -1.0, 1.0),  # PPO: mean of an unbounded Gaussian
    "tanh": np.tanh,  # SAC: mean of a squashed Gaussian
}


class PolicyError(ValueError):
    """A policy that cannot be loaded; the message is one sentence for the user."""


class Controller(Protocol):
    """Whatever can act: trained policies and classical controllers alike."""

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions in [-1, 1] for one observation or a batch of them, and the next state."""
        ...


@dataclass(frozen=True, kw_only=True)
class Policy:
    """A multilayer perceptron from observation to action, evaluated with numpy in float32."""

    weights: tuple[Array, ...]  # each (n_out, n_in)
    biases: tuple[Array, ...]  # each (n_out,)
    activation: str
    squashing: str
    observation_low: Array  # (n_observation,) bounds the policy was trained within
    observation_high: Array
    about: dict[str, Any]  # env id and keywords, algorithm, steps, versions: plain JSON

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """The policy's mean action, shape (..., n_action); stateless."""
        if not deterministic:
            raise ValueError(
                "A stored policy holds the mean action only; call predict(deterministic=True)."
            )
        x = np.asarray(observation, np.float32)
        if x.shape[-1:] != self.observation_low.shape:
            raise ValueError(
                f"The policy takes {self.observation_low.size} observations, got shape {x.shape}. "
                "It was trained on " + str(self.about.get("env_id")) + "."
            )
        activation = ACTIVATIONS[self.activation]
        for W, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = activation(x @ W.T + b)
        x = SQUASHINGS[self.squashing](x @ self.weights[-1].T + self.biases[-1])
        return x.astype(np.float32), state


def export_policy(model: Any, about: dict[str, Any]) -> Policy:
    """The acting part of a stable-baselines3 PPO or SAC model."""
    from stable_baselines3 import PPO, SAC

    if isinstance(model, PPO):
        body, head = model.policy.mlp_extractor.policy_net, model.policy.action_net
        squashing = "clip"
    elif isinstance(model, SAC):
        body, head = model.actor.latent_pi, model.actor.mu
        squashing = "tanh"
    else:
        raise PolicyError(f"Only PPO and SAC can be exported, got {type(model).__name__}.")
    layers, activations = [], set()
    for layer in [*body, head]:
        if hasattr(layer, "weight"):
            layers.append(layer)
        else:
            activations.add(type(layer).__name__.lower())
    if len(activations) > 1 or not activations <= set(ACTIVATIONS):
        raise PolicyError(
            f"Only networks with one activation out of {sorted(ACTIVATIONS)} can be exported, "
            f"got {sorted(activations)}."
        )
    space = model.observation_space
    return Policy(
        weights=tuple(layer.weight.detach().cpu().numpy().copy() for layer in layers),
        biases=tuple(layer.bias.detach().cpu().numpy().copy() for layer in layers),
        activation=activations.pop() if activations else "tanh",
        squashing=squashing,
        observation_low=space.low.copy(),
        observation_high=space.high.copy(),
        about={"algorithm": type(model).__name__.lower()} | about,
    )


def save_policy(policy: Policy, folder: Path) -> None:
    """Write `policy.json` and `weights.npz` into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {f"W{i}": W for i, W in enumerate(policy.weights)}
    arrays |= {f"b{i}": b for i, b in enumerate(policy.biases)}
    np.savez(folder / WEIGHTS_FILE, **arrays)
    sizes = [policy.weights[0].shape[1], *(W.shape[0] for W in policy.weights)]
    description = {
        "format": POLICY_FORMAT,
        "layer_sizes": sizes,
        "activation": policy.activation,
        "squashing": policy.squashing,
        "observation_low": policy.observation_low.tolist(),
        "observation_high": policy.observation_high.tolist(),
        "action_low": [-1.0] * sizes[-1],
        "action_high": [1.0] * sizes[-1],
        "about": policy.about,
    }
    text = json.dumps(description, indent=2, allow_nan=False)
    (folder / JSON_FILE).write_text(text + "\n", encoding="utf-8")


def load_policy(folder: str | Path) -> Policy:
    """Read what `save_policy` wrote, from its folder or from the run that holds it."""
    folder = Path(folder)
    if not (folder / JSON_FILE).is_file() and (folder / "policy" / JSON_FILE).is_file():
        folder = folder / "policy"
    try:
        d = json.loads((folder / JSON_FILE).read_text(encoding="utf-8"))
        if d["format"] != POLICY_FORMAT:
            raise PolicyError(f"{folder}: format must be {POLICY_FORMAT!r}, got {d['format']!r}.")
        sizes = d["layer_sizes"]
        with np.load(folder / WEIGHTS_FILE, allow_pickle=False) as arrays:
            weights = tuple(arrays[f"W{i}"] for i in range(len(sizes) - 1))
            biases = tuple(arrays[f"b{i}"] for i in range(len(sizes) - 1))
        policy = Policy(
            weights=weights,
            biases=biases,
            activation=d["activation"],
            squashing=d["squashing"],
            observation_low=np.asarray(d["observation_low"], np.float32),
            observation_high=np.asarray(d["observation_high"], np.float32),
            about=d["about"],
        )
        shapes = [(W.shape, b.shape) for W, b in zip(weights, biases, strict=True)]
    except PolicyError:
        raise
    except FileNotFoundError:
        raise PolicyError(f"{folder}: holds no {JSON_FILE} with {WEIGHTS_FILE}.") from None
    except (OSError, KeyError, TypeError, ValueError, BadZipFile) as error:
        raise PolicyError(f"{folder}: is not a stored policy ({error}).") from None
    if policy.activation not in ACTIVATIONS or policy.squashing not in SQUASHINGS:
        raise PolicyError(
            f"{folder}: unknown activation {policy.activation!r} or squashing "
            f"{policy.squashing!r}; known: {sorted(ACTIVATIONS)}, {sorted(SQUASHINGS)}."
        )
    wanted = [((o, i), (o,)) for i, o in itertools.pairwise(sizes)]
    if shapes != wanted or policy.observation_low.shape != (sizes[0],):
        raise PolicyError(f"{folder}: weights do not have the stated layer sizes {sizes}.")
    if not all(np.isfinite(array).all() for array in (*weights, *biases)):
        raise PolicyError(f"{folder}: the weights are not finite; the training had diverged.")
    return policy


def load_zip(path: str | Path, *, trust: bool = False) -> Policy:
    """The policy inside a stable-baselines3 zip; unpickles it, so only with `trust`."""
    path = Path(path)
    if not trust:
        raise PolicyError(
            f"{path}: a stable-baselines3 zip is unpickled when loaded and can run any code; "
            "pass --trust if you trust its author."
        )
    from stable_baselines3 import PPO, SAC

    try:
        with ZipFile(path) as archive:
            settings = json.loads(archive.read("data"))
        algorithm = PPO if "n_epochs" in settings else SAC
        model = algorithm.load(path, device="cpu")
    except (OSError, KeyError, ValueError, BadZipFile) as error:
        raise PolicyError(f"{path}: is not a stable-baselines3 zip ({error}).") from None
    return export_policy(model, {"source": path.name})
