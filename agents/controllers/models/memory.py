"""Memory of controllers: from step to step, and of postures and models they meet again."""

from abc import ABC, abstractmethod
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


def resumed(memory: Array | None, fresh: AnyArray, shape: tuple[int, ...]) -> Array:
    """Memory of `shape` (N, ...) of a controller, zero where an episode starts."""
    before = np.zeros(shape) if memory is None else memory.copy()
    before[fresh] = 0.0
    return before


class Remembering(ABC):
    """A controller whose state is a memory of N episodes."""

    @abstractmethod
    def act(self, x: AnyArray, memory: Any, fresh: AnyArray) -> tuple[AnyArray, Any]:
        """Actions (N, m) and the next memory, from observations (N, size), the last memory, if
        there is one, and where an episode starts (N,).
        """

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions (..., m) in [-1, 1], and the memory."""
        x = np.atleast_2d(observation)
        action, memory = self.act(x, state, fresh_of(state, episode_start, len(x)))
        return action.reshape(*np.shape(observation)[:-1], -1), memory


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
