"""Locks of folders that one process at a time may use."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from agents.files import FolderError
from dynamics.extras import missing

try:
    from filelock import FileLock, Timeout
except ModuleNotFoundError as error:
    raise missing(error, "agents", "train") from None

LOCK = ".lock"  # stays in the folder when the operating system releases the lock


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system releases however the process ends."""
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        if (folder / LOCK).is_symlink():
            raise FolderError(f"{folder / LOCK}: is a link; remove it.")
        lock.acquire()
    except Timeout:
        raise FolderError(
            f"{folder}: is in use by another process; wait for its end or choose another folder."
        ) from None
    except OSError as error:
        raise FolderError(f"{folder}: cannot be locked ({error.strerror}).") from None
    try:
        yield
    finally:
        lock.release()
