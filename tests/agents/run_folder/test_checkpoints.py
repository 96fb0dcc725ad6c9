"""Only intact checkpoints are used, and they restore the complete learner."""

import errno
import hashlib
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.run_folder.checkpoints import (
    CheckpointError,
    is_intact,
    list_checkpoints,
    newest_intact,
    restore_checkpoint,
    save_checkpoint,
)
from tests.agents.toys import KWARGS, build

PROGRESS = {"session": 3, "seconds": 1.5}


def saved(folder: Path, *steps: int, name: str = "ppo") -> list[Path]:
    """Save checkpoints of one learner at the given numbers of steps."""
    model, paths = build(name), []
    for step in steps:
        model.num_timesteps = step
        paths.append(save_checkpoint(model, folder, PROGRESS))
    return paths


@pytest.mark.parametrize("name", sorted(KWARGS))
def test_a_checkpoint_restores_the_whole_learner(name: str, tmp_path: Path) -> None:
    """Parameters, optimizer moments, loose tensors, counters and the replay buffer."""
    trained, fresh = build(name), build(name, seed=1)
    trained.learn(64)
    moments = {"a2c": "square_avg", "ars": "weights"}.get(name, "exp_avg")
    folder = save_checkpoint(trained, tmp_path, PROGRESS)

    assert restore_checkpoint(fresh, folder) == PROGRESS

    again = save_checkpoint(fresh, tmp_path / "again", PROGRESS)
    assert (again / "state.json").read_text() == (folder / "state.json").read_text()
    with np.load(folder / "arrays.npz") as a, np.load(again / "arrays.npz") as b:
        assert a.files == b.files
        for array in a.files:
            np.testing.assert_array_equal(a[array], b[array])
    assert moments in (folder / "state.json").read_text()


def test_returns_of_several_steps_end_where_a_session_ended(tmp_path: Path) -> None:
    """A resumed session begins new episodes."""
    trained, resumed = build("sac", n_steps=3), build("sac", n_steps=3, gradient_steps=0)
    trained.learn(20)
    buffer, after = trained.replay_buffer, resumed.replay_buffer
    buffer.dones[19] = 0.0
    restore_checkpoint(resumed, save_checkpoint(trained, tmp_path, PROGRESS))
    resumed.learn(10, reset_num_timesteps=False)
    returned = after._get_samples(np.array([19]))
    assert returned.rewards.item() == buffer.rewards[19].item()
    np.testing.assert_array_equal(returned.next_observations, buffer.next_observations[19])
    assert not returned.dones.any()


def test_sha256sum_verifies_the_sums(tmp_path: Path) -> None:
    (folder,) = saved(tmp_path, 10)
    assert {path.name for path in folder.iterdir()} == {"arrays.npz", "state.json", "SHA256SUMS"}
    if shutil.which("sha256sum"):
        command = ["sha256sum", "--strict", "-c", "SHA256SUMS"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)


def with_sums(folder: Path, **state: Any) -> None:
    """Change the state and recompute the sums, as malice would."""
    path = folder / "state.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | state))
    files = [folder / "arrays.npz", path]
    lines = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.name}\n" for f in files]
    (folder / "SHA256SUMS").write_text("".join(lines))


def truncate(name: str) -> Callable[[Path], None]:
    return lambda folder: os.truncate(folder / name, 10)


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def write(name: str, text: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(text) and None


def state(**values: Any) -> Callable[[Path], None]:
    return lambda folder: with_sums(folder, **values)


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (truncate("arrays.npz"), "do not have the sums"),
        (truncate("SHA256SUMS"), "do not have the sums"),
        (write("state.json", "null"), "do not have the sums"),
        (write("SHA256SUMS", ""), "do not have the sums"),
        (write("SHA256SUMS", "0  ../../other\n"), "do not have the sums"),
        (remove("arrays.npz"), "No such file"),
        (remove("state.json"), "No such file"),
        (remove("SHA256SUMS"), "No such file"),
        (state(progress={}), "progress.session must be an int, got None"),
        (state(progress=None), "progress must be a table, got None"),
        (state(progress=[1]), "progress must be a table"),
        (state(progress={"session": -1, "seconds": 1.0}), "between 0 and 1000000000000000, got -1"),
        (state(progress={"session": 0, "seconds": "1"}), "must be a number, got the text '1'"),
        (state(progress={"session": 0, "seconds": -1.0}), "must not be negative"),
        (state(progress={"session": 0, "seconds": float("nan")}), "must be a finite number"),
        (
            state(progress={"session": 0, "seconds": 1.0, "episodes": -1}),
            "progress.episodes must be between 0 and",
        ),
        (state(num_timesteps="64"), "num_timesteps must be an int, got '64'"),
        (state(num_timesteps=-64), "num_timesteps must be between 0 and"),
        (state(num_timesteps=None), "num_timesteps must be an int, got None"),
        (state(n_updates=True), "n_updates must be an int, got True"),
        (state(code="x"), "Unknown key 'code' in state.json"),
    ],
)
def test_a_damaged_checkpoint_is_skipped_with_a_message(
    damage: Callable[[Path], None], sentence: str, tmp_path: Path
) -> None:
    older, newer = saved(tmp_path, 10, 20)
    damage(newer)
    found, flaws = newest_intact(tmp_path)
    assert found == older
    assert len(flaws) == 1
    assert flaws[0].startswith(f"{newer}: is not intact")
    assert sentence in flaws[0]
    assert "\n" not in flaws[0]


