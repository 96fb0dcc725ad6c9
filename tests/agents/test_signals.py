"""Ctrl-C and SIGTERM end a run at a checkpoint, and other work at once."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agents import training
from agents.evaluate import main as evaluate
from agents.run_folder.checkpoints import list_checkpoints, newest_intact
from agents.run_folder.folder import RunFolder
from agents.signals import Interrupted, StopLater, signals_to, stop_at_once
from agents.training import main as train
from tests.agents.tiny import ENV_ID, one_sentence, train_py, wait_for_steps, write_config
from tests.paths import ROOT


@pytest.fixture(autouse=True)
def heard() -> Iterator[None]:
    """SIGINT acts even where the tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


BOTH = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


@BOTH
def test_a_signal_ends_a_run_at_a_checkpoint_where_it_resumes(
    number: signal.Signals, tmp_path: Path, capsys: pytest.CaptureFixture[str], unjudged: Any
) -> None:
    run = RunFolder(tmp_path / "a run")
    process = train_py("--config", write_config(tmp_path, "ppo", 10**7), "--out", run.path)
    wait_for_steps(process, run, 1)
    process.send_signal(number)
    _, said = process.communicate()
    assert process.returncode == 128 + number
    assert f"train.py: interrupted; resume with: python train.py --resume '{run.path}'" in said
    assert "Traceback" not in said
    last = list_checkpoints(run.checkpoints)[-1]
    assert newest_intact(run.checkpoints) == (last, [])
    steps = int(last.name.removeprefix("step_"))
    assert run.rows()[-1]["steps"] == steps
    assert not list(run.path.rglob(".partial*"))

    assert train(["--resume", str(run.path), "--steps", str(steps + 256)]) == 0
    assert f"Resuming at {steps:,}" in capsys.readouterr().out


@BOTH
def test_the_second_signal_stops_at_once(
    number: signal.Signals,
    run: RunFolder,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = {path.name for path in list_checkpoints(run.checkpoints)}
    append = RunFolder.append

    def append_and_signal(self: RunFolder, row: Any) -> None:
        append(self, row)
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)

    monkeypatch.setattr(RunFolder, "append", append_and_signal)
    assert train(["--resume", str(run.path), "--steps", "512"]) == 128 + number
    assert f"python train.py --resume {run.path}" in capsys.readouterr().err
    assert {path.name for path in list_checkpoints(run.checkpoints)} == before


@BOTH
def test_a_signal_stops_an_evaluation_at_once_and_resuming_repeats_it(
    number: signal.Signals,
    run: RunFolder,
    unjudged: list[RunFolder],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(training, "judge", lambda run, config: os.kill(os.getpid(), number))
        assert train(["--resume", str(run.path)]) == 128 + number
    assert f"resume with: python train.py --resume {run.path}" in one_sentence(capsys)
    unjudged.clear()
    assert train(["--resume", str(run.path)]) == 0
    assert unjudged == [run]


@BOTH
def test_a_signal_before_the_run_creates_no_folder(
    number: signal.Signals,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(training, "build_model", lambda config: os.kill(os.getpid(), number))
    config = write_config(tmp_path, "ppo", 256)
    assert train(["--config", str(config), "--out", str(tmp_path / "out")]) == 128 + number
    assert "there is no run to resume yet" in one_sentence(capsys)
    assert not (tmp_path / "out").exists()


@BOTH
def test_a_signal_ends_an_evaluation_with_a_message(
    number: signal.Signals,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(*arguments: Any, **keywords: Any) -> None:
        os.kill(os.getpid(), number)

    monkeypatch.setattr("agents.evaluate.compare", interrupted)
    assert evaluate(["zero", "--env", ENV_ID, "--out", str(tmp_path)]) == 128 + number
    assert "interrupted" in one_sentence(capsys)


def test_handlers_are_restored_and_other_threads_do_not_set_them() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    later = StopLater()
    with signals_to(later):
        assert signal.getsignal(signal.SIGTERM) is later
        with pytest.raises(Interrupted), signals_to(stop_at_once):
            os.kill(os.getpid(), signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is later
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    seen = []

    def elsewhere() -> None:
        with signals_to(later):
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert seen == [before[1]]


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with signals_to(StopLater()):
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


WORKING = """
import os, time
from agents.signals import workers
with workers(1) as pool:
    print(pool.submit(os.getpid).result(), flush=True)
    pool.submit(time.sleep, 60).result()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_started_them(number: signal.Signals) -> None:
    """They have its output, which is open until the last of them has ended."""
    command = [sys.executable, "-c", WORKING]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=ROOT)
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    process.send_signal(number)
    if number == signal.SIGINT:  # which a terminal sends to all
        os.kill(worker, number)
    _, said = process.communicate(timeout=20.0)
    assert said.count("Traceback") == (number == signal.SIGINT)
