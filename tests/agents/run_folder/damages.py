"""Random damages of a file's content."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import yaml

Rng = np.random.Generator
Damage = Callable[[bytes, Rng], bytes]

WRONG: tuple[Any, ...] = (None, [], {}, "text", "", -1, 1.5, True, 10**30, [[[]]], {"a": None})


def cut(data: bytes, rng: Rng) -> bytes:
    """Only the beginning of the file."""
    return data[: rng.integers(len(data) + 1)]


def torn(data: bytes, rng: Rng) -> bytes:
    """The file without its last 1, 2 or 30 bytes."""
    return data[: len(data) - int(rng.choice([1, 2, 30]))]


def emptied(data: bytes, rng: Rng) -> bytes:
    """An empty file, as on a full disk."""
    return b""


def flipped(data: bytes, rng: Rng) -> bytes:
    """The file with one to eight bits flipped."""
    array = np.frombuffer(data, np.uint8).copy()
    if array.size:
        places = rng.integers(array.size, size=rng.integers(1, 9))
        array[places] ^= (1 << rng.integers(8, size=places.size)).astype(np.uint8)
    return array.tobytes()


def stuffed(data: bytes, rng: Rng) -> bytes:
    """The file with random bytes inserted."""
    first = rng.integers(len(data) + 1)
    return data[:first] + rng.bytes(rng.integers(1, 65)) + data[first:]


def doubled(data: bytes, rng: Rng) -> bytes:
    """The file with a part repeated."""
    first, last = sorted(rng.integers(len(data) + 1, size=2))
    return data[:last] + data[first:]


def foreign(data: bytes, rng: Rng) -> bytes:
    """Random bytes, as of a corrupt file system."""
    return rng.bytes(rng.integers(1, 500))


def zeroed(data: bytes, rng: Rng) -> bytes:
    """The file with zeros at the end, as if only its length reached the disk."""
    first = rng.integers(len(data) + 1)
    return data[:first] + bytes(len(data) - first)


def mistyped(data: bytes, rng: Rng) -> bytes:
    """JSON, a line of JSON, or YAML, with one value replaced by a wrong one."""
    lines = data.split(b"\n")
    try:
        return json.dumps(replaced(json.loads(data), rng)).encode()
    except ValueError:
        pass
    try:
        i = int(rng.integers(len(lines)))
        lines[i] = json.dumps(replaced(json.loads(lines[i]), rng)).encode()
        return b"\n".join(lines)
    except ValueError:
        pass
    try:
        return yaml.safe_dump(replaced(yaml.safe_load(data), rng)).encode()
    except (yaml.YAMLError, ValueError):
        return flipped(data, rng)


def replaced(tree: Any, rng: Rng) -> Any:
    """The tree with a wrong value at a random place."""
    if not isinstance(tree, dict | list) or not tree or rng.random() < 0.2:
        return WRONG[rng.integers(len(WRONG))]
    keys = list(tree) if isinstance(tree, dict) else range(len(tree))
    key = keys[rng.integers(len(keys))]
    copy = tree.copy()
    copy[key] = replaced(tree[key], rng)
    return copy


DAMAGES: tuple[Damage, ...] = (
    cut,
    torn,
    emptied,
    flipped,
    stuffed,
    doubled,
    foreign,
    zeroed,
    mistyped,
)