def test_only_folders_named_as_checkpoints_are_checkpoints(tmp_path: Path) -> None:
    for name in ("step_last", "step_0000000000100", "step_\x1b[31m", "x_step_000000000020"):
        (tmp_path / name).mkdir()
    (tmp_path / "step_000000000030").touch()
    assert list_checkpoints(tmp_path) == []
    assert newest_intact(tmp_path) == (None, [])


def test_no_checkpoint_is_found_if_none_is_intact(tmp_path: Path) -> None:
    assert newest_intact(tmp_path / "none") == (None, [])
    for path in saved(tmp_path, 10, 20):
        truncate("arrays.npz")(path)
    found, flaws = newest_intact(tmp_path)
    assert found is None
    assert len(flaws) == 2


def test_damaged_checkpoints_do_not_displace_intact_ones(tmp_path: Path) -> None:
    """Steps 20 and 30 are damaged, so training continues from 10: only 10 and 15 remain."""
    shutil.copytree(*saved(tmp_path, 10), tmp_path / "kept")
    for path in saved(tmp_path, 20, 30):
        truncate("arrays.npz")(path)
    shutil.copytree(tmp_path / "kept", tmp_path / "step_000000000010", dirs_exist_ok=True)
    saved(tmp_path, 15)
    assert [path.name[-2:] for path in list_checkpoints(tmp_path)] == ["10", "15"]
    saved(tmp_path, 25, 35)
    assert [path.name[-2:] for path in list_checkpoints(tmp_path)] == ["25", "35"]


def test_a_damaged_checkpoint_of_the_same_step_is_replaced(tmp_path: Path) -> None:
    (path,) = saved(tmp_path, 10)
    truncate("arrays.npz")(path)
    assert not is_intact(path)
    saved(tmp_path, 10)
    assert is_intact(path)


@pytest.mark.parametrize(
    "hostile",
    [
        {"parameters": {"table": []}},
        {"parameters": {"table": [["env.close", {"table": []}]]}},
        {"parameters": {"tensor": "tensor/0"}},
        {"parameters": {"table": [["policy", {"tensor": "none"}]]}},
        {"parameters": {"table": 5}},
        {"parameters": [[[[[[]]]]]]},
        {"variables": None, "parameters": None},
        {"replay": {"pos": 5, "full": False}},
    ],
)
def test_an_intact_checkpoint_of_another_model_does_not_fit(
    hostile: dict[str, Any], tmp_path: Path
) -> None:
    (path,) = saved(tmp_path, 10)
    with_sums(path, **hostile)
    assert is_intact(path)
    with pytest.raises(CheckpointError, match="does not fit this run"):
        restore_checkpoint(build("ppo"), path)


def test_a_checkpoint_of_another_algorithm_does_not_fit(tmp_path: Path) -> None:
    (path,) = saved(tmp_path, 10)
    with pytest.raises(CheckpointError, match="does not fit this run"):
        restore_checkpoint(build("sac"), path)
    shutil.rmtree(path)
    with pytest.raises(CheckpointError, match="is not intact"):
        restore_checkpoint(build("ppo"), path)


@pytest.mark.parametrize("function", ["fsync", "rename"])
def test_a_full_disk_leaves_the_earlier_checkpoint_and_nothing_else(
    function: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path,) = saved(tmp_path, 10)

    def full(*arguments: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, function, full)
    with pytest.raises(OSError, match="No space left"):
        saved(tmp_path, 20)
    assert list(tmp_path.iterdir()) == [path]
    assert is_intact(path)
