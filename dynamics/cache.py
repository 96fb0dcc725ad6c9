"""User's cache of generated sources, compiled code and chosen models.

Code from the cache runs with the user's rights, so the folder must be private, and a file is used
only if the digest in its last line matches its content. Damaged files are rebuilt. Without a usable
folder every process rebuilds its files: slower, with one warning, but with the same results.
"""

import hashlib
import os
import stat
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import platformdirs

_MARK = b"\n# sha256 "  # starts the last line of every file; a comment in Python sources
_warned: set[tuple[str, Path]] = set()


class CacheWarning(UserWarning):
    """Warning that the cache folder or a file in it cannot be used and is ignored."""


def cache_folder() -> Path:
    """Path of the cache; the environment variable FLEXARM_CACHE overrides it.

    A user without a home has a folder among the temporary ones.
    """
    if given := os.environ.get("FLEXARM_CACHE"):
        return Path(given)
    try:
        return platformdirs.user_cache_path("flexarm")
    except RuntimeError:  # a user without a home, as containers have
        return Path(tempfile.gettempdir(), f"flexarm-{os.getuid()}")


def kept(name: str, build: Callable[[], str]) -> str:
    """Return the text of a cached file; call `build` and store its result if there is none."""
    known = load(name)
    if known is not None:
        return known.decode()
    text = build()
    store(name, text.encode())
    return text


def load(name: str) -> bytes | None:
    """Return the content of a cached file; None if it is missing or damaged."""
    folder = cache_folder()
    if not _is_trusted(folder):
        return None
    try:
        data = (folder / name).read_bytes()
    except OSError:
        return None
    content, mark, digest = data.rpartition(_MARK)
    if mark and digest == _digest(content):
        return content
    report_damage(name)
    return None


def store(name: str, content: bytes) -> None:
    """Write a file to the cache atomically; warn if that is not possible."""
    folder = cache_folder()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        if not _is_trusted(folder):
            return
        handle, temporary = tempfile.mkstemp(dir=folder, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content + _MARK + _digest(content))
            os.replace(temporary, folder / name)
        finally:
            Path(temporary).unlink(missing_ok=True)
    except OSError as error:
        _warn("unusable", folder, f"cannot keep files ({error.strerror or error})")


def report_damage(name: str) -> None:
    """Warn, once per process and folder, that a damaged file is rebuilt."""
    folder = cache_folder()
    if ("damaged", folder) not in _warned:
        _warned.add(("damaged", folder))
        warnings.warn(
            f"{folder / name} is damaged and is made anew, as are others like it.",
            CacheWarning,
            stacklevel=3,
        )


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _is_trusted(folder: Path) -> bool:
    """True if only this user and root can change files in the folder."""
    try:
        fault = _fault(folder)
    except OSError:  # it does not exist, or part of its path is not a folder
        return False
    if fault:
        _warn("untrusted", folder, fault)
    return not fault


def _fault(folder: Path) -> str:
    """Reason why the folder is not private, or an empty string."""
    if not hasattr(os, "geteuid"):  # Windows: folders of a profile are private by inheritance
        return ""
    status = folder.stat()
    if status.st_uid != os.geteuid():
        return f"belongs to another user (id {status.st_uid})"
    if stat.S_IMODE(status.st_mode) & (stat.S_IWGRP | stat.S_IWOTH):
        return "can be written by other users"
    for parent in folder.resolve().parents:
        mode = parent.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return f"lies in {parent}, which every user can write"
    return ""


def _warn(kind: str, folder: Path, reason: str) -> None:
    if (kind, folder) in _warned:
        return
    _warned.add((kind, folder))
    warnings.warn(
        f"The cache folder {folder} {reason}, so every process compiles its arms anew; set "
        "FLEXARM_CACHE to a folder that only you can write.",
        CacheWarning,
        stacklevel=4,
    )
