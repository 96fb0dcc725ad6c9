"""Atomic file writes, strict JSON, packed texts, and checks of folders to write to."""

import bz2
import hashlib
import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS = re.compile(r'\[\n([^][{}"]*)\n *\]')  # a list without lists, objects and texts


class FolderError(ValueError):
    """A folder that cannot be used; the message is one sentence for the user."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path; on success it is renamed to `path`, otherwise it is removed.

    The temporary name depends only on `path`, so a later write replaces the leftover of a kill.
    """
    temporary = path.with_name(f".partial_{path.name}")
    temporary.unlink(missing_ok=True)
    try:
        yield temporary
        sync(temporary)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def without_infinities(value: Any) -> Any:
    """A copy of the tree with None for every infinity and NaN, as strict JSON requires."""
    if isinstance(value, Mapping):
        return {str(k): without_infinities(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [without_infinities(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def shortened(value: Any, digits: int) -> Any:
    """A copy of the JSON tree whose floats have so many significant digits."""
    return json.loads(
        json.dumps(value), parse_float=lambda text: float(f"{float(text):.{digits}g}")
    )


def write_json(path: Path, data: Any) -> None:
    """Write strict JSON, without NaN and Infinity; a list of numbers is one line."""
    text = json.dumps(without_infinities(data), indent=1, allow_nan=False)
    text = NUMBERS.sub(lambda found: f"[{' '.join(found[1].split())}]", text)
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk; Windows needs no flush of folders."""
    folder = path.is_dir()
    if folder and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def pack(text: str, path: Path) -> None:
    """Write a long text compressed."""
    path.write_bytes(bz2.compress(text.encode()))


def unpacked(path: Path) -> str:
    """Text of a file that `pack` wrote."""
    return bz2.decompress(path.read_bytes()).decode()


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_folder(folder: Path, option: str = "--out") -> None:
    """Refuse the folder of an option that cannot be created or written to, without creating it."""
    try:
        places = (folder, *folder.absolute().parents)
        existing = next(p for p in places if p.exists() or p.is_symlink())
        possible = existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)
    except OSError as error:
        raise FolderError(f"{folder}: cannot be examined ({error.strerror}).") from None
    if not possible:
        raise FolderError(
            f"{folder}: cannot be written to, because {existing} is not a writable folder; choose "
            f"another {option}."
        )
