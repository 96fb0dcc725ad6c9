"""Run folders: exclusive use, refusals that create nothing, and resuming after damage."""

import errno
import os
import shlex
import shutil
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO

from agents import training
from agents.config import load_config
from agents.evaluate import find_policy
from agents.evaluate import main as evaluate
from agents.experiments import find_experiment
from agents.files import FolderError
from agents.leaderboard.shipped import named_policy
from agents.policy import PolicyError, load_policy, save_policy
from agents.run_folder.checkpoints import list_checkpoints, newest_intact
from agents.run_folder.folder import FINISHED, RunFolder, new_run, refuse_used, versions
from agents.run_folder.lock import folder_lock
from agents.training import about_policy
from agents.training import main as train
from tests.agents.tiny import ENV_ID, one_sentence, train_py, wait_for_steps, write_config
from tests.paths import ROOT

# ---- one process per folder ------------------------------------------------------------------


def test_two_processes_never_use_the_same_folder(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    resume = train_py("--resume", run.path, "--steps", 10**7)
    wait_for_steps(resume, run, 512)
    log = run.log.read_bytes()
    try:
        assert train(["--resume", str(run.path), "--steps", "512"]) == 2
        assert "is in use by another process" in one_sentence(capsys)
    finally:
        resume.kill()
        resume.communicate()
    assert run.log.read_bytes().startswith(log)
    steps = int(list_checkpoints(run.checkpoints)[-1].name.removeprefix("step_"))
    assert train(["--resume", str(run.path), "--steps", str(steps)]) == 0, "a kill left the lock"


def test_two_new_runs_never_get_the_same_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], unjudged: Any
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    config = write_config(tmp_path, "ppo", 256)
    with folder_lock(out):
        assert train(["--config", str(config), "--out", str(out)]) == 2
        assert "is in use by another process" in one_sentence(capsys)
        assert evaluate(["zero", "--env", ENV_ID, "--out", str(out)]) == 2
    assert "is in use by another process" in one_sentence(capsys)
    assert [path.name for path in out.iterdir()] == [".lock"]
    assert train(["--config", str(config), "--out", str(out)]) == 0


def test_runs_that_start_together_get_different_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    config = load_config(write_config(tmp_path, "ppo", 256))
    with ThreadPoolExecutor(16) as pool:
        runs = list(pool.map(lambda _: new_run(None, config), range(64)))
    assert len({run.path for run in runs}) == 64
    assert Path("runs/tiny_ppo/seed0") in {run.path for run in runs}


# ---- nothing is made for a bad request -------------------------------------------------------


@pytest.mark.parametrize(
    ("kwargs", "sentence"),
    [
        ({"obs": "sensor"}, "obs must be one of"),
        ({"foo": 1}, "Unknown key 'foo' in env.kwargs"),
        ({"arm": "nope.yaml"}, "nope.yaml"),
        ({"torque_limit": {}}, "torque_limit"),
        ({"reward": {"no_such": 1.0}}, "no_such"),
        ({"wrappers": []}, "Unknown key 'wrappers'"),
        ({"substeps": 10**23}, "substeps must be between 1 and 1000000"),
    ],
)
def test_bad_keywords_create_no_folder(
    kwargs: dict[str, Any],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    config = write_config(tmp_path, "ppo", 256, kwargs=kwargs)
    for out in ([], ["--out", "out/deeper"]):
        assert train(["--config", str(config), *out]) == 2
        assert sentence in one_sentence(capsys)
    assert [path.name for path in tmp_path.iterdir()] == [config.name]


def test_bad_agent_keywords_create_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only the learner detects this error."""
    config = write_config(tmp_path, "ppo", 256)
    experiment = yaml.safe_load(config.read_text())
    experiment["agent"]["kwargs"] |= {"n_steps": 2, "batch_size": 1}
    config.write_text(yaml.safe_dump(experiment))
    assert train(["--config", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "agent: ppo refuses its keywords" in one_sentence(capsys)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("link", ["metrics.jsonl", "policy", ".partial_config.yaml"])
def test_a_run_with_links_is_not_written_to(
    link: str, run: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Repairing a linked log would cut off the last line of a foreign file."""
    target = tmp_path / "precious"
    target.write_text("no end of line")
    path = run.path / link
    if path.is_dir():
        path.rename(tmp_path / "moved")
    path.unlink(missing_ok=True)
    path.symlink_to(target)
    assert train(["--resume", str(run.path), "--steps", "512"]) == 2
    assert f"{path}: is a link" in one_sentence(capsys)
    assert target.read_text() == "no end of line"


# ---- provenance ------------------------------------------------------------------------------


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="a copy without git has no revision")
def test_a_run_records_the_commit_of_the_source() -> None:
    command = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    commit = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert versions()["revision"] in (commit, commit + "+")


