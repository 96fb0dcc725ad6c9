"""Searches that are kept go on after an interruption, and belong to what they search."""

import errno
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.config import load_config
from agents.files import FolderError
from agents.tune.__main__ import main
from agents.tune.learners import tune_experiment
from agents.tune.search import finished, kept_study, objective, searched
from tests.agents.tiny import ENV_ID, one_sentence, write_config

ABOUT = {"name": "parabola"}


class Killed(BaseException):
    """Ends a process within a trial, as a signal that cannot be caught would."""


def parabola(trial: Any) -> float:
    return -((trial.suggest_float("x", 0.0, 1.0) - 0.3) ** 2)


@pytest.mark.parametrize("end", [Killed, KeyboardInterrupt])
@pytest.mark.parametrize("count", [0, 1, 4])
def test_a_search_goes_on_from_the_trials_that_have_ended(
    tmp_path: Path, end: type[BaseException], count: int
) -> None:
    """Given parameters are tried all, also those whose trial was interrupted, and none twice."""
    first = [{"x": 0.25}, {"x": 0.75}]
    tried: list[float] = []

    def interrupted(trial: Any) -> float:
        value = parabola(trial)
        if len(tried) == count:
            raise end
        tried.append(trial.params["x"])
        return value

    with pytest.raises(end), kept_study(tmp_path, ABOUT) as study:
        searched(study, interrupted, 6, first)
    seen: list[tuple[int, float | None]] = []

    with kept_study(tmp_path, ABOUT) as study:
        done = searched(study, parabola, 6, first, report=lambda *x: seen.append(x))
    assert len(done) == 6
    assert [number for number, _ in seen] == list(range(count + 1, 7))
    values = [trial.params["x"] for trial in done]
    assert values[:count] == tried
    assert len(set(values)) == 6
    assert {0.25, 0.75} < set(values)
    with kept_study(tmp_path, ABOUT) as study:
        assert searched(study, interrupted, 6, first) == done  # nothing is left to try


def test_a_search_in_memory_and_one_that_is_kept_are_alike(tmp_path: Path) -> None:
    def points(folder: Path | None) -> list[float]:
        with kept_study(folder, ABOUT) as study:
            return [trial.params["x"] for trial in searched(study, parabola, 12)]

    assert points(None) == points(tmp_path)


def test_a_search_without_a_trial_is_refused() -> None:
    with kept_study(None, ABOUT) as study, pytest.raises(ValueError, match="trials must be betw"):
        searched(study, parabola, 0)


def test_halving_ends_poor_trials_early(tmp_path: Path) -> None:
    def judged(trial: Any) -> float:
        from optuna import TrialPruned

        trial.report(-float(trial.number), 1)
        if trial.should_prune():
            raise TrialPruned
        return 0.0

    seen: list[tuple[int, float | None]] = []
    with kept_study(tmp_path, ABOUT) as study:
        done = searched(study, judged, 6, reduction=3, report=lambda *x: seen.append(x))
        assert finished(study) == done
    assert [trial.state.name for trial in done] == ["COMPLETE"] + 5 * ["PRUNED"]
    assert seen == [(1, 0.0), *((k, None) for k in range(2, 7))]


def test_of_equal_scores_the_closer_controller_is_the_better_one() -> None:
    def value(score: float, rms: float) -> float:
        return objective({"score": np.array([score]), "tip_error_rms": np.array([rms])}, 2.0)

    assert value(0.5, 0.0) == 0.5
    assert 0.5 > value(0.5, 0.1) > value(0.5, 0.2) > value(0.5, 2.0) == value(0.5, 9.0)
    assert value(0.501, 9.0) >= value(0.5, 0.0)


def test_a_folder_has_one_search_and_one_process(tmp_path: Path) -> None:
    with kept_study(tmp_path, ABOUT) as study:
        searched(study, parabola, 1)
        with pytest.raises(FolderError, match="in use by another"), kept_study(tmp_path, ABOUT):
            pass
    with (
        pytest.raises(FolderError, match="has another search; remove it"),
        kept_study(tmp_path, {"name": "line"}),
    ):
        pass


def test_no_search_waits_for_the_lock_of_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Optuna locks the journal by a link, which a killed process leaves."""
    (tmp_path / "trials.log").touch()
    (tmp_path / "trials.log.lock").symlink_to("trials.log")

    def sleep(seconds: float) -> None:
        raise AssertionError("waits")

    monkeypatch.setattr("time.sleep", sleep)
    with kept_study(tmp_path, ABOUT) as study:
        assert len(searched(study, parabola, 2)) == 2


@pytest.mark.parametrize("cut", [1, 30])
def test_an_incomplete_last_line_is_cut_off(tmp_path: Path, cut: int) -> None:
    with kept_study(tmp_path, ABOUT) as study:
        searched(study, parabola, 3)
    journal = tmp_path / "trials.log"
    journal.write_bytes(journal.read_bytes()[:-cut])
    with kept_study(tmp_path, ABOUT) as study:
        assert len(finished(study)) == 2
        assert len(searched(study, parabola, 4)) == 4


@pytest.mark.parametrize("line", [b"no JSON\n", b"{}\n"])
def test_a_damaged_journal_is_refused(tmp_path: Path, line: bytes) -> None:
    with kept_study(tmp_path, ABOUT) as study:
        searched(study, parabola, 1)
    journal = tmp_path / "trials.log"
    journal.write_bytes(line + journal.read_bytes())
    with pytest.raises(FolderError, match=r"trials.log: is damaged"), kept_study(tmp_path, ABOUT):
        pass


def test_a_final_goes_on_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings that were judged are not made again, and the result is that of one sitting."""
    made: list[Any] = []

    def train(config: Any, poor: Any = None) -> Any:
        if len(made) == 7:  # six trials, and one of the final
            raise KeyboardInterrupt
        made.append(config)
        return config

    def judge(config: Any, policy: Any, *more: Any) -> dict[str, float]:
        value = policy.agent.kwargs.get("gamma", 0.9) + 0.01 * policy.seed
        return {"score": value, "objective": value}

    monkeypatch.setattr("agents.tune.learners.trained", train)
    monkeypatch.setattr("agents.tune.learners.judged", judge)
    config = load_config(write_config(tmp_path, "ppo", 1152))
    keep = tmp_path / "kept"
    texts: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        tune_experiment(config, trials=6, episodes=2, keep=keep)
    before = list(made)
    made.clear()
    found = tune_experiment(config, trials=6, episodes=2, keep=keep, report=texts.append)
    assert len(made) == 7
    assert not any(config in before for config in made)
    assert len(texts) == 8  # those that were judged before are told of too
    made.clear()
    monkeypatch.setattr("agents.tune.learners.trained", lambda config, poor=None: config)
    assert tune_experiment(config, trials=6, episodes=2) == found


