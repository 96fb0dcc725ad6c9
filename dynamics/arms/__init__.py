"""Preset arms by name. Every file in `presets` defines an ARM with its sources and CHECKS.

To add a preset, add a file named after the arm. Files are imported on first access.
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


class _PresetAttribute(Mapping[str, Any]):
    """Read-only mapping from an arm's name to one attribute of its preset file."""

    def __init__(self, attribute: str) -> None:
        self._attribute = attribute

    def __getitem__(self, name: str) -> Any:
        return getattr(import_module(_FILES[name]), self._attribute)

    def __iter__(self) -> Iterator[str]:
        return iter(_FILES)

    def __len__(self) -> int:
        return len(_FILES)

    def __repr__(self) -> str:
        return repr(dict(self))


ARMS: Mapping[str, Arm] = _PresetAttribute("ARM")
CHECKS: Mapping[str, tuple[Check, ...]] = _PresetAttribute("CHECKS")