# ---- damage and a full disk ------------------------------------------------------------------


def test_a_damaged_newest_checkpoint_is_skipped(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    run.versions.unlink()
    older, newer = list_checkpoints(run.checkpoints)
    os.truncate(newer / "arrays.npz", 100)
    rows = run.rows()
    capsys.readouterr()
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    said = capsys.readouterr().out
    assert f"Skipped {newer}: is not intact" in said
    assert f"Resuming at {int(older.name[5:]):,} of 512" in said
    assert run.rows()[: len(rows)] == rows
    assert {row["session"] for row in run.rows()} == {0, 1, 2}


def test_a_run_without_an_intact_checkpoint_restarts_in_a_new_session(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in list_checkpoints(run.checkpoints):
        (path / "state.json").write_text("null")
    rows = run.rows()
    capsys.readouterr()
    assert train(["--resume", str(run.path)]) == 0
    said = capsys.readouterr().out
    assert said.count("Skipped") == 2
    assert "No checkpoint is intact: starting from the beginning." in said
    assert run.rows()[: len(rows)] == rows
    assert {row["session"] for row in run.rows()} == {0, 1}


def test_invalid_lines_of_the_log_are_counted_in_a_message(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = run.rows()
    run.log.write_bytes(b"5\nnull\n{}\n\xff\xfe\n" + run.log.read_bytes() + b'{"session": 0, ')
    capsys.readouterr()
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    said = capsys.readouterr().out
    assert "skipped lines that are not rows (4 of them)" in said
    assert "cut off an incomplete last line of 15 bytes" in said
    assert run.rows()[: len(rows)] == rows
    assert len(run.rows()) > len(rows)


def test_a_checkpoint_of_another_network_is_refused(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run.config.read_text()
    assert "- 8\n" in text
    run.config.write_text(text.replace("- 8\n", "- 9\n"))
    assert train(["--resume", str(run.path), "--steps", "512"]) == 2
    assert "does not fit this run" in one_sentence(capsys)


@pytest.mark.parametrize("name", ["arrays.npz", "weights.npz"])
def test_a_full_disk_ends_with_a_message_and_the_run_can_resume(
    name: str,
    run: RunFolder,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    savez: Callable[..., None] = np.savez

    def full(path: Any, **arrays: Any) -> None:
        if not str(path).endswith(name):
            return savez(path, **arrays)
        Path(path).write_bytes(b"PK" * 100)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        assert train(["--resume", str(run.path), "--steps", "512"]) == 1
    sentence = one_sentence(capsys)
    assert "No space left on device; resume with: python train.py --resume" in sentence
    assert not list(run.path.rglob(".partial*"))
    found, flaws = newest_intact(run.checkpoints)
    assert found is not None
    assert flaws == []
    assert load_policy(run.policy).about["steps"] == 256
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    assert load_policy(run.policy).about["steps"] == 512


def test_a_full_disk_ends_an_evaluation_with_a_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*arguments: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    out = tmp_path / "out"
    arguments = ["zero", "--env", ENV_ID, "--episodes", "1", "--out", str(out)]
    assert evaluate(arguments) == 1
    assert f"writing to {out} failed (No space left on device)" in one_sentence(capsys)
    assert [path.name for path in out.iterdir()] == [".lock"]


def test_a_diverged_training_ends_with_a_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path, "ppo", 100_000)
    experiment = yaml.safe_load(config.read_text())
    experiment["agent"]["kwargs"] |= {"learning_rate": 10.0, "max_grad_norm": 1.0e6, "n_epochs": 9}
    config.write_text(yaml.safe_dump(experiment))
    assert train(["--config", str(config), "--out", str(tmp_path / "out")]) == 1
    assert "the training has diverged" in one_sentence(capsys)


def test_a_training_that_diverges_in_its_last_update_says_so_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverge(model: PPO) -> None:
        next(model.policy.parameters()).data.fill_(float("nan"))

    monkeypatch.setattr(PPO, "train", diverge)
    config, out = str(write_config(tmp_path, "ppo", 128)), str(tmp_path / "out")
    for arguments in (["--config", config, "--out", out], ["--resume", out]):
        assert train(arguments) == 1
        assert "the training has diverged" in one_sentence(capsys)


def test_a_damaged_untrained_network_is_written_again(run: RunFolder) -> None:
    """Every session writes the network with the weights of the first session."""
    weights = load_policy(run.untrained).weights
    (run.untrained / "weights.npz").write_bytes(b"")
    with pytest.raises(PolicyError):
        load_policy(run.untrained)
    assert train(["--resume", str(run.path), "--steps", "512"]) == 0
    for first, again in zip(weights, load_policy(run.untrained).weights, strict=True):
        np.testing.assert_array_equal(first, again)


def test_a_lock_that_cannot_be_created_is_refused(tmp_path: Path) -> None:
    (tmp_path / ".lock").mkdir()
    with pytest.raises(FolderError, match="cannot be locked"), folder_lock(tmp_path):
        pass


def test_a_lock_that_is_a_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("x")
    (tmp_path / ".lock").symlink_to(tmp_path / "precious")
    with pytest.raises(FolderError, match="is a link"), folder_lock(tmp_path):
        pass
    assert (tmp_path / "precious").read_text() == "x"


def test_the_command_that_resumes_a_folder_is_one_for_a_shell(tmp_path: Path) -> None:
    used = tmp_path / "my run"
    used.mkdir()
    (used / "file").touch()
    with pytest.raises(FolderError) as caught:
        refuse_used(used)
    advised = str(caught.value).rpartition("--resume ")[2].removesuffix(".")
    assert shlex.split(advised) == [str(used)]


LINK = "links: [{length: 1.0, rho_A: 0.3, EIz: 10.0}]\n"


def with_arm(run: RunFolder, arm: Path) -> None:
    """Make a run one of an arm file, as if it had begun with it."""
    arm.write_text(LINK)
    text = run.config.read_text().replace("  kwargs: {}\n", f"  kwargs: {{arm: {arm}}}\n")
    run.config.write_text(text)
    about = about_policy(run.read_config())
    for folder in (run.untrained, run.policy):
        save_policy(replace(load_policy(folder), about=about), folder)


def test_an_arm_file_that_has_changed_since_a_run_began_is_refused(
    run: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where the policy alone has been copied out of its run."""
    arm, alone = tmp_path / "arm.yaml", tmp_path / "alone"
    with_arm(run, arm)
    shutil.copytree(run.policy, alone)
    out = ["--out", str(tmp_path / "evaluation")]
    commands = [(train, ["--resume", str(run.path)]), *((evaluate, [str(x), *out]) for x in
                (run.path, run.policy, alone))]  # fmt: skip
    run.refuse_other_arm({"arm": str(arm)})
    arm.write_text(LINK.replace("10.0", "20.0"))
    for main, arguments in commands:
        assert main(arguments) == 2
        assert f"{arm}: has changed since the training of the policy" in one_sentence(capsys)
    assert not (tmp_path / "evaluation").exists()


def test_an_arm_file_that_changes_during_a_training_is_not_evaluated_with(
    run: RunFolder,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    unjudged: list[RunFolder],
) -> None:
    arm = tmp_path / "arm.yaml"
    with_arm(run, arm)
    monkeypatch.setattr(training, "prepare", lambda config: None)
    monkeypatch.setattr(training, "learn", lambda run, config: arm.write_text("links: []"))
    assert train(["--resume", str(run.path)]) == 2
    assert f"{arm}: has changed since the training of the policy" in one_sentence(capsys)
    assert unjudged == []
    assert run.finished_at() is None


@pytest.mark.parametrize("damage", ["layers", "warm start"])
def test_a_resume_that_is_refused_leaves_the_run_as_it_is(
    damage: str, run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run.config.read_text()
    if damage == "layers":
        run.config.write_text(text.replace("- 8\n", "- 9\n"))
    else:  # and the network that began with it
        run.config.write_text(text.replace("warm_start: ''", "warm_start: nowhere"))
        shutil.rmtree(run.untrained)
    run.write_versions({FINISHED: 256})
    run.log.write_bytes(run.log.read_bytes() + b'{"session": 0, ')
    before = {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()}
    assert train(["--resume", str(run.path), "--steps", "512"]) == 2
    assert {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()} == before


def test_a_home_in_quotes_is_that_of_the_user(
    run: RunFolder,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    own = load_policy(run.policy).about
    assert find_experiment("~/tiny_ppo.yaml") == tmp_path / "tiny_ppo.yaml"
    assert named_policy("~/out", 0).about == own
    policy = find_policy("~/out/policy/policy.json", trust=False)
    assert policy is not None
    assert policy.about == own
    assert train(["--resume", "~/none"]) == 2
    assert f"{tmp_path}/none: is not a run" in one_sentence(capsys)
    for main, arguments in (train, ["--config"]), (evaluate, ["--out", str(tmp_path / "new")]):
        assert main([*arguments, "~nobody-here/x.yaml"]) == 2
        assert "home of a user who has none; write the whole path" in one_sentence(capsys)
