"""Dynamics of robot arms whose links bend; SI units throughout.

An `Arm` describes links, joints and modes; `load_arm` reads one from a preset's name, a file or a
dict. The physics knows nothing of environments or learning.
"""

from dynamics.arm import Arm, Base, Joint, Link, Mode, Payload
from dynamics.arm_file import load_arm
from dynamics.arms import ARMS

__all__ = ["ARMS", "Arm", "Base", "Joint", "Link", "Mode", "Payload", "load_arm"]
