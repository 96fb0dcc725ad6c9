"""A user's own controller: what is refused, and that the others are ranked beside it."""

import json
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.leaderboard.run import main, ranked
from agents.leaderboard.users import users_class

ONE = "FlexArm/OneLink-Reach-v0"
HERE = ["--tasks", ONE, "--tracks", "state", "--episodes", "2"]


class Still:
    """A user's controller that does nothing."""

    def __init__(self, env: Any) -> None:
        self.n_joint = env.unwrapped.n_joint

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: Any = 1
    ) -> Any:
        return np.zeros((len(observation), self.n_joint)), state


class Forgetful(Still):
    """Does not return its memory."""

    def predict(self, *given: Any, **more: Any) -> Any:
        return super().predict(*given, **more)[0]


def scaled(env: Any) -> Any:
    """A model that was trained behind RescaleAction."""
    still: Any = Still(env)
    still.action_space = gym.spaces.Box(-2.0, 2.0, (still.n_joint,))
    return still


class Mute:
    """Takes no environment."""


class Short(Still):
    """Takes the observation alone."""

    def predict(self, observation: Any) -> Any:  # type: ignore[override]
        return super().predict(observation)


class Flat(Still):
    """Gives one row for all environments."""

    def predict(self, *given: Any, **more: Any) -> Any:
        return np.zeros(self.n_joint), None


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("Forgetful", "failed in predict: ValueError: not enough values"),
        ("Short", "failed in predict: .* positional argument"),
        ("Flat", r"gave actions of shape \(1,\), expected \(1, 1\)"),
    ],
)
def test_a_users_class_is_told_how_predict_is_called(wrong: str, words: str) -> None:
    with pytest.raises(ValueError, match=words) as raised:
        ranked(f"{__name__}:{wrong}", ONE, "state", [10_000, 10_001])
    assert "called as predict(observation, state, episode_start)" in str(raised.value)


def test_a_users_model_of_scaled_actions_is_refused() -> None:
    with pytest.raises(ValueError, match=r"scaled cannot be made: .* acts in \[-2, 2\]"):
        ranked(f"{__name__}:scaled", ONE, "state", [10_000, 10_001])


def test_a_users_module_is_found_in_the_present_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also by the script `flexarm`, which has no present folder among its places of modules."""
    (tmp_path / "only_here.py").write_text("from pathlib import Path as Mine\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [x for x in sys.path if x not in ("", ".")])
    assert users_class("only_here:Mine") is Path
    assert main(["--controllers", "only_here", "--out", "out"]) == 2
    assert "as module:Class" in capsys.readouterr().err


class Lost(Still):
    """Gives NaN."""

    def predict(self, *given: Any, **more: Any) -> Any:
        return super().predict(*given, **more)[0] * np.nan, None


class Huge(Still):
    """Gives a number that float32 does not hold."""

    def predict(self, *given: Any, **more: Any) -> Any:
        return super().predict(*given, **more)[0] + 1e300, None


class Wordy(Still):
    """Gives text."""

    def predict(self, *given: Any, **more: Any) -> Any:
        return [["left"]] * len(given[0]), None


class Impatient(Still):
    """Gives up in its third step."""

    def predict(self, observation: Any, state: Any = None, *_: Any) -> Any:
        if state == 2:
            raise ZeroDivisionError
        return super().predict(observation)[0], (state or 0) + 1


class Leaving(Still):
    """Ends the process."""

    def predict(self, *given: Any, **more: Any) -> Any:
        sys.exit("enough.")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (f"{__name__}:Forgetful", "failed in predict: ValueError: not enough values"),
        (f"{__name__}:Lost", "gave the action nan, which is not a finite number in float32"),
        (f"{__name__}:Huge", "gave the action 1e+300, which is not a finite number in float32"),
        (f"{__name__}:Wordy", "gave 'left' as an action, expected numbers"),
        (f"{__name__}:Impatient", "failed in predict: ZeroDivisionError;"),
        (f"{__name__}:Leaving", "failed in predict: SystemExit: enough;"),
        (f"{__name__}:Mute", "cannot be made"),
        (
            "..above:Mine",
            "cannot be imported: ImportError: its module needs a name that does not start with",
        ),
        (":Mine", "cannot be imported: ImportError: its module needs a name"),
        ("nomodule:X", "cannot be imported: ModuleNotFoundError: No module named 'nomodule'"),
        ("math:X", "cannot be imported"),
    ],
)
def test_one_sentence_names_a_class_that_fails_and_the_others_are_ranked(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main([*HERE, "--controllers", name, "zero", "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"agents.leaderboard: --controllers {name} ")
    assert words in error
    assert error.count("\n") == 1
    results = json.loads((out / "leaderboard.json").read_text(encoding="utf-8"))
    assert list(results[ONE]["state"]) == ["zero"]
    assert "| zero |" in (out / "leaderboard.md").read_text(encoding="utf-8")


def test_a_missing_library_is_told_and_the_others_are_ranked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Installed without the extra `train`."""
    monkeypatch.setitem(sys.modules, "daqp", None)
    out = tmp_path / "out"
    assert main([*HERE, "--controllers", "mpc", "zero", "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("agents.leaderboard: predictive control needs daqp, which is not inst")
    assert error.count("\n") == 1
    results = json.loads((out / "leaderboard.json").read_text(encoding="utf-8"))
    assert list(results[ONE]["state"]) == ["zero"]


def test_nothing_is_written_where_no_class_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither one that fails at once, nor one that fails in an episode."""
    for name, status in (("Lost", 2), ("Impatient", 1)):
        out = tmp_path / name
        assert main([*HERE, "--controllers", f"{__name__}:{name}", "--out", str(out)]) == status
        assert capsys.readouterr().err.count("\n") == 1
        assert not out.exists()
