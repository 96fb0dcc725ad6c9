"""Compilation of kernels by NVRTC and their launch, through NVIDIA's cuda-core (extra `gpu`)."""

import hashlib
import re
from collections.abc import Sequence
from io import StringIO
from typing import Any, NamedTuple

import numpy as np

from dynamics import cache
from dynamics.backends.cuda.kernel_text import KERNELS
from dynamics.extras import missing

USAGE = (  # of one kernel, in the assembler's report
    r"Function properties for {name}\n.*?(\d+) bytes stack frame, (\d+) bytes spill stores, "
    r"(\d+) bytes spill loads\n.*?Used (\d+) registers"
)
THREADS = 128  # per block: registers, not blocks, limit how many run at a time


class Kernels:
    """Compiled kernels on one device.

    Parameters
    ----------
    source : CUDA C of the kernels.
    device : number of the device.
    names : of the kernels.

    Raises
    ------
    ModuleNotFoundError : cuda-core is not installed; with the line that installs it.
    """

    def __init__(self, source: str, device: int, names: Sequence[str] = KERNELS) -> None:
        core = _cuda_core()
        self._device = core.Device(device)
        self._device.set_current()
        self._code = _object_code(core, source, f"sm_{self._device.arch}")
        self._kernels = {name: int(self._code.get_kernel(name).handle) for name in names}

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

        values = [np.atleast_1d(x) for x in arguments]
        places = np.array([x.ctypes.data for x in values], np.uint64)
        grid, block, kernel = -(-count // THREADS), THREADS, driver.CUfunction(self._kernels[name])
        (error,) = driver.cuLaunchKernel(
            kernel, grid, 1, 1, block, 1, 1, 0, driver.CUstream(stream), places.ctypes.data, 0
        )
        if error:
            raise RuntimeError(f"The kernel {name} was not launched: {error.name}.")


class Usage(NamedTuple):
    """Registers and local memory of one thread of a kernel."""

    stack: int  # [B] local memory: spilled registers, and arrays that do not lie in registers
    stores: int  # [B] of registers that are spilled, in the text of the kernel
    loads: int  # [B] of spilled registers
    registers: int


def usage(source: str, arch: str) -> dict[str, Usage]:
    """Registers and spills of all kernels on an architecture, such as "sm_90"; needs no GPU."""
    report = StringIO()
    _program(_cuda_core(), source, arch, ptxas_options="-v").compile("cubin", logs=report)
    found = {name: re.search(USAGE.format(name=name), report.getvalue(), re.S) for name in KERNELS}
    return {name: Usage(*map(int, match.groups())) for name, match in found.items() if match}


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
