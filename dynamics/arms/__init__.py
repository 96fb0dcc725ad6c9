"""Preset arms by name: every file in `presets` holds an ARM, its sources and its CHECKS.

A new file, named as its arm, is found without a second place to edit, and read when asked for.
"""

from collections.abc import Iterator, Mapping
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from dynamics.arms import presets
from dynamics.arms.checks import Check
from dynamics.description.arm import Arm

_FILES = {
    file.name.replace("_", "-"): f"{presets.__name__}.{file.name}"
    for file in iter_modules(presets.__path__)
}


class _Each(Mapping[str, Any]):
    """One thing of every file, by the arm's name."""

    def __init__(self, thing: str) -> None:
        self._thing = thing

    def __getitem__(self, name: str) -> Any:
        return getattr(import_module(_FILES[name]), self._thing)

    def __iter__(self) -> Iterator[str]:
        return iter(_FILES)

    def __len__(self) -> int:
        return len(_FILES)

    def __repr__(self) -> str:
        return repr(dict(self))


ARMS: Mapping[str, Arm] = _Each("ARM")
CHECKS: Mapping[str, tuple[Check, ...]] = _Each("CHECKS")
