"""Checkpoints of a run as arrays plus JSON: written atomically, verified, read without pickle."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from agents.arrays import read_arrays
from agents.environments import REFUSALS
from agents.files import digest, sync
from agents.learners.normalization import restore_statistics, statistics
from dynamics.description import validate
from dynamics.description.data_file import read_mapping
from dynamics.types import AnyArray

KEPT = 2  # newest checkpoints that stay on disk
REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
ARRAYS, STATE, SUMS = "arrays.npz", "state.json", "SHA256SUMS"
KEYS = ("parameters", "variables", "num_timesteps", "n_updates", "progress", "replay")
LARGEST_COUNT = 10**15  # steps, updates or sessions
MISFITS: tuple[type[Exception], ...] = (*REFUSALS, OSError, LookupError, AttributeError)


class CheckpointError(ValueError):
    """A checkpoint that cannot be used; the message is one sentence for the user."""


def save_checkpoint(model: Any, folder: Path, progress: dict[str, Any]) -> Path:
    """Write the model's complete state to a new checkpoint below the folder; returns its path.

    The files are written to a temporary folder and flushed to the disk; then one rename gives the
    folder its final name, so a kill leaves the previous checkpoint intact.
    `sha256sum -c SHA256SUMS` verifies the files.
    """
    final = folder / f"step_{model.num_timesteps:012d}"
    if final.exists():
        if is_intact(final):
            return final
        shutil.rmtree(final)
    if not folder.is_dir():
        folder.mkdir(parents=True)
        sync(folder.parent)
    temporary = folder / ".partial"
    shutil.rmtree(temporary, ignore_errors=True)  # leftover of a process killed while writing
    try:
        temporary.mkdir()
        write_state(model, temporary, progress)
        sums = [f"{digest(temporary / name)}  {name}\n" for name in (ARRAYS, STATE)]
        (temporary / SUMS).write_text("".join(sums), encoding="ascii")
        for path in (*temporary.iterdir(), temporary):
            sync(path)
        os.rename(temporary, final)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    sync(folder)
    prune(folder, final)
    return final


def write_state(model: Any, folder: Path, progress: dict[str, Any]) -> None:
    """Write the arrays and the other state of the model into the folder."""
    arrays: dict[str, Any] = statistics(model)
    state = {
        "parameters": flattened(model.get_parameters(), arrays),
        "variables": flattened(loose_variables(model), arrays),
        "num_timesteps": model.num_timesteps,
        "n_updates": model._n_updates,
        "progress": progress,
    }
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        filled = buffer.buffer_size if buffer.full else buffer.pos
        state["replay"] = {"pos": buffer.pos, "full": buffer.full}
        for name in REPLAY:
            arrays[f"replay/{name}"] = getattr(buffer, name)[:filled]
        arrays["replay/timeouts"] = cut_off(buffer)[:filled]
    np.savez(folder / ARRAYS, **arrays)
    (folder / STATE).write_text(json.dumps(state), encoding="utf-8")


def cut_off(buffer: Any) -> AnyArray:
    """Time-outs of a replay buffer; the session that resumes goes on with none of its episodes.

    Returns of several steps would add up rewards across the seam.
    """
    timeouts, last = buffer.timeouts.copy(), buffer.pos - 1
    timeouts[last] = np.maximum(timeouts[last], 1.0 - buffer.dones[last])
    return timeouts


def prune(folder: Path, newest: Path) -> None:
    """Keep `newest` and KEPT - 1 before it; later checkpoints are damaged and removed too."""
    found = list_checkpoints(folder)
    kept = found[: found.index(newest) + 1][-KEPT:]
    for path in found:
        if path not in kept:
            shutil.rmtree(path)


def list_checkpoints(folder: Path) -> list[Path]:
    """All checkpoints in the folder, oldest first, including damaged ones."""
    return sorted(path for path in folder.glob(f"step_{12 * '[0-9]'}") if path.is_dir())


def newest_intact(folder: Path) -> tuple[Path | None, list[str]]:
    """The newest intact checkpoint, and a sentence about each newer one that is not intact."""
    flaws: list[str] = []
    for path in reversed(list_checkpoints(folder)):
        try:
            verified(path)
            return path, flaws
        except CheckpointError as error:
            flaws.append(str(error))
    return None, flaws


def is_intact(folder: Path) -> bool:
    """True if a checkpoint passes verification."""
    try:
        verified(folder)
    except CheckpointError:
        return False
    return True


def verified(folder: Path) -> dict[str, Any]:
    """Read the state of a checkpoint after checking sums and values; raises CheckpointError."""
    try:
        sums = (folder / SUMS).read_bytes()
        names = (ARRAYS, STATE)
        if sums != "".join(f"{digest(folder / name)}  {name}\n" for name in names).encode():
            raise ValueError(f"its files do not have the sums in {SUMS}.")
        state = validate.mapping(read_mapping(folder / STATE), STATE, KEYS)
        for name in ("num_timesteps", "n_updates"):
            validate.integer(state.get(name), name, 0, LARGEST_COUNT)
        progress = state.get("progress")
        if not isinstance(progress, dict):
            raise ValueError(f"progress must be a table, got {validate.shown(progress)}.")
        validate.integer(progress.get("session"), "progress.session", 0, LARGEST_COUNT)
        validate.nonnegative(progress.get("seconds"), "progress.seconds", "s")
        validate.integer(progress.get("episodes", 0), "progress.episodes", 0, LARGEST_COUNT)
        return state
    except OSError as error:
        raise CheckpointError(f"{folder}: is not intact ({error.strerror or error}).") from None
    except ValueError as error:
        raise CheckpointError(f"{folder}: is not intact: {error}") from None


def restore_checkpoint(model: Any, folder: Path) -> dict[str, Any]:
    """Restore a checkpoint into a newly built model; returns the progress.

    After a CheckpointError the model is partly restored and must not be used.
    """
    state = verified(folder)
    try:
        arrays = read_arrays(folder / ARRAYS)
        parameters = unflattened(state["parameters"], arrays)
        variables = unflattened(state["variables"], arrays)
        model.set_parameters(parameters, device="cpu")
        for name, value in loose_variables(model).items():
            value.data.copy_(variables[name])
        restore_statistics(model, arrays)
        model.num_timesteps = state["num_timesteps"]
        model._n_updates = state["n_updates"]
        if "replay" in state:
            buffer = model.replay_buffer
            for name in REPLAY:
                rows = arrays[f"replay/{name}"]
                getattr(buffer, name)[: len(rows)] = rows
            buffer.pos, buffer.full = state["replay"]["pos"], state["replay"]["full"]
        return dict(state["progress"])
    except MISFITS as error:
        reason = " ".join(str(error).split())
        raise CheckpointError(f"{folder}: does not fit this run ({reason}).") from None


def loose_variables(model: Any) -> dict[str, Any]:
    """Tensors outside the modules, such as SAC's entropy coefficient."""
    return {name: getattr(model, name) for name in model._get_torch_save_params()[1]}


def flattened(tree: Any, arrays: dict[str, Any]) -> Any:
    """The tree as JSON; its tensors are put into `arrays` and replaced by their names.

    A dict becomes a list of pairs, because optimizer states have integer keys.
    """
    import torch

    if isinstance(tree, torch.Tensor):
        name = f"tensor/{len(arrays)}"
        arrays[name] = tree.detach().cpu().numpy()
        return {"tensor": name}
    if isinstance(tree, dict):
        return {"table": [[key, flattened(value, arrays)] for key, value in tree.items()]}
    if isinstance(tree, list | tuple):
        return {"list": [flattened(value, arrays) for value in tree]}
    return tree


def unflattened(tree: Any, arrays: dict[str, Any]) -> Any:
    """Inverse of `flattened`; tuples come back as lists."""
    import torch

    if not isinstance(tree, dict):
        return tree
    if "tensor" in tree:
        return torch.from_numpy(arrays[tree["tensor"]].copy())
    if "table" in tree:
        return {key: unflattened(value, arrays) for key, value in tree["table"]}
    return [unflattened(value, arrays) for value in tree["list"]]
