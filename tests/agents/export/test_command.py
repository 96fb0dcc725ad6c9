"""`flexarm export`: what it writes, and what it refuses before it writes."""

import errno
import os
import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from agents.export.command import main
from agents.leaderboard.shipped import place
from agents.policy import save_policy
from agents.run_folder.folder import ARM, arm_digest
from tests.agents.export.kinds import ENV_ID, laboratory, policy_of
from tests.agents.tiny import one_sentence


def test_both_formats_are_written_into_the_run(tmp_path: Path) -> None:
    save_policy(policy_of("tanh"), tmp_path / "policy")
    for form, name in (("c", "policy.h"), ("onnx", "policy.onnx")):
        assert main([str(tmp_path), "--format", form]) == 0
        assert (tmp_path / name).stat().st_size > 10_000
    other = tmp_path / "new" / "arm_2.h"
    assert main([str(tmp_path), "--format", "c", "--out", str(other)]) == 0
    assert "int arm_2_act(arm_2_memory *memory" in other.read_text()


def test_a_policy_on_a_controller_is_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = place(ENV_ID, "laboratory") / "ppo-watching-lqg" / "seed0"
    assert main([str(folder), "--format", "c", "--out", str(tmp_path / "policy.h")]) == 2
    assert "acts on the controller 'lqg' (learned: 'alone')" in one_sentence(capsys)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("about", "arguments", "sentence"),
    [
        ({}, ["--out", "x/class-1.h"], "such as policy.h, named in lower-case letters"),
        ({}, ["--out", "x/policy.c"], r"such as policy.h, named in .*, got 'x/policy.c'"),
        ({"env_id": ""}, [], r"names no environment, .* of export_policy\(model, about\)\.$"),
        ({"env_id": "CartPole-v1"}, [], "not allowed"),
        ({"env_kwargs": {}}, [], "takes 4 observations and gives 1 actions, but .* has 8 and 1"),
    ],
)
def test_bad_requests_are_refused_and_write_nothing(
    about: dict[str, object],
    arguments: list[str],
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    policy = policy_of("tanh")
    save_policy(replace(policy, about=policy.about | about), tmp_path / "policy")
    assert main([".", "--format", "c", *arguments]) == 2
    assert re.search(sentence, one_sentence(capsys))
    assert [path.name for path in tmp_path.iterdir()] == ["policy"]


def test_an_arm_file_that_has_changed_since_the_run_began_is_refused(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Scales and limits of another arm would go into the file."""
    monkeypatch.chdir(tmp_path)
    policy, arm = policy_of("tanh"), tmp_path / "arm.yaml"
    kwargs = policy.about["env_kwargs"] | {"arm": str(arm)}
    former = laboratory().arm.to_dict()
    arm.write_text(yaml.safe_dump(former))
    about = policy.about | {"env_kwargs": kwargs, ARM: arm_digest(kwargs)}
    save_policy(replace(policy, about=about), tmp_path / "policy")
    assert main([".", "--format", "c", "--out", "former.h"]) == 0
    arm.write_text(yaml.safe_dump(former | {"name": "another"}))
    capsys.readouterr()
    assert main([".", "--format", "c", "--out", "later.h"]) == 2
    assert f"{arm}: has changed since the training" in one_sentence(capsys)
    assert not Path("later.h").exists()


def test_a_folder_that_is_not_there_is_told_as_such(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path / "run"), "--format", "c"]) == 2
    assert one_sentence(capsys).endswith("run: there is no such folder.\n")


def test_a_full_disk_ends_with_the_file_and_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    save_policy(policy_of("tanh"), tmp_path / "policy")
    monkeypatch.setattr("agents.files.sync", full)
    out = tmp_path / "policy.h"
    assert main([str(tmp_path), "--format", "c", "--out", str(out)]) == 1
    assert f"writing to {out} failed (No space left on device)" in one_sentence(capsys)
    assert not out.exists()


def test_a_folder_of_runs_is_refused_with_one_of_them_and_a_file_stands_for_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_policy(policy_of("tanh"), tmp_path / "seed0" / "policy")
    assert main([str(tmp_path), "--format", "c"]) == 2
    assert re.search(r"name one of them, such as .*seed0", one_sentence(capsys))
    assert main([str(tmp_path / "seed0" / "policy" / "policy.json"), "--format", "c"]) == 0
    assert (tmp_path / "seed0" / "policy" / "policy.h").exists()
