"""Benchmarks run as commands, in this process."""

import runpy
import sys
from collections.abc import Callable

import pytest

from tests.paths import ROOT

Command = Callable[..., None]


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Command:
    """`benchmark(NAME, *arguments)` runs `python -m benchmarks.NAME`."""

    def run(name: str, *arguments: str) -> None:
        room = (ROOT / "benchmarks" / name).is_dir()
        module = f"benchmarks.{name}" + ".__main__" * room
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        monkeypatch.delitem(sys.modules, module, raising=False)  # runpy warns of a loaded one
        runpy.run_module(module, run_name="__main__")

    return run
