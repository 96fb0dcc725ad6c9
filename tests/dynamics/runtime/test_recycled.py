"""Memory of arrays that nobody holds any more."""

import numpy as np

from dynamics.runtime.jit import CACHE_LINE
from dynamics.runtime.recycled import Recycled


def test_memory_is_used_again_when_an_array_and_its_views_are_gone() -> None:
    memory = Recycled()
    first = memory.copy(np.arange(12.0).reshape(3, 4))
    place, view = first.ctypes.data, first[1:, 2]
    del first
    second = memory.array((3, 4), np.float64)
    second[...] = 7.0
    assert second.ctypes.data != place
    assert view.tolist() == [6.0, 10.0]
    del view
    assert memory.array((3, 4), np.float32).ctypes.data != place
    third = memory.array((3, 4), np.float64)
    assert third.ctypes.data == place
    assert place % CACHE_LINE == 0
