"""Small training runs: their experiments and the command that runs them."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from agents.run_folder.checkpoints import list_checkpoints
from agents.run_folder.folder import RunFolder
from tests.agents import toys
from tests.paths import ROOT

ENV_ID = "FlexArm/OneLink-Reach-v0"
KWARGS = toys.KWARGS | {
    "ppo": {"n_steps": 16, "batch_size": 64, "n_epochs": 1, "policy_kwargs": {"net_arch": [8]}},
    "sac": {"batch_size": 16, "learning_starts": 64, "buffer_size": 4096},
}
KWARGS["rsl-ppo"] = KWARGS["shac"] = KWARGS["ppo"]


def write_config(folder: Path, name: str, total_steps: int, **env: Any) -> Path:
    """Write a small experiment with a checkpoint after about every rollout."""
    path = folder / f"tiny_{name}.yaml"
    experiment = {
        "env": {"id": ENV_ID, "n_envs": 8} | env,
        "agent": {"name": name, "kwargs": KWARGS[name]},
        "total_steps": total_steps,
        "checkpoint_seconds": 0.001,
        "evaluation": {"episodes": 3},
    }
    path.write_text(yaml.safe_dump(experiment), encoding="utf-8")
    return path


def train_py(*arguments: str | Path) -> subprocess.Popen[str]:
    """Start `python train.py` with the arguments in a new process."""
    return subprocess.Popen(
        [sys.executable, str(ROOT / "train.py"), *map(str, arguments)],
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_steps(process: subprocess.Popen[str], run: RunFolder, steps: int) -> None:
    """Wait until the process has written a checkpoint at `steps` or later."""
    deadline = time.monotonic() + 120.0
    while not any(int(path.name[5:]) >= steps for path in list_checkpoints(run.checkpoints)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "no checkpoint after two minutes"
        time.sleep(0.01)


def one_sentence(capsys: pytest.CaptureFixture[str]) -> str:
    """The error message of a command, which must be one line."""
    error = capsys.readouterr().err
    assert error.strip().count("\n") == 0, error
    return error
