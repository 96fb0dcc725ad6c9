"""Preset arms by name; each file says where its numbers come from."""

from dynamics.arm import Arm
from dynamics.arms import deluca_siciliano, korayem_two_link, six_link, slim

_FILES = (slim, deluca_siciliano, korayem_two_link, six_link)
ARMS: dict[str, Arm] = {file.ARM.name: file.ARM for file in _FILES}
