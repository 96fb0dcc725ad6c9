"""Preset arms by name; each file says where its numbers come from."""

from dynamics.arm import Arm

_PRESETS: tuple[Arm, ...] = ()
ARMS: dict[str, Arm] = {arm.name: arm for arm in _PRESETS}
