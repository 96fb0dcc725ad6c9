"""The compiled loops around an arm's own code, on the flat workspace that lowering.py describes.

A generated module holds `accelerations(w)` and `measure(w)` of one arm for one number of lanes,
and ends with its entry points.
"""

import hashlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import njit, typeof
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numpy.typing import NDArray

from dynamics import cache

CACHE_LINE = 64  # bytes
LANES = 16  # of a batch's blocks in float64; twice as many fit the same registers in float32

_FAST = {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy", "nogil": True}
compiled = njit(**_FAST, inline="always")


DIGEST = "_digest"  # global of a generated module: digest of the text it was made from


class _CodeCache:
    """The compiled code of one function in the cache folder, in place of numba's own cache.

    One file per signature and processor. The file is named by a hash of all that the code depends
    on, so no index is needed, which two processes could overwrite. Unlike numba's, loading does
    not build the tables of the compiler, which takes twice as long as the rest.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        source = function.__globals__.get(DIGEST)
        if source is None:
            content = Path(function.__code__.co_filename).read_bytes()
            source = hashlib.sha256(content).hexdigest()
        name = function.__qualname__, function.__module__  # which compiled code looks for
        self._depends = *name, source, numba.__version__, sys.version

    @property
    def cache_path(self) -> str:
        return str(cache.cache_folder())

    def load_overload(self, signature: Any, target: Any) -> Any:
        name = self._name(signature, target.codegen())
        content = cache.load(name)
        if content is None:
            return None
        rtsys.initialize(target)
        try:
            return CompileResult._rebuild(target, *pickle.loads(content))
        except Exception:  # whatever numba says of code that it cannot load
            cache.report_damage(name)
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        if not result.library.has_dynamic_globals:
            cache.store(self._name(signature, result.codegen), dumps(result._reduce()))

    def flush(self) -> None:
        """Files of other sources are never looked at again."""

    def _name(self, signature: Any, codegen: Any) -> str:
        depends = repr((*self._depends, signature, codegen.magic_tuple()))
        return f"{self._depends[0]}-{hashlib.sha256(depends.encode()).hexdigest()[:20]}.nbc"


def on_disk(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """njit(cache=True, **options), quick to load, in flexarm's own cache folder."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(**options)(function)
        dispatcher._cache = _CodeCache(function)
        return dispatcher

    return decorate


outermost = on_disk(**_FAST, no_cfunc_wrapper=True)  # Python calls it


def compiled_for(function: Any, *arguments: Any) -> Callable[..., Any]:
    """What numba compiled, or now compiles, for arguments of these types.

    Called by itself it spares the search for what fits, which counts beside a short call. It takes
    any array for one of the right type: whoever calls it answers for them.
    """
    return function.compile(tuple(map(typeof, arguments)))


def aligned_zeros(size: int, dtype: str) -> NDArray[Any]:
    """Zeros from the start of a cache line on.

    Elsewhere every other vector would lie across two lines: up to a fifth of the speed.
    """
    each = np.dtype(dtype).itemsize
    memory = np.zeros(size + CACHE_LINE // each, dtype)
    first = -memory.ctypes.data % CACHE_LINE // each
    return memory[first : first + size]
