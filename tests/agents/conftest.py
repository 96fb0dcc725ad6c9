"""Fixtures of small training runs."""

import shutil
from pathlib import Path

import pytest
import torch

from agents import training
from agents.run_folder.folder import RunFolder
from agents.training import main as train
from tests.agents.tiny import write_config

torch.set_num_threads(1)  # as in training


@pytest.fixture
def unjudged(monkeypatch: pytest.MonkeyPatch) -> list[RunFolder]:
    """Runs that reached their evaluation, which is skipped because it takes long."""
    judged: list[RunFolder] = []
    monkeypatch.setattr(training, "judge", lambda run, config: judged.append(run))
    return judged


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run that ended at its first checkpoint, as a kill between two rollouts leaves it."""
    folder = tmp_path_factory.mktemp("trained")
    run = RunFolder(folder / "out")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "judge", lambda run, config: None)
        config = write_config(folder, "ppo", 256)
        assert train(["--config", str(config), "--out", str(run.path)]) == 0
    run.versions.unlink()  # where the end of a run is marked
    return run


@pytest.fixture
def run(tmp_path: Path, unjudged: list[RunFolder], trained: RunFolder) -> RunFolder:
    """A copy of that run, to go on with or to damage."""
    write_config(tmp_path, "ppo", 256)
    return RunFolder(shutil.copytree(trained.path, tmp_path / "out", symlinks=True))
