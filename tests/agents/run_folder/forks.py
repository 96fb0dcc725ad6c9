"""Forked child processes, which start without imports and can be killed at a chosen call."""

import os
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

TRACEBACK = 70  # exit status of a child that raised an exception
PATIENCE = 120.0  # [s] after which a child is killed


@dataclass(frozen=True)
class Ending:
    """Exit status of a child (negative: the signal's number), and its output and errors."""

    status: int
    output: str
    errors: str


def forked(work: Callable[[], int], folder: Path, kill_after: float = PATIENCE) -> Ending:
    """Run `work` in a child, killed after `kill_after` seconds, with its output in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / "output", folder / "errors"]
    pid = os.fork()
    if pid == 0:
        in_the_child(work, files)
    deadline = time.monotonic() + kill_after
    while os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() > deadline:
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.002)
    _, status = os.waitpid(pid, 0)
    output, errors = (file.read_text(encoding="utf-8", errors="replace") for file in files)
    return Ending(os.waitstatus_to_exitcode(status), output, errors)


def in_the_child(work: Callable[[], int], files: list[Path]) -> None:
    """Run `work` with output and errors in the files, and exit the process."""
    status = TRACEBACK
    try:
        for stream, file in zip((1, 2), files, strict=True):
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
        sys.stdout = os.fdopen(1, "w", buffering=1, closefd=False)
        sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False)
        status = work()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def half_write(descriptor: int, data: bytes) -> None:
    os.write(descriptor, data[: len(data) // 2])


def half_text(path: Path, text: str, **keywords: Any) -> None:
    path.write_bytes(text.encode()[: len(text) // 2])


def half_savez(path: Path, **arrays: Any) -> None:
    whole = path.with_name("half.npz")
    np.savez(whole, **arrays)
    data = whole.read_bytes()
    whole.unlink()
    path.write_bytes(data[: len(data) // 2])


def half_rmtree(path: Path, **keywords: Any) -> None:
    for file in sorted(Path(path).glob("*"))[:1]:
        file.unlink()


# Calls at which to kill: owner, name, number of calls in a short run, and a half-done call.
Place = tuple[Any, str, int, Callable[..., None] | None]
PLACES: tuple[Place, ...] = (
    (os, "write", 8, half_write),
    (os, "fsync", 60, None),
    (os, "rename", 8, None),
    (os, "replace", 5, None),
    (np, "savez", 9, half_savez),
    (Path, "write_text", 20, half_text),
    (shutil, "rmtree", 24, half_rmtree),
)


def place_kill(place: Place, call: int, when: str) -> None:
    """Arrange that this process is killed before, amid or after a given call of a function."""
    owner, name, _, half = place
    function = getattr(owner, name)
    left = [call]

    def patched(*arguments: Any, **keywords: Any) -> Any:
        left[0] -= 1
        if left[0] != 0:
            return function(*arguments, **keywords)
        setattr(owner, name, function)
        if when == "amid" and half is not None:
            half(*arguments, **keywords)
        if when == "after":
            function(*arguments, **keywords)
        os.kill(os.getpid(), signal.SIGKILL)

    setattr(owner, name, patched)
