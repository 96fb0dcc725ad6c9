"""Dynamics of robot arms whose links bend; SI units throughout.

An `Arm` describes links, joints and modes; `load_arm` reads one from a preset's name, a file or a
dict; `compile_arm` makes the `Model` that answers questions, `simulate` follows it through time and
a `Stepper` steps many at once. The physics knows nothing of environments or learning.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dynamics.arm import Arm, Base, Joint, Link, Mode, Payload
from dynamics.arm_file import load_arm
from dynamics.arms import ARMS

if TYPE_CHECKING:
    from dynamics.model import Model, compile_arm
    from dynamics.simulation import Diverged, Trajectory, simulate
    from dynamics.stepper import Stepper

__all__ = [
    "ARMS", "Arm", "Base", "Diverged", "Joint", "Link", "Mode", "Model", "Payload", "Stepper",
    "Trajectory", "compile_arm", "load_arm", "simulate",
]  # fmt: skip

_LATE = {  # these import numba: only when asked for
    "Model": "model", "compile_arm": "model", "Stepper": "stepper",
    "Diverged": "simulation", "Trajectory": "simulation", "simulate": "simulation",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(import_module(f"dynamics.{_LATE[name]}"), name)
    raise AttributeError(f"module 'dynamics' has no attribute {name!r}")
