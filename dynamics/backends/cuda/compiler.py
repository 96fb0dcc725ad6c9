"""Compilation of kernels by NVRTC and their launch, through NVIDIA's cuda-core (extra `gpu`)."""

import hashlib
import re
from collections.abc import Sequence
from io import StringIO
from typing import Any, NamedTuple

import numpy as np

from dynamics import cache
from dynamics.extras import missing

# in the assembler's report on a kernel, which goes on with the functions that it calls
_KERNEL = r"Compiling entry function '(\w+)'(.*?)(?=Compiling entry function|\Z)"
_SPILLS = r"(\d+) bytes spill stores, (\d+) bytes spill loads"
_TAKEN = r"Used (\d+) registers(?:.*, (\d+) bytes cumulative stack size)?"
THREADS = 128  # per block: registers, not blocks, limit how many run at a time


class Kernels:
    """Compiled kernels on one device.

    Parameters
    ----------
    source : CUDA C of the kernels.
    device : number of the device.

    Raises
    ------
    ModuleNotFoundError : cuda-core is not installed; with the line that installs it.
    """

    def __init__(self, source: str, device: int) -> None:
        self._core, self._number = _cuda_core(), device
        self._code = _object_code(self._core, source, f"sm_{self._current().arch}")
        self._handles: dict[str, int] = {}

    def launch(self, name: str, stream: int, count: int, arguments: Sequence[Any]) -> None:
        """Run a kernel in `count` threads on a stream; returns before it has ended.

        Parameters
        ----------
        name : one of the kernels.
        stream : handle of a CUDA stream.
        arguments : NumPy numbers and arrays, which the kernel gets by value.

        Raises
        ------
        RuntimeError : the driver refuses the launch.
        """
        from cuda.bindings import driver  # cuda-core passes no arrays by value

        self._current()
        values = [np.atleast_1d(x) for x in arguments]
        places = np.array([x.ctypes.data for x in values], np.uint64)
        grid, block, kernel = -(-count // THREADS), THREADS, driver.CUfunction(self._handle(name))
        (error,) = driver.cuLaunchKernel(
            kernel, grid, 1, 1, block, 1, 1, 0, driver.CUstream(stream), places.ctypes.data, 0
        )
        if error:
            raise RuntimeError(f"The kernel {name} was not launched: {error.name}.")

    def _current(self) -> Any:
        """The device, made current in this thread: torch takes gradients back in another one."""
        device = self._core.Device(self._number)
        device.set_current()
        return device

    def _handle(self, name: str) -> int:
        if name not in self._handles:
            self._handles[name] = int(self._code.get_kernel(name).handle)
        return self._handles[name]


class Usage(NamedTuple):
    """Registers and local memory of one thread of a kernel."""

    stack: int  # [B] local memory: spilled registers, and arrays that do not lie in registers
    stores: int  # [B] of registers that are spilled
    loads: int  # [B] of spilled registers
    registers: int


def usage(source: str, arch: str) -> dict[str, Usage]:
    """Registers and spills of all kernels on an architecture, such as "sm_90"; needs no GPU.

    Spills are those in the text of a kernel and of the functions that it calls.
    """
    report = StringIO()
    _program(_cuda_core(), source, arch, ptxas_options="-v").compile("cubin", logs=report)
    return {name: _usage(of) for name, of in re.findall(_KERNEL, report.getvalue(), re.S)}


def _usage(report: str) -> Usage:
    """Registers and local memory of a kernel with the functions that it calls."""
    spills = [tuple(map(int, pair)) for pair in re.findall(_SPILLS, report)]
    stores, loads = map(sum, zip(*spills, strict=True))
    taken = re.search(_TAKEN, report)
    assert taken is not None
    return Usage(int(taken[2] or 0), stores, loads, int(taken[1]))


def _cuda_core() -> Any:
    try:
        import cuda.core
    except ModuleNotFoundError as error:
        raise missing(error, "device='cuda'", "gpu") from None
    return cuda.core


def _object_code(core: Any, source: str, arch: str) -> Any:
    """Machine code from the cache, or compiled and kept there."""
    key = hashlib.sha256(f"{source}\0{arch}\0{core.__version__}".encode()).hexdigest()[:20]
    name = f"flexarm_kernels_{key}.cubin"
    known = cache.load(name)
    if known is not None:
        return core.ObjectCode.from_cubin(known)
    code = _program(core, source, arch).compile("cubin")
    cache.store(name, bytes(code.code))
    return code


def _program(core: Any, source: str, arch: str, **more: Any) -> Any:
    options = core.ProgramOptions(std="c++17", arch=arch, **more)
    return core.Program(source, code_type="c++", options=options)
