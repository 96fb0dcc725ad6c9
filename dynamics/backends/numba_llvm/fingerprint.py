"""Keys of generated modules: a hash of all that determines their code.

A changed source has another key, so generated code cannot be stale. Only the rooms that generate
code are hashed: editing a question, a case file or a docstring elsewhere recompiles nothing.
"""

import hashlib
import sys
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2]
GENERATING = ("description", "integrators", "formulations", "tracing", "backends", "runtime")


def hash_of_files(paths: Iterable[Path]) -> str:
    """Hash of the contents of files."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def sources(rooms: Iterable[str]) -> list[Path]:
    """Python files of some rooms of the package."""
    return [path for room in rooms for path in (PACKAGE / room).rglob("*.py")]


# as imported: a file edited later does not speak for the code in memory
_SOURCES = hash_of_files(sources(GENERATING))


def fingerprint(*parts: str) -> str:
    """Hash of a description, of the sources that generate code and the versions that compile it."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() + b"\0")
    digest.update(_SOURCES.encode())
    for package in ("numba", "casadi", "numpy"):
        digest.update(version(package).encode())
    digest.update(sys.version.encode())
    return digest.hexdigest()[:20]
