"""Policies as weights plus JSON, which are stored, loaded and run without pickle and torch."""

import itertools
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from agents.arrays import Header, read_arrays
from agents.files import atomic_write
from dynamics.description import validate
from dynamics.description.data_file import read_mapping
from dynamics.types import AnyArray

POLICY_FORMAT = "flexarm-policy-1"
JSON_FILE, WEIGHTS_FILE = "policy.json", "weights.npz"
KEYS = "format layer_sizes activation squashing observation_low observation_high action_low"
KEYS += " action_high about"
RECURRENT = "recurrent"  # number of LSTM layers; a file without the key has none
NORMALIZATION = "normalization"  # of observations; a file without the key has none
MEAN_LIMIT = "mean_limit"  # of the last layer's outputs; a file without the key has none
GATES = 4  # of an LSTM: input, forget, candidate, output
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
class Normalization:
    """Statistics of training observations, as stable-baselines3's VecNormalize applies them."""

    mean: AnyArray  # (n_observation,)
    variance: AnyArray  # (n_observation,)
    epsilon: float  # added to the variance
    clip: float  # largest size of a normalized number

    def apply(self, observation: AnyArray) -> AnyArray:
        """Normalized observations (..., n_observation), in float32."""
        scaled = (observation - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)

    @classmethod
    def of(cls, data: Any, size: int) -> "Normalization":
        """Statistics of observations of a size, from their table in a file; or ValueError."""
        names = ("mean", "variance", "epsilon", "clip")
        table = validate.mapping(data, NORMALIZATION, names)
        variance = validate.numbers(table.get("variance"), f"{NORMALIZATION}.variance", size)
        for k, value in enumerate(variance):
            validate.nonnegative(value, f"{NORMALIZATION}.variance[{k}]", "-")
        return cls(
            mean=np.array(validate.numbers(table.get("mean"), f"{NORMALIZATION}.mean", size)),
            variance=np.array(variance),
            epsilon=validate.positive(table.get("epsilon"), f"{NORMALIZATION}.epsilon", "-"),
            clip=validate.positive(table.get("clip"), f"{NORMALIZATION}.clip", "-"),
        )

    def to_dict(self) -> dict[str, Any]:
        """Inverse of `of`."""
        mean, variance = self.mean.tolist(), self.variance.tolist()
        return {"mean": mean, "variance": variance, "epsilon": self.epsilon, "clip": self.clip}


