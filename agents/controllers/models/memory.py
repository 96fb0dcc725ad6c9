"""Memory of controllers: from step to step, and of postures and models they meet again."""

from collections.abc import Callable
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


def resumed(state: Array | None, episode_start: AnyArray | None, like: Array) -> Array:
    """State (..., N, m) of a controller, zero where an episode starts; `like` has its shape."""
    fresh = fresh_of(state, episode_start, like.shape[-2])
    return np.where(fresh[:, None], 0.0, np.zeros_like(like) if state is None else state)
