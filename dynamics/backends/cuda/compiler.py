"""Compilation of kernels by NVRTC and their launch, through cuda-core (extra `gpu`)."""

import hashlib
from collections.abc import Sequence
from typing import Any

from dynamics import cache
from dynamics.backends.cuda.kernel_text import KERNELS
from dynamics.extras import missing

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
        core = _cuda_core()
        self._launch, self._config = core.launch, core.LaunchConfig
        self._device = core.Device(device)
        self._device.set_current()
        code = _object_code(core, source, f"sm_{self._device.arch}")
        self._kernels = {name: code.get_kernel(name) for name in KERNELS}

    def launch(self, name: str, stream: int, count: int, arguments: Sequence[Any]) -> None:
        """Run a kernel for `count` environments on a stream; returns before it has ended.

        Parameters
        ----------
        name : one of `kernel_text.KERNELS`.
        stream : handle of a CUDA stream.
        arguments : addresses, then NumPy numbers.
        """
        config = self._config(grid=-(-count // THREADS), block=THREADS)
        self._launch(_Stream(stream), config, self._kernels[name], *arguments)


class _Stream:
    """A stream of another library, in the form that cuda-core takes."""

    def __init__(self, handle: int) -> None:
        self.handle = handle

    def __cuda_stream__(self) -> tuple[int, int]:
        return 0, self.handle


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
    options = core.ProgramOptions(std="c++17", arch=arch)
    code = core.Program(source, code_type="c++", options=options).compile("cubin")
    cache.store(name, bytes(code.code))
    return code
