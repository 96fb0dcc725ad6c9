"""Checkpoints of a run as arrays plus JSON: written whole, verified, read without unpickling."""

import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from agents.arrays import read_arrays
from agents.environments import REFUSALS
from agents.files import sync
from dynamics.description import validate
from dynamics.description.data_file import read_mapping

KEPT = 2  # newest checkpoints that stay on disk
REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
ARRAYS, STATE, SUMS = "arrays.npz", "state.json", "SHA256SUMS"
KEYS = ("parameters", "variables", "num_timesteps", "n_updates", "progress", "replay")
LARGEST_COUNT = 10**15  # steps, updates or sessions
MISFITS: tuple[type[Exception], ...] = (*REFUSALS, OSError, LookupError, AttributeError)


class CheckpointError(ValueError):
    """A checkpoint that cannot be used; the message is one sentence for the user."""


def save_checkpoint(model: Any, folder: Path, progress: dict[str, Any]) -> Path:
    """Write the model's complete state below the folder; a kill leaves the previous one whole.

    Everything goes to a temporary folder first, reaches the disk, and appears under its final
    name in one rename. Its sums are those that `sha256sum -c SHA256SUMS` verifies.
    """
    final = folder / f"step_{model.num_timesteps:012d}"
    if final.exists():
        if is_whole(final):
            return final
        shutil.rmtree(final)
    if not folder.is_dir():
        folder.mkdir(parents=True)
        sync(folder.parent)
    temporary = folder / ".partial"
    shutil.rmtree(temporary, ignore_errors=True)  # of a process that was killed while writing
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
    """Write the arrays and the rest of the model's state into the folder."""
    arrays: dict[str, Any] = {}
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
    np.savez(folder / ARRAYS, **arrays)
    (folder / STATE).write_text(json.dumps(state), encoding="utf-8")


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def prune(folder: Path, newest: Path) -> None:
    """Remove all but the newest checkpoints; those of later steps are damaged ones it replaces."""
    found = list_checkpoints(folder)
    kept = found[: found.index(newest) + 1][-KEPT:]
    for path in found:
        if path not in kept:
            shutil.rmtree(path)


def list_checkpoints(folder: Path) -> list[Path]:
    """Checkpoints in the folder, whole or not, oldest first."""
    return sorted(path for path in folder.glob(f"step_{12 * '[0-9]'}") if path.is_dir())


def newest_whole(folder: Path) -> tuple[Path | None, list[str]]:
    """The newest checkpoint that is whole, and a sentence about each newer one that is not."""
    flaws: list[str] = []
    for path in reversed(list_checkpoints(folder)):
        try:
            verified(path)
            return path, flaws
        except CheckpointError as error:
            flaws.append(str(error))
    return None, flaws


def is_whole(folder: Path) -> bool:
    """True for a checkpoint that can be verified."""
    try:
        verified(folder)
    except CheckpointError:
        return False
    return True


def verified(folder: Path) -> dict[str, Any]:
    """State of a checkpoint whose files have the sums and values that they must have."""
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
        return state
    except OSError as error:
        raise CheckpointError(f"{folder}: is not whole ({error.strerror or error}).") from None
    except ValueError as error:
        raise CheckpointError(f"{folder}: is not whole: {error}") from None


def restore_checkpoint(model: Any, folder: Path) -> dict[str, Any]:
    """Put the state saved in the folder into a freshly built model; returns the progress.

    After a CheckpointError the model holds a part of that state and must not be used.
    """
    state = verified(folder)
    try:
        arrays = read_arrays(folder / ARRAYS)
        parameters = unflattened(state["parameters"], arrays)
        variables = unflattened(state["variables"], arrays)
        model.set_parameters(parameters, device="cpu")
        for name, value in loose_variables(model).items():
            value.data.copy_(variables[name])
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
    """Tensors that belong to no module, such as SAC's entropy coefficient."""
    return {name: getattr(model, name) for name in model._get_torch_save_params()[1]}


def flattened(tree: Any, arrays: dict[str, Any]) -> Any:
    """The tree as JSON, its tensors moved into `arrays` and replaced by their names there.

    Optimizer states have integer keys, which JSON lacks: a table becomes a list of pairs.
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
