"""Kernels compiled by the host's C++ compiler, where each environment is stepped in turn.

They are an independent check of the printed text on machines without a GPU.
"""

import ctypes
import hashlib
import shutil
import subprocess
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from tempfile import gettempdir
from typing import Any

from dynamics.backends.cuda.kernel_text import ARRAYS

COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
OPTIONS = ("-O1", "-std=c++17", "-shared", "-fPIC", "-ffp-contract=off", "-w")
_HEAD = """\
#include <cmath>
#define __device__
#define __global__
#define __forceinline__ inline
#define __noinline__
#define __grid_constant__
struct Index { int x; };
static Index blockIdx, blockDim, threadIdx;
struct Array { void* at; template <class T> operator T*() const { return static_cast<T*>(at); } };
"""
_RUN = """
extern "C" void run_{name}(const Array* arrays, const Numbers* numbers, int count, int substeps)
{{
    blockDim.x = 1;
    for (blockIdx.x = 0; blockIdx.x < count; ++blockIdx.x)
        {name}({arrays}, *numbers, count, substeps);
}}
"""


def _run(name: str) -> str:
    """Function that runs a kernel for each environment."""
    arrays = ", ".join(f"arrays[{k}]" for k in range(len(ARRAYS[name])))
    return _RUN.format(name=name, arrays=arrays)


@lru_cache
def _library(source: str) -> ctypes.CDLL:
    kernels = [name for name in ARRAYS if f"void {name}(" in source]
    text = "\n".join([_HEAD, source, *map(_run, kernels)])
    folder = Path(gettempdir()) / "flexarm_host_kernels"
    folder.mkdir(exist_ok=True)
    name = hashlib.sha256("\n".join([text, *OPTIONS]).encode()).hexdigest()[:20]
    library = folder / f"{name}.so"
    if not library.exists():
        code = library.with_suffix(".cpp")
        code.write_text(text, encoding="utf-8")
        assert COMPILER is not None
        subprocess.run([COMPILER, *OPTIONS, str(code), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


class HostKernels:
    """Stand-in for `dynamics.backends.cuda.compiler.Kernels` on addresses of the host."""

    def __init__(self, source: str) -> None:
        self._library = _library(source)

    def launch(self, name: str, stream: int, count: int, arguments: Sequence[Any]) -> None:
        """Run a kernel; `arguments` are addresses, the shared numbers, and two whole numbers."""
        *addresses, numbers, n, substeps = arguments
        arrays = (ctypes.c_void_p * len(addresses))(*map(int, addresses))
        given = ctypes.c_void_p(numbers.ctypes.data), ctypes.c_int(n), ctypes.c_int(substeps)
        getattr(self._library, f"run_{name}")(arrays, *given)
