"""Files that are written whole or not at all, and folders in which one process works at a time."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

LOCK = ".lock"  # stays in the folder; only the system knows whether a process holds it


class FolderError(ValueError):
    """A folder that cannot be worked in; the message is one sentence for the user."""


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A name to write under; the file takes the name `path` in one rename, or leaves no trace.

    The first name is always the same, so the next writer replaces what a killed one has left.
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


def sync(path: Path) -> None:
    """Bring a file, or the names in a folder, to the disk; Windows does the latter by itself."""
    folder = path.is_dir()
    if folder and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or written to, and make nothing."""
    try:
        standing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
        possible = standing.is_dir() and os.access(standing, os.W_OK | os.X_OK)
    except OSError as error:
        raise FolderError(f"{folder}: cannot be looked at ({error.strerror}).") from None
    if not possible:
        raise FolderError(
            f"{folder}: cannot be written to, because {standing} is no folder that you may write "
            "to; choose another --out."
        )


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system frees however the process ends."""
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        if (folder / LOCK).is_symlink():
            raise FolderError(f"{folder / LOCK}: is a link; remove it.")
        lock.acquire()
    except Timeout:
        raise FolderError(
            f"{folder}: another process is at work in it; wait for its end or choose another "
            "folder."
        ) from None
    except OSError as error:
        raise FolderError(f"{folder}: cannot be locked ({error.strerror}).") from None
    try:
        yield
    finally:
        lock.release()
