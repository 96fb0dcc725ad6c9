"""Checkpoints of a run as arrays plus JSON: written atomically, read without unpickling."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

KEPT = 2  # newest checkpoints that stay on disk
REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class CheckpointError(ValueError):
    """A checkpoint that cannot be used; the message is one sentence for the user."""


def save_checkpoint(model: Any, folder: Path, progress: dict[str, Any]) -> Path:
    """Write the model's complete state below the folder; a kill leaves the previous one whole.

    Everything goes to a temporary folder first, reaches the disk, and appears under its final
    name in one rename.
    """
    folder.mkdir(parents=True, exist_ok=True)
    final = folder / f"step_{model.num_timesteps:012d}"
    if final.exists():
        return final
    for leftover in folder.glob(".partial_*"):  # of a process that was killed while writing
        shutil.rmtree(leftover)
    temporary = folder / f".partial_{os.getpid()}"
    temporary.mkdir()
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
    np.savez(temporary / "arrays.npz", **arrays)
    (temporary / "state.json").write_text(json.dumps(state), encoding="utf-8")
    for file in temporary.iterdir():
        with open(file, "rb") as handle:
            os.fsync(handle.fileno())
    os.rename(temporary, final)
    for old in list_checkpoints(folder)[:-KEPT]:
        shutil.rmtree(old)
    return final


def list_checkpoints(folder: Path) -> list[Path]:
    """Complete checkpoints, oldest first."""
    return sorted(folder.glob("step_*"))


def restore_checkpoint(model: Any, folder: Path) -> dict[str, Any]:
    """Put the state saved in the folder into a freshly built model; returns the progress."""
    try:
        state = json.loads((folder / "state.json").read_text(encoding="utf-8"))
        with np.load(folder / "arrays.npz", allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        model.set_parameters(unflattened(state["parameters"], arrays), device="cpu")
        for name, value in unflattened(state["variables"], arrays).items():
            getattr(model, name).data.copy_(value)
        model.num_timesteps = state["num_timesteps"]
        model._n_updates = state["n_updates"]
        if "replay" in state:
            buffer = model.replay_buffer
            for name in REPLAY:
                rows = arrays[f"replay/{name}"]
                getattr(buffer, name)[: len(rows)] = rows
            buffer.pos, buffer.full = state["replay"]["pos"], state["replay"]["full"]
        return dict(state["progress"])
    except (OSError, KeyError, ValueError, AttributeError, RuntimeError) as error:
        raise CheckpointError(f"{folder}: does not fit this run ({error}).") from None


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
