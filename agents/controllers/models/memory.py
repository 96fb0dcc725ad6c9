"""Memory of controllers: from step to step, and of postures and models they meet again."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from typing import Any
from weakref import WeakMethod

import numpy as np

from dynamics.types import AnyArray, Array


def kept(method: Callable[..., Any], most: int) -> Any:
    """A method that remembers its latest results, at most so many.

    `lru_cache` of a bound method would hold its object until the garbage collector finds the
    cycle; filters of six links fill the memory before that.
    """
    weak = WeakMethod(method)

    @lru_cache(most)
    def found(*arguments: Any) -> Any:
        bound = weak()
        assert bound is not None  # the object calls
        return bound(*arguments)

    return found


def fresh_of(state: Any, episode_start: AnyArray | None, count: int) -> AnyArray:
    """(N,) environments whose episode starts."""
    if state is None or episode_start is None:
        return np.full(count, state is None)
    return np.asarray(episode_start, dtype=bool)


def resumed(state: Array | None, episode_start: AnyArray | None, shape: tuple[int, ...]) -> Array:
    """State of `shape` (N, ...) of a controller, zero where an episode starts."""
    before = np.zeros(shape) if state is None else state.copy()
    before[fresh_of(state, episode_start, shape[0])] = 0.0
    return before


def part_of(state: Any, rows: AnyArray) -> Any:
    """A copy of a controller's state for some of its N environments, (k,) indices.

    Arrays and lists of a state have N for their first dimension.
    """
    if isinstance(state, list):
        return [state[i] for i in rows]
    if isinstance(state, np.ndarray):
        return state[rows]
    if is_dataclass(state) and not isinstance(state, type):
        parts = {field.name: part_of(getattr(state, field.name), rows) for field in fields(state)}
        return replace(state, **parts)
    return state
