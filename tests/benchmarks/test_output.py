"""Command lines, provenance and Markdown tables of the benchmarks."""

import runpy
import subprocess
import sys
from types import SimpleNamespace

import pytest

from benchmarks.output import command, table
from dynamics.extras import installation
from tests.paths import ROOT

BENCHMARKS = sorted(
    {path.stem for path in (ROOT / "benchmarks").glob("*.py")} - {"__init__", "output", "style"}
    | {path.parent.name for path in (ROOT / "benchmarks").glob("*/__main__.py")}
)


@pytest.mark.parametrize("name", BENCHMARKS)
def test_help_names_the_command(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also without the optional engines of the peers."""
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    monkeypatch.delitem(sys.modules, f"benchmarks.{name}", raising=False)
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"benchmarks.{name}", run_name="__main__")
    assert ended.value.code == 0
    usage = capsys.readouterr().out.splitlines()[0]
    assert usage.startswith("usage: ")
    assert name in usage


@pytest.mark.parametrize("module", ["benchmarks.cost", "benchmarks.peers.__main__"])
def test_the_command_is_that_of_the_process(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    main = SimpleNamespace(__spec__=SimpleNamespace(name=module))
    monkeypatch.setitem(sys.modules, "__main__", main)  # type: ignore[arg-type]
    monkeypatch.setattr(sys, "argv", ["file", "--keep", "runs", "--quick", "--out", "x"])
    assert command() == f"python -m {module.removesuffix('.__main__')} --quick"


def test_peers_without_the_engines_end_with_a_sentence() -> None:
    code = """
import runpy, sys
sys.modules["exudyn"] = None
sys.argv = ["peers", "--quick"]
runpy.run_module("benchmarks.peers", run_name="__main__")
"""
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 1
    sentence = f"benchmarks.peers needs exudyn, which is not installed; {installation('peers')}"
    assert result.stderr.strip() == sentence


def test_a_table_aligns_columns_and_repeats_the_last_alignment() -> None:
    rows = [["x", "1", "2"], ["y", "", "3"]]
    assert table(["", "a", "b"], rows, "lr").splitlines() == [
        "| | a | b |",
        "|---|---:|---:|",
        "| x | 1 | 2 |",
        "| y |  | 3 |",
    ]
