"""Preset arms by name: every file beside this one holds an ARM, its sources and its CHECKS.

A new file is found without a second place to edit.
"""

from importlib import import_module
from pkgutil import iter_modules

from dynamics.arm import Arm
from dynamics.published import Check

_FILES = [import_module(f"{__name__}.{file.name}") for file in iter_modules(__path__)]
ARMS: dict[str, Arm] = {file.ARM.name: file.ARM for file in _FILES}
CHECKS: dict[str, tuple[Check, ...]] = {file.ARM.name: file.CHECKS for file in _FILES}
