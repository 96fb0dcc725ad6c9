"""Everything that leans on private parts of numba, guarded by the newest release tested.

Beside a newer numba USABLE is false, and public numba takes over, slower: code is compiled in every
process, `backends/numba_llvm/plain_code.py` replaces the vector code, and a batch has one thread.
"""

import hashlib
import pickle
import re
import sys
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba import typeof

from dynamics import cache

NEWEST = (0, 68)  # release that the tests ran with
DIGEST = "_digest"  # global of a generated module: digest of the text it was made from


def _usable(version: str) -> bool:
    return tuple(map(int, re.findall(r"\d+", version)[:2])) <= NEWEST


USABLE = _usable(numba.__version__)
if USABLE:
    from numba.core.cgutils import for_range, unpack_tuple
    from numba.core.codegen import get_host_cpu_features
    from numba.core.compiler import CompileResult
    from numba.core.runtime import rtsys
    from numba.core.serialize import dumps

    __all__ = [
        "DIGEST", "ENTRY_OPTIONS", "NEWEST", "USABLE", "array_struct", "compiled_for",
        "data_pointer", "for_range", "get_host_cpu_features", "keep_code", "unpack_tuple",
    ]  # fmt: skip
else:
    warnings.warn(
        f"numba {numba.__version__} is newer than flexarm was tested with "
        f"({'.'.join(map(str, NEWEST))}): code is compiled anew in every process and runs slower, "
        "on one thread. Install the numba of constraints.txt for full speed.",
        RuntimeWarning,
        stacklevel=2,
    )


# an entry point is called from Python alone: it needs no wrapper for C
ENTRY_OPTIONS = {"no_cfunc_wrapper": True} if USABLE else {}


@lru_cache
def _sources(folder: Path) -> str:
    """Digest of the sources in a folder: a function's own, and of what is linked into its code."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


class CodeCache:
    """Machine code of one function in the cache folder, in place of numba's own cache.

    One file per signature and processor. The file is named by a hash of all that the code depends
    on, so there is no index for two processes to overwrite. Unlike numba's cache, loading does not
    build the compiler's tables, which would take twice as long as the rest.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        source = function.__globals__.get(DIGEST)
        if source is None:
            source = _sources(Path(function.__code__.co_filename).parent)
        name = function.__qualname__, function.__module__  # which compiled code looks for
        self._depends = *name, source, numba.__version__, sys.version

    @property
    def cache_path(self) -> str:
        """Folder of the files."""
        return str(cache.cache_folder())

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Compiled code for a signature, or None."""
        name = self._name(signature, target.codegen())
        content = cache.load(name)
        if content is None:
            return None
        rtsys.initialize(target)
        try:
            return CompileResult._rebuild(target, *pickle.loads(content))
        except Exception:  # numba raises what it likes for code that it cannot load
            cache.report_damage(name)
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store compiled code."""
        if not result.library.has_dynamic_globals:
            cache.store(self._name(signature, result.codegen), dumps(result._reduce()))

    def flush(self) -> None:
        """Do nothing: files of other sources are never opened."""

    def _name(self, signature: Any, codegen: Any) -> str:
        depends = repr((*self._depends, signature, codegen.magic_tuple()))
        return f"{self._depends[0]}-{hashlib.sha256(depends.encode()).hexdigest()[:20]}.nbc"


def keep_code(dispatcher: Any, function: Callable[..., Any]) -> Any:
    """The dispatcher, its machine code kept in the cache folder."""
    if USABLE:
        dispatcher._cache = CodeCache(function)
    return dispatcher


def compiled_for(function: Any, *arguments: Any) -> Callable[..., Any]:
    """The compiled function for arguments of these types, without numba's type dispatch.

    It checks the types of its arguments, not their shapes. Gain: docs/results/tricks.md.
    """
    if not USABLE:
        return function
    return function.compile(tuple(map(typeof, arguments)))


def array_struct(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Data pointer, shape and strides of an array, in a function that writes LLVM code."""
    return context.make_array(kind)(context, builder, array)


def data_pointer(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Address of an array's first element, likewise."""
    return array_struct(context, builder, kind, array).data