def test_a_full_disk_ends_a_command_that_goes_on_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*given: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("agents.tune.__main__.tune_controllers", full)
    assert main(["--controllers", "pd", "--out", str(tmp_path / "tuned.json")]) == 1
    assert "No space left on device; the same command goes on" in one_sentence(capsys)


@pytest.mark.parametrize(
    ("names", "interrupted"), [(["pd"], 2), (["pd", "lqr"], 4), (["pd", "pd"], 2)]
)
def test_a_command_that_was_interrupted_goes_on_and_clears_up(
    names: list[str],
    interrupted: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Within a search, or behind one that is finished, of which nothing is repeated.

    A name given twice is searched once.
    """
    searches = len(set(names))
    out, keep = tmp_path / "tuned.json", tmp_path / "keep"
    command = ["--tasks", ENV_ID, "--tracks", "state", "--controllers", *names, "--trials", "3"]
    command += ["--episodes", "2", "--out", str(out), "--keep", str(keep)]
    objectives: list[int] = []

    def objective(*given: Any) -> float:
        objectives.append(1)
        if len(objectives) == interrupted:
            raise KeyboardInterrupt
        return 0.5

    monkeypatch.setattr("agents.tune.controllers.objective", objective)
    assert main(command) == 130
    assert "interrupted; the same command goes on" in one_sentence(capsys)
    assert out.exists() == (searches > 1)
    assert main([*command, "--episodes", "3"]) == 2
    assert "has another search" in one_sentence(capsys)
    assert main(command) == 0
    assert len(objectives) == 3 * searches + 1
    found = json.loads(out.read_text())[ENV_ID]["state"]
    assert [found[name]["trials"] for name in names] == [3] * len(names)
    assert not list(keep.rglob("trials.log"))


@pytest.mark.parametrize(("option", "name"), [("--keep", "file"), ("--out", "file/tuned.json")])
def test_a_place_that_cannot_be_written_to_is_refused_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, name: str
) -> None:
    (tmp_path / "file").touch()
    places = {"--keep": str(tmp_path / "keep"), "--out": str(tmp_path / "tuned.json")}
    places[option] = str(tmp_path / name)
    command = ["--tasks", ENV_ID, "--controllers", "pd"]
    assert main([*command, *(x for pair in places.items() for x in pair)]) == 2
    sentence = one_sentence(capsys)
    assert "is not a writable folder" in sentence
    assert f"choose another {option}" in sentence
    assert [x.name for x in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("cut.json", "has no results of agents.tune"),
        ("list.json", "must be a table by task, got [1]"),
        ("", "has no results"),
    ],
)
def test_another_file_of_results_is_refused_before_the_search(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cut.json").write_text('{"FlexArm')
    (tmp_path / "list.json").write_text("[1]")
    command = ["--tasks", ENV_ID, "--controllers", "pd", "--keep", str(tmp_path / "keep")]
    assert main([*command, "--out", str(tmp_path / name)]) == 2
    assert words in one_sentence(capsys)
    assert not (tmp_path / "keep").exists()


def test_a_track_with_the_controllers_of_another_is_not_tuned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`transfer` ranks the controllers of `laboratory`: its own results would act nowhere."""
    command = ["--tasks", ENV_ID, "--controllers", "pd", "--trials", "1", "--episodes", "1"]
    command += ["--out", str(tmp_path / "tuned.json"), "--keep", str(tmp_path / "keep")]
    assert main([*command, "--tracks", "state", "transfer"]) == 2
    assert one_sentence(capsys).endswith("tune on --tracks laboratory.\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "option", [("--tasks", ENV_ID), ("--tracks", "laboratory"), ("--controllers", "pd")]
)
def test_experiments_take_no_option_of_controllers(
    option: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["--experiments", str(write_config(tmp_path, "ppo", 1152)), *option]
    assert main([*command, "--out", str(tmp_path / "tuned.json")]) == 2
    assert one_sentence(capsys).endswith(f"leave {option[0]} out.\n")


@pytest.mark.parametrize("name", ["zero", "nmpc"])
def test_a_search_of_nothing_says_so(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without parameters, or on a task in which the controller takes no part."""
    command = ["--controllers", name, "--tasks", "FlexArm/OneLink-Track-v0"]
    assert main([*command, "--out", str(tmp_path / "tuned.json"), "--keep", str(tmp_path)]) == 2
    assert f"None of ['{name}'] has parameters to search" in capsys.readouterr().err
