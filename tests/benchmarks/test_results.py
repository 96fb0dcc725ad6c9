"""The regeneration of all results: its order, what is skipped, and where it goes on."""

import importlib.util
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agents.config import load_config
from agents.experiments import shipped_experiments
from benchmarks import results
from benchmarks.results import done, main, steps


def test_every_experiment_is_trained_before_policies_are_ranked(tmp_path: Path) -> None:
    parts = [step.part for step in steps(2, tmp_path)]
    assert parts == sorted(parts, key=list(dict.fromkeys(parts)).index)
    texts = [step.text for step in steps(2, tmp_path)]
    assert len(set(texts)) == len(texts)
    place = {
        name: next(k for k, text in enumerate(texts) if f"configs/{name}.yaml" in text)
        for name in shipped_experiments()
    }
    assert max(place.values()) < texts.index("agents.leaderboard")
    first = {name: load_config(x).agent.warm_start for name, x in shipped_experiments().items()}
    assert all(place[start] < place[name] for name, start in first.items() if start)
    assert any(first.values())
    assert all(importlib.util.find_spec(step.words[0]) for step in steps(2, tmp_path))


def test_a_failed_step_ends_the_run_which_goes_on_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the number of processes is the second time."""
    ran: list[str] = []
    failing = ["agents.leaderboard"]

    def run(command: list[str], **_: Any) -> Any:
        ran.append(command[2])
        return SimpleNamespace(returncode=3 if command[2] in failing else 0)

    monkeypatch.setattr(results, "subprocess", SimpleNamespace(run=run))
    given = ["--only", "ranking", "films", "--keep", str(tmp_path)]
    assert main([*given, "--jobs", "2"]) == 3
    assert (ran, done(tmp_path)) == (["agents.leaderboard"], {})
    failing.clear()
    assert main([*given, "--jobs", "1"]) == 0
    studies = [f"benchmarks.ranking.{name}" for name in ("on_reference", "knowledge", "harder")]
    assert ran[1:] == ["agents.leaderboard", *studies, "agents.films"]
    assert main(given) == 0
    assert len(ran) == 6
    assert "python -m agents.films" in capsys.readouterr().out


def test_the_list_runs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(subprocess, "run", None)
    assert main(["--list", "--only", "films", "--keep", str(tmp_path)]) == 0
    assert "| films | agents.films |  | to do |  |" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["--only", "film"])
    assert "part of --only" in capsys.readouterr().err
