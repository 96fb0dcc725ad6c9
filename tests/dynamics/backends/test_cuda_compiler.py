"""Kernels are compiled and kept by cuda-core; without it, an error has the remedy."""

import ctypes
import sys
from pathlib import Path
from threading import Thread, get_ident
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dynamics import cache
from dynamics.backends.cuda import compiler


def test_a_missing_library_is_answered_with_the_line_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "cuda", None)
    with pytest.raises(ModuleNotFoundError, match=r"device='cuda' needs cuda.*\[gpu\]"):
        compiler.Kernels("", 0)


class _Code:
    """Object code that remembers where it came from; a kernel's handle is its name's length."""

    def __init__(self, code: bytes) -> None:
        self.code = code

    def get_kernel(self, name: str) -> Any:
        return SimpleNamespace(handle=len(name))


def library(compiled: list[str], threads: list[int]) -> ModuleType:
    """A stand-in for `cuda.core`; `threads` are those in which a device was made current."""

    def program(source: str, code_type: str, options: Any) -> Any:
        compiled.append(source)
        return SimpleNamespace(compile=lambda kind: _Code(f"{kind} {options.arch}".encode()))

    core: Any = ModuleType("cuda.core")
    core.__version__ = "1.0.0"
    core.Device = lambda number: SimpleNamespace(
        arch="90", set_current=lambda: threads.append(get_ident())
    )
    core.ObjectCode = SimpleNamespace(from_cubin=_Code)
    core.ProgramOptions = SimpleNamespace
    core.Program = program
    return core


def driver(launched: list[Any], error: Any) -> ModuleType:
    """A stand-in for `cuda.bindings`, whose driver keeps what it was given."""

    def launch(*given: Any) -> tuple[Any]:
        places = (ctypes.c_uint64 * 3).from_address(given[9])
        address = ctypes.c_uint64.from_address(places[0]).value
        numbers = list((ctypes.c_float * 2).from_address(places[1]))
        launched.append((given[:9], address, numbers, ctypes.c_int.from_address(places[2]).value))
        return (error,)

    found: Any = ModuleType("cuda.bindings")
    found.driver = SimpleNamespace(cuLaunchKernel=launch, CUfunction=int, CUstream=int)
    return found


def test_kernels_are_compiled_once_and_launched_on_the_stream_given(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    compiled: list[str] = []
    launched: list[Any] = []
    threads: list[int] = []
    monkeypatch.setattr(compiler, "_cuda_core", lambda: library(compiled, threads))
    monkeypatch.setitem(sys.modules, "cuda", ModuleType("cuda"))
    monkeypatch.setitem(sys.modules, "cuda.bindings", driver(launched, 0))
    compiler.Kernels("source", 0)
    kernels = compiler.Kernels("source", 0)
    assert compiled == ["source"]
    assert [path.suffix for path in cache.cache_folder().iterdir()] == [".cubin"]
    given = [np.uint64(2**40), np.array([0.5, 2.0], np.float32), np.int32(7)]
    thread = Thread(target=kernels.launch, args=("control_step", 9, 300, given))
    thread.start(), thread.join()
    assert threads[-1] != get_ident()
    configuration = (12, 3, 1, 1, 128, 1, 1, 0, 9)
    assert launched == [(configuration, 2**40, [0.5, 2.0], 7)]

    refused = driver(launched, SimpleNamespace(name="CUDA_ERROR_INVALID_VALUE"))
    monkeypatch.setitem(sys.modules, "cuda.bindings", refused)
    with pytest.raises(RuntimeError, match="control_step was not launched: CUDA_ERROR_INVALID"):
        kernels.launch("control_step", 9, 300, given)


def test_registers_and_spills_are_read_from_the_assemblers_report(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    report = """ptxas info    : Compiling entry function 'first_report' for 'sm_90'
ptxas info    : Function properties for first_report
ptxas         .     0 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads
ptxas info    : Used 56 registers, used 0 barriers
ptxas info    : Compiling entry function 'control_step' for 'sm_90'
ptxas info    : Function properties for control_step
ptxas         .     2160 bytes stack frame, 5096 bytes spill stores, 8696 bytes spill loads
ptxas info    : Used 255 registers, used 0 barriers, 2168 bytes cumulative stack size
ptxas info    : Function properties for restart
ptxas         .     8 bytes stack frame, 4 bytes spill stores, 6 bytes spill loads
"""

    def program(source: str, code_type: str, options: Any) -> Any:
        assert options.ptxas_options == "-v"
        return SimpleNamespace(compile=lambda kind, logs: logs.write(report))

    core = SimpleNamespace(ProgramOptions=SimpleNamespace, Program=program)
    monkeypatch.setattr(compiler, "_cuda_core", lambda: core)
    found = compiler.usage("source", "sm_90")
    assert found == {"first_report": (0, 0, 0, 56), "control_step": (2168, 5100, 8702, 255)}
