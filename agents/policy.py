"""Policies as weights plus JSON, which are stored, loaded and run without pickle and torch."""

import itertools
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from zipfile import ZipFile

import numpy as np

from agents.arrays import Header, read_arrays
from agents.files import atomic_write
from agents.sentences import one_line
from dynamics.description import validate
from dynamics.description.data_file import read_mapping
from dynamics.types import AnyArray

POLICY_FORMAT = "flexarm-policy-1"
JSON_FILE, WEIGHTS_FILE = "policy.json", "weights.npz"
KEYS = "format layer_sizes activation squashing observation_low observation_high action_low"
KEYS += " action_high about"
LARGEST_JSON = 2**20  # bytes
LARGEST_LAYER = 2048  # units
MOST_LAYERS = 10  # including observation and action
MOST_STACKED = 32  # observations
ENDS = ("low", "high")
OVERHEAD = 2**16  # bytes of an archive in addition to the numbers

ACTIVATIONS: dict[str, Callable[[AnyArray], AnyArray]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, np.float32(0.0)),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
}
# Maps from the last layer's output to an action in [-1, 1]
SQUASHINGS: dict[str, Callable[[AnyArray], AnyArray]] = {
    "clip": lambda x: np.clip(x, -1.0, 1.0),  # PPO: mean of an unbounded Gaussian
    "tanh": np.tanh,  # SAC: mean of a squashed Gaussian
}


class PolicyError(ValueError):
    """A policy that cannot be loaded; the message is one sentence for the user."""


class Controller(Protocol):
    """Interface of trained policies and classical controllers."""

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Return actions in [-1, 1] for one observation or a batch, and the next state."""
        ...


@dataclass(frozen=True, kw_only=True)
class Policy:
    """A multilayer perceptron from observation to action, evaluated with numpy in float32.

    A policy with a memory takes its latest observations, stacked oldest first; zeros precede the
    first one of an episode. The state that `predict` returns holds them.
    """

    weights: tuple[AnyArray, ...]  # each (n_out, n_in)
    biases: tuple[AnyArray, ...]  # each (n_out,)
    activation: str
    squashing: str
    observation_low: AnyArray  # (n_observation,) bounds of the training observations
    observation_high: AnyArray
    about: dict[str, Any]  # env id and keywords, algorithm, steps, versions: plain JSON

    @property
    def stack(self) -> int:
        """Number of observations that are stacked."""
        count: int = self.about.get("stack", 1)
        return count

    @property
    def n_observation(self) -> int:
        """Size of one observation."""
        return self.observation_low.size // self.stack

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Return the mean action (..., n_action), and the state for the next call."""
        if not deterministic:
            raise ValueError(
                "A stored policy holds the mean action only; call predict(deterministic=True)."
            )
        x = np.asarray(observation, np.float32)
        if x.shape[-1:] != (self.n_observation,):
            raise ValueError(
                f"The policy takes {self.n_observation} observations, got shape {x.shape}. "
                f"It was trained on {validate.shown(self.about.get('env_id'))}."
            )
        if self.stack > 1:
            x = state = self._stacked(x, state, episode_start)
        activation = ACTIVATIONS[self.activation]
        with np.errstate(over="ignore", invalid="ignore"):
            for W, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
                x = activation(x @ W.T + b)
            x = SQUASHINGS[self.squashing](x @ self.weights[-1].T + self.biases[-1])
        if np.isnan(x).any():
            raise PolicyError("The policy's weights are so large that its action is not a number.")
        return x.astype(np.float32), state

    def _stacked(self, x: AnyArray, before: Any, episode_start: AnyArray | None) -> AnyArray:
        """The latest observations (..., stack * n_observation), as `VecFrameStack` orders them."""
        if before is None:
            before = np.zeros((*x.shape[:-1], self.observation_low.size), np.float32)
        elif episode_start is not None:
            before = np.where(np.asarray(episode_start, bool)[..., None], np.float32(0.0), before)
        return np.concatenate([before[..., self.n_observation :], x], axis=-1)


def export_policy(model: Any, about: dict[str, Any]) -> Policy:
    """The actor network of a stable-baselines3 PPO or SAC model."""
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
    with atomic_write(folder / WEIGHTS_FILE) as path:
        np.savez(path, **arrays)
    with atomic_write(folder / JSON_FILE) as path:
        path.write_text(text + "\n", encoding="utf-8")


