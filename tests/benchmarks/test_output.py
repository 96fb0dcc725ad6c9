"""Command lines, provenance and Markdown tables of the benchmarks."""

import json
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.output import Parser, argument_parser, command, save_results, table
from dynamics.extras import installation
from tests.benchmarks.conftest import Command
from tests.imports import module_name, sources
from tests.paths import ROOT

BENCHMARKS = [
    module_name(path).removeprefix("benchmarks.").removesuffix(".__main__")
    for path in sources("benchmarks")
    if '__name__ == "__main__"' in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("name", BENCHMARKS)
def test_help_names_the_command(
    name: str, benchmark: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also without the optional engines of the peers."""
    with pytest.raises(SystemExit) as ended:
        benchmark(name, "--help")
    assert ended.value.code == 0
    usage = capsys.readouterr().out.splitlines()[0]
    assert usage.startswith("usage: ")
    assert name in usage


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        *((name, [f"--{option}", "0"], f"argument --{option}: it must be 1 or more, got 0")
          for name, option in (
              ("ranking.harder", "episodes"), ("results", "jobs"), ("training.learning", "steps"),
              ("training.cluster", "trials"), ("speed.tricks", "rounds"),
              ("work_precision", "jobs"),
          )),
        *((name, ["--charts", "--out", f"no{suffix}"], f"there is no no{suffix}")
          for name, suffix in (
              ("speed.cost", ".json"), ("accuracy.rigid_arms", ".json"),
              ("accuracy.stability", ".json.bz2"),
          )),
        ("training.studies", ["limits", "--episodes", "1"], "a regret with its interval needs 2"),
        ("training.experiments", ["--out", "empty"], "empty has no results of benchmarks.training"),
        ("training", ["--config", "no.yaml"], "no.yaml: there is no such file."),
        ("training", ["--film", "no.yaml"], "no.yaml: there is no such file."),
        (
            "training",
            ["--config", str(ROOT / "configs" / "one_link_reach_sac.yaml"), "--steps", "9"],
            "must be below total_steps (9)",
        ),
    ],
)  # fmt: skip
def test_numbers_and_files_that_no_benchmark_can_use_are_refused(
    name: str, arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    benchmark: Command, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        benchmark(name, *arguments)
    assert ended.value.code == 2
    assert words in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("module", ["benchmarks.speed.cost", "benchmarks.peers.__main__"])
def test_the_command_is_that_of_the_process(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    main = SimpleNamespace(__spec__=SimpleNamespace(name=module))
    monkeypatch.setitem(sys.modules, "__main__", main)  # type: ignore[arg-type]
    monkeypatch.setattr(sys, "argv", ["file", "--keep", "runs", "--quick", "--out", "x"])
    assert command() == f"python -m {module.removesuffix('.__main__')} --quick"


def parser(usual: str) -> Parser:
    made = argument_parser("speed", "Speed.")
    made.add_argument("--out", type=Path, default=Path(usual))
    return made


@pytest.mark.parametrize(
    ("usual", "given", "words"),
    [
        ("speed.json", "folder", "takes the name of a .json file, such as folder/speed.json"),
        ("speed.json", "new", "takes the name of a .json file, such as new/speed.json"),
        ("speed.json", "new.md", "takes the name of a .json file, such as new/speed.json"),
        ("speed.json", "folder.json", "takes the name of a .json file"),
        ("speed.json", "file/speed.json", "is not a writable folder; choose another --out"),
        ("results", "file", "is not a writable folder; choose another --out"),
        ("results", "file/results", "is not a writable folder; choose another --out"),
    ],
)
def test_a_place_for_results_is_refused_before_any_work(
    usual: str, given: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder.json").mkdir()
    with pytest.raises(SystemExit) as ended:
        parser(usual).parse_args(["--out", given])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("benchmarks.speed: ")
    assert words in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(("usual", "given"), [("x.json", "a/b/y.json"), ("x", "a/b")])
def test_a_place_for_results_is_made(usual: str, given: str, tmp_path: Path) -> None:
    assert parser(usual).parse_args(["--out", str(tmp_path / given)]).out == tmp_path / given
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]
    assert (tmp_path / "a" / "b").is_dir()


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


def test_results_are_strict_json(tmp_path: Path) -> None:
    """Of a motion that never settles too: parsers beside Python's refuse NaN and Infinity."""
    save_results({"settles": [math.inf, 1.0], "later": math.nan}, "# Page\n", tmp_path / "x.json")
    assert strict(tmp_path / "x.json") == {"settles": [None, 1.0], "later": None}
    for path in (ROOT / "docs").rglob("*.json"):
        strict(path)


def test_results_have_six_digits_and_whole_counts_and_so_has_their_page(tmp_path: Path) -> None:
    results = {"rate": 1234567.8, "errors": [1.0 / 3.0], "steps": 1234567}
    save_results(results, lambda stored: f"{stored['errors']}", tmp_path / "x.json")
    stored = {"rate": 1234570.0, "errors": [0.333333], "steps": 1234567}
    assert strict(tmp_path / "x.json") == stored
    assert (tmp_path / "x.md").read_text(encoding="utf-8") == "[0.333333]"


def strict(path: Path) -> Any:
    def refused(text: str) -> None:
        raise AssertionError(f"{path} holds {text}")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refused)
