"""Compilation of functions, and memory for compiled code."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config, njit
from numpy.typing import NDArray

from dynamics.runtime.numba_internals import ENTRY_OPTIONS, keep_code

CACHE_LINE = 64  # bytes

_FAST: dict[str, Any] = {
    "fastmath": {"contract", "arcp", "nsz"},  # never nnan: a NaN must survive to be reported
    "error_model": "numpy",
    "nogil": True,
}
compiled = njit(**_FAST, inline="always")


def on_disk(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """njit(**options) whose machine code is kept in flexarm's cache folder."""

    def decorate(function: Callable[..., Any]) -> Any:
        return keep_code(njit(**options)(function), function)

    return decorate


# for entry points of all arms to call, without contraction, which depends on the order in which
# numba emits operations: numbers that are stored once and used in every step are the same in every
# process. What is not set is the caller's
exact = on_disk(fastmath=False, error_model="numpy", nogil=True)
# entry points: functions that Python calls. They use loops where they can: with the first sum of
# arrays or assignment to a slice numba compiles its message about shapes, which takes seconds
outermost = on_disk(**_FAST, **ENTRY_OPTIONS)


def check_compiler() -> None:
    """Refuse to go on where numba compiles nothing."""
    if config.DISABLE_JIT:
        raise ValueError(
            "numba's compiler is switched off (NUMBA_DISABLE_JIT), and compiled code steps the "
            "arms; unset the environment variable NUMBA_DISABLE_JIT and start Python again."
        )


def aligned_zeros(shape: int | tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Zeros that begin at a cache line, as a view of a larger array.

    Otherwise every other vector would cross a line. Gain for states and outputs:
    docs/results/tricks.md.
    """
    size, each = int(np.prod(shape)), np.dtype(dtype).itemsize
    memory = np.zeros(size + CACHE_LINE // each, dtype)
    first = -memory.ctypes.data % CACHE_LINE // each
    return memory[first : first + size].reshape(shape)
