"""Arrays that take over the memory of arrays which nobody holds any more."""

import weakref
from collections import defaultdict
from typing import Any

import numpy as np

from dynamics.runtime.jit import aligned_zeros
from dynamics.types import AnyArray


class Recycled:
    """Memory of arrays by shape and type. New memory costs a page fault for every 4 kB of it."""

    def __init__(self) -> None:
        self._spare: defaultdict[tuple[Any, ...], list[AnyArray]] = defaultdict(list)

    def array(self, shape: tuple[int, ...], dtype: Any) -> AnyArray:
        """Array with any numbers in it, aligned as `aligned_zeros`.

        Its memory is free again when the array and all views of it are gone.
        """
        spare = self._spare[shape, np.dtype(dtype)]
        memory = spare.pop() if spare else aligned_zeros(shape, dtype)
        lent = np.frombuffer(memory.data, dtype)  # held by its views: its base is no array
        weakref.finalize(lent, spare.append, memory).atexit = False
        return lent.reshape(shape)

    def copy(self, values: AnyArray) -> AnyArray:
        """Copy of an array."""
        result = self.array(values.shape, values.dtype)
        result[...] = values
        return result