@dataclass(frozen=True, kw_only=True)
class Policy:
    """A network from observation to action, evaluated with numpy in float32.

    Layers of LSTM cells (Hochreiter and Schmidhuber, Long Short-Term Memory, Neural Computation 9,
    1997, with forget gates), if any, come first; a multilayer perceptron follows. A policy may take
    its latest observations, stacked oldest first; zeros precede the first one of an episode. The
    state that `predict` returns holds these observations and the cells. Observations may be
    normalized before they are stacked.
    """

    weights: tuple[AnyArray, ...]  # each (n_out, n_in), of LSTM cells (4 n_out, n_in + n_out)
    biases: tuple[AnyArray, ...]  # each (n_out,), of LSTM cells (4 n_out,)
    recurrent: int = 0  # number of layers of LSTM cells
    activation: str
    squashing: str
    mean_limit: float | None = None  # largest size of the last layer's outputs
    observation_low: AnyArray  # (n_observation,) bounds of the training observations
    observation_high: AnyArray
    normalization: Normalization | None = None
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

    @property
    def layer_sizes(self) -> list[int]:
        """Sizes of the input, of every layer and of the action."""
        gates = [GATES] * self.recurrent + [1] * len(self.biases)
        outputs = (b.size // n for b, n in zip(self.biases, gates, strict=False))
        return [self.observation_low.size, *outputs]

    @property
    def n_state(self) -> int:
        """Size of the state: the stacked observations, then output and content of each LSTM."""
        stacked = self.observation_low.size if self.stack > 1 else 0
        return stacked + 2 * sum(self.layer_sizes[1 : self.recurrent + 1])

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Return the mean action (..., n_action), and the state (..., n_state) of the next call.

        Raises
        ------
        ValueError : for observations of another size, or with deterministic=False.
        """
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
        activation, first = ACTIVATIONS[self.activation], self.recurrent
        with np.errstate(over="ignore", invalid="ignore"):
            if self.normalization is not None:
                x = self.normalization.apply(x)
            if self.n_state:
                x, state = self._remembered(x, state, episode_start)
            for W, b in zip(self.weights[first:-1], self.biases[first:-1], strict=True):
                x = activation(x @ W.T + b)
            x = x @ self.weights[-1].T + self.biases[-1]
            if self.mean_limit is not None:
                x = np.clip(x, -self.mean_limit, self.mean_limit)
            x = SQUASHINGS[self.squashing](x)
        if np.isnan(x).any():
            raise PolicyError("The policy's weights are so large that its action is not a number.")
        return x.astype(np.float32), state

    def _remembered(
        self, x: AnyArray, before: Any, episode_start: AnyArray | None
    ) -> tuple[AnyArray, AnyArray]:
        """Input (..., n) of the perceptron, and the state; observations as `VecFrameStack` has."""
        if before is None:
            before = np.zeros((*x.shape[:-1], self.n_state), np.float32)
        elif episode_start is not None:
            before = np.where(np.asarray(episode_start, bool)[..., None], np.float32(0.0), before)
        after: list[AnyArray] = []
        if self.stack > 1:
            stacked, before = np.split(before, [self.observation_low.size], axis=-1)
            x = np.concatenate([stacked[..., self.n_observation :], x], axis=-1)
            after.append(x)
        for W, b in zip(self.weights[: self.recurrent], self.biases, strict=False):
            n = b.size // GATES
            x, cell = lstm(W, b, x, before[..., :n], before[..., n : 2 * n])
            before = before[..., 2 * n :]
            after += [x, cell]
        return x, np.concatenate(after, axis=-1)


def lstm(
    W: AnyArray, b: AnyArray, x: AnyArray, h: AnyArray, c: AnyArray
) -> tuple[AnyArray, AnyArray]:
    """One step of LSTM cells: output h and content c (..., n), from an input and the former two.

    Weights W (4 n, n_in + n) and biases b (4 n,) have torch's order of gates.
    """
    gates = np.concatenate([x, h], axis=-1) @ W.T + b
    i, f, g, o = np.split(gates, GATES, axis=-1)
    c = sigmoid(f) * c + sigmoid(i) * np.tanh(g)
    return sigmoid(o) * np.tanh(c), c


def sigmoid(x: AnyArray) -> AnyArray:
    """Logistic function, without overflow."""
    y: AnyArray = 0.5 * np.tanh(0.5 * x) + 0.5
    return y


def save_policy(policy: Policy, folder: Path) -> None:
    """Write `policy.json` and `weights.npz` into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {f"W{i}": W for i, W in enumerate(policy.weights)}
    arrays |= {f"b{i}": b for i, b in enumerate(policy.biases)}
    description = {
        "format": POLICY_FORMAT,
        "layer_sizes": policy.layer_sizes,
        **({RECURRENT: policy.recurrent} if policy.recurrent else {}),
        "activation": policy.activation,
        "squashing": policy.squashing,
        **({} if policy.mean_limit is None else {MEAN_LIMIT: policy.mean_limit}),
        "observation_low": policy.observation_low.tolist(),
        "observation_high": policy.observation_high.tolist(),
        "action_low": [-1.0] * policy.layer_sizes[-1],
        "action_high": [1.0] * policy.layer_sizes[-1],
        **({NORMALIZATION: policy.normalization.to_dict()} if policy.normalization else {}),
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

    Raises
    ------
    PolicyError : for a folder without a policy, or files that are damaged or of another format.
    """
    folder = Path(folder)
    try:
        if not (folder / JSON_FILE).is_file() and (folder / "policy" / JSON_FILE).is_file():
            folder = folder / "policy"
        if not folder.is_dir():
            raise ValueError(
                "is a file; name the folder of a run or of a policy."
                if folder.exists()
                else "there is no such folder."
            )
        if not all((folder / name).is_file() for name in (JSON_FILE, WEIGHTS_FILE)):
            raise ValueError(f"holds no {JSON_FILE} with {WEIGHTS_FILE}.")
        d = read_description(folder / JSON_FILE)
        arrays = read_weights(folder / WEIGHTS_FILE, d["layer_sizes"], d[RECURRENT])
    except OSError as error:
        raise PolicyError(f"{folder}: cannot be read ({error.strerror}).") from None
    except ValueError as error:
        raise PolicyError(f"{folder}: {error}") from None
    layers = range(len(d["layer_sizes"]) - 1)
    return Policy(
        weights=tuple(arrays[f"W{i}"] for i in layers),
        biases=tuple(arrays[f"b{i}"] for i in layers),
        recurrent=d[RECURRENT],
        activation=d["activation"],
        squashing=d["squashing"],
        mean_limit=d.get(MEAN_LIMIT),
        observation_low=np.asarray(d["observation_low"], np.float32),
        observation_high=np.asarray(d["observation_high"], np.float32),
        normalization=d.get(NORMALIZATION),
        about=d["about"],
    )


def read_description(path: Path) -> dict[str, Any]:
    """Read and check every field of a `policy.json`; raises ValueError.

    The normalization, if there is one, is returned as such.
    """
    if path.stat().st_size > LARGEST_JSON:
        raise ValueError(f"{path.name} must be at most {LARGEST_JSON:_} bytes.")
    known = [*KEYS.split(), RECURRENT, NORMALIZATION, MEAN_LIMIT]
    data = read_mapping(path)
    if data.get("format", POLICY_FORMAT) != POLICY_FORMAT:
        raise ValueError(
            f"format must be {POLICY_FORMAT!r}, got {validate.shown(data['format'])}; another "
            "version of flexarm wrote it."
        )
    d: dict[str, Any] = {RECURRENT: 0} | validate.mapping(data, path.name, known)
    missing = sorted(set(KEYS.split()) - set(d))
    if missing:
        raise ValueError(f"{path.name} lacks {', '.join(missing)}.")
    validate.choice(d["activation"], "activation", ACTIVATIONS)
    validate.choice(d["squashing"], "squashing", SQUASHINGS)
    entries = validate.sequence(d["layer_sizes"], "layer_sizes")
    if not 2 <= len(entries) <= MOST_LAYERS:
        raise ValueError(f"layer_sizes must have 2 to {MOST_LAYERS} entries, got {len(entries)}.")
    sizes = [validate.integer(n, "each of layer_sizes", 1, LARGEST_LAYER) for n in entries]
    validate.integer(d[RECURRENT], RECURRENT, 0, len(sizes) - 2)
    for name, size in (("observation", sizes[0]), ("action", sizes[-1])):
        low, high = (validate.numbers(d[f"{name}_{end}"], f"{name}_{end}", size) for end in ENDS)
        if not all(a <= b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"{name}_low must not be above {name}_high.")
        if name == "action" and (set(low), set(high)) != ({-1.0}, {1.0}):
            raise ValueError(f"actions must be in [-1, 1], got {validate.shown([low, high])}.")
    if not isinstance(d["about"], dict):
        raise ValueError(f"about must be a table, got {validate.shown(d['about'])}.")
    validate.text(d["about"].get("env_id", ""), "about.env_id")
    stack = validate.integer(d["about"].get("stack", 1), "about.stack", 1, MOST_STACKED)
    if sizes[0] % stack:
        raise ValueError(f"about.stack ({stack}) must divide the {sizes[0]} observations.")
    if MEAN_LIMIT in d:
        d[MEAN_LIMIT] = validate.positive(d[MEAN_LIMIT], MEAN_LIMIT, "-")
    if NORMALIZATION in d:
        d[NORMALIZATION] = Normalization.of(d[NORMALIZATION], sizes[0] // stack)
    return d


def read_weights(path: Path, sizes: list[int], recurrent: int) -> dict[str, AnyArray]:
    """Read weights and biases of layers of the given sizes, LSTM cells first; or ValueError."""
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (n_in, n_out) in enumerate(itertools.pairwise(sizes)):
        rows, columns = (GATES * n_out, n_in + n_out) if i < recurrent else (n_out, n_in)
        shapes |= {f"W{i}": (rows, columns), f"b{i}": (rows,)}
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
