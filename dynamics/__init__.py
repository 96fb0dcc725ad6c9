"""Dynamics of robot arms whose links bend; SI units throughout.

An `Arm` describes links, joints and modes; `load_arm` reads one from a preset's name, a file or a
dict; `compile_arm` makes the `Model` that answers questions, `simulate` follows it through time and
a `Stepper` steps many at once. The physics knows nothing of environments or learning.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dynamics.arm import Arm, Base, Body, Joint, Link, Mode, Payload
from dynamics.arm_file import load_arm
from dynamics.arms import ARMS

if TYPE_CHECKING:
    from dynamics.choice import Choice, choose_model
    from dynamics.model import Model, compile_arm
    from dynamics.scene import JointMotion, Scene
    from dynamics.simulation import Diverged, simulate
    from dynamics.stepper import Stepper
    from dynamics.trajectory import Trajectory
    from dynamics.validity import ValidityWarning, limits

__all__ = [
    "ARMS", "Arm", "Base", "Body", "Choice", "Diverged", "Joint", "JointMotion", "Link", "Mode",
    "Model", "Payload", "Scene", "Stepper", "Trajectory", "ValidityWarning", "choose_model",
    "compile_arm", "limits", "load_arm", "simulate",
]  # fmt: skip

_LATE = {  # these import numba: only when asked for
    "Model": "model", "compile_arm": "model", "Stepper": "stepper",
    "Choice": "choice", "choose_model": "choice", "JointMotion": "scene", "Scene": "scene",
    "Diverged": "simulation", "Trajectory": "trajectory", "simulate": "simulation",
    "ValidityWarning": "validity", "limits": "validity",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(import_module(f"dynamics.{_LATE[name]}"), name)
    raise AttributeError(f"module 'dynamics' has no attribute {name!r}")
