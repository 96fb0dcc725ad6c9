"""Results that a controller keeps for the postures and models it meets again."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any
from weakref import WeakMethod


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
