"""Kernels are compiled and kept by cuda-core; without it, an error has the remedy."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

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
    """Object code that remembers where it came from."""

    def __init__(self, code: bytes) -> None:
        self.code = code

    def get_kernel(self, name: str) -> str:
        return f"{name} of {self.code.decode()}"


def library(compiled: list[str], launched: list[Any]) -> ModuleType:
    """A stand-in for `cuda.core`, with what is used of it."""

    def program(source: str, code_type: str, options: Any) -> Any:
        compiled.append(source)
        return SimpleNamespace(compile=lambda kind: _Code(f"{kind} {options.arch}".encode()))

    core: Any = ModuleType("cuda.core")
    core.__version__ = "1.0.0"
    core.Device = lambda number: SimpleNamespace(arch="90", set_current=lambda: None)
    core.ObjectCode = SimpleNamespace(from_cubin=_Code)
    core.ProgramOptions = SimpleNamespace
    core.Program = program
    core.LaunchConfig = SimpleNamespace
    core.launch = lambda *given: launched.append(given)
    return core


def test_kernels_are_compiled_once_and_launched_on_the_stream_given(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    compiled: list[str] = []
    launched: list[Any] = []
    monkeypatch.setattr(compiler, "_cuda_core", lambda: library(compiled, launched))
    compiler.Kernels("source", 0)
    kernels = compiler.Kernels("source", 0)
    assert compiled == ["source"]
    assert [path.suffix for path in cache.cache_folder().iterdir()] == [".cubin"]
    kernels.launch("control_step", 7, 300, [11, 12])
    stream, config, kernel, *arguments = launched[0]
    assert stream.__cuda_stream__() == (0, 7)
    assert (config.grid, config.block) == (3, 128)
    assert kernel == "control_step of cubin sm_90"
    assert arguments == [11, 12]
