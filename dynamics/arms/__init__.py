"""Preset arms by name; each file says where its numbers come from."""

from dynamics.arm import Arm
from dynamics.arms import deluca_siciliano, korayem_two_link, puma_600, six_link, slim, stanford

_FILES = (slim, deluca_siciliano, korayem_two_link, six_link, stanford, puma_600)
ARMS: dict[str, Arm] = {file.ARM.name: file.ARM for file in _FILES}