def load_policy(folder: str | Path) -> Policy:
    """Load a policy from its folder, or from the folder of its run.

    The files need not be trusted: sizes and types are checked before memory is allocated.
    """
    folder = Path(folder)
    if not (folder / JSON_FILE).is_file() and (folder / "policy" / JSON_FILE).is_file():
        folder = folder / "policy"
    if not all((folder / name).is_file() for name in (JSON_FILE, WEIGHTS_FILE)):
        raise PolicyError(f"{folder}: holds no {JSON_FILE} with {WEIGHTS_FILE}.")
    try:
        d = read_description(folder / JSON_FILE)
        arrays = read_weights(folder / WEIGHTS_FILE, d["layer_sizes"])
    except OSError as error:
        raise PolicyError(f"{folder}: cannot be read ({error.strerror}).") from None
    except ValueError as error:
        raise PolicyError(f"{folder}: {error}") from None
    layers = range(len(d["layer_sizes"]) - 1)
    return Policy(
        weights=tuple(arrays[f"W{i}"] for i in layers),
        biases=tuple(arrays[f"b{i}"] for i in layers),
        activation=d["activation"],
        squashing=d["squashing"],
        observation_low=np.asarray(d["observation_low"], np.float32),
        observation_high=np.asarray(d["observation_high"], np.float32),
        about=d["about"],
    )


def read_description(path: Path) -> dict[str, Any]:
    """Read and check every field of a `policy.json`; raises ValueError."""
    if path.stat().st_size > LARGEST_JSON:
        raise ValueError(f"{path.name} must be at most {LARGEST_JSON:_} bytes.")
    d: dict[str, Any] = validate.mapping(read_mapping(path), path.name, KEYS.split())
    missing = sorted(set(KEYS.split()) - set(d))
    if missing:
        raise ValueError(f"{path.name} lacks {', '.join(missing)}.")
    validate.choice(d["format"], "format", [POLICY_FORMAT])
    validate.choice(d["activation"], "activation", ACTIVATIONS)
    validate.choice(d["squashing"], "squashing", SQUASHINGS)
    entries = validate.sequence(d["layer_sizes"], "layer_sizes")
    if not 2 <= len(entries) <= MOST_LAYERS:
        raise ValueError(f"layer_sizes must have 2 to {MOST_LAYERS} entries, got {len(entries)}.")
    sizes = [validate.integer(n, "each of layer_sizes", 1, LARGEST_LAYER) for n in entries]
    for name, size in (("observation", sizes[0]), ("action", sizes[-1])):
        low, high = (validate.numbers(d[f"{name}_{end}"], f"{name}_{end}", size) for end in ENDS)
        if not all(a <= b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"{name}_low must not be above {name}_high.")
    if not isinstance(d["about"], dict):
        raise ValueError(f"about must be a table, got {validate.shown(d['about'])}.")
    validate.text(d["about"].get("env_id", ""), "about.env_id")
    stack = validate.integer(d["about"].get("stack", 1), "about.stack", 1, MOST_STACKED)
    if sizes[0] % stack:
        raise ValueError(f"about.stack ({stack}) must divide the {sizes[0]} observations.")
    return d


def read_weights(path: Path, sizes: list[int]) -> dict[str, AnyArray]:
    """Read weights and biases of layers of the given sizes; raises ValueError."""
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (n_in, n_out) in enumerate(itertools.pairwise(sizes)):
        shapes |= {f"W{i}": (n_out, n_in), f"b{i}": (n_out,)}
    most = 8 * sum(math.prod(shape) for shape in shapes.values()) + OVERHEAD
    if path.stat().st_size > most:
        raise ValueError(f"{path.name} must be at most {most:_} bytes for layer sizes {sizes}.")

    def check(headers: Mapping[str, Header]) -> None:
        if {name: shape for name, (shape, _) in headers.items()} != shapes:
            raise ValueError(f"weights and biases do not have the stated layer sizes {sizes}.")
        types = {str(dtype) for _, dtype in headers.values()}
        if not types <= {"float32", "float64"}:
            raise ValueError(f"weights must be float32 or float64, got {', '.join(sorted(types))}.")

    arrays = read_arrays(path, check)
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise ValueError("the weights are not finite; the training had diverged.")
    return arrays


def load_zip(path: str | Path, *, trust: bool = False) -> Policy:
    """Load the policy of a stable-baselines3 zip; requires `trust`, because it is unpickled."""
    path = Path(path)
    if not trust:
        raise PolicyError(
            f"{path}: a stable-baselines3 zip is unpickled when loaded and can run any code; "
            "pass --trust if you trust its author."
        )
    from stable_baselines3 import PPO, SAC

    try:
        with ZipFile(path) as archive:
            name = algorithm(json.loads(archive.read("data")))
        model = {"PPO": PPO, "SAC": SAC}[name].load(path, device="cpu")
        return export_policy(model, {"source": path.name})
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from None
    except Exception as error:  # unpickling can raise anything
        raise PolicyError(
            f"{path}: cannot be loaded as a stable-baselines3 zip "
            f"({type(error).__name__}: {one_line(error)})."
        ) from None


def algorithm(settings: Any) -> str:
    """Algorithm of a stable-baselines3 zip, from its JSON settings without unpickling."""
    module = settings["policy_class"].get("__module__")
    if module == "stable_baselines3.common.policies" and "n_epochs" in settings:
        return "PPO"  # A2C has the same policy class but no epochs
    if module == "stable_baselines3.sac.policies":
        return "SAC"
    raise PolicyError(f"Only PPO and SAC can be loaded, got a policy of {validate.shown(module)}.")
