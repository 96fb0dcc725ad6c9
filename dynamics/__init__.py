"""Dynamics of robot arms with flexible links, in SI units.

An `Arm` describes links, joints and modes. `load_arm` returns one from a preset's name, a file or a
dict. `compile_arm` makes a `Model`, which evaluates the equations of motion and related quantities.
`simulate` integrates a motion, and a `Stepper` steps a batch of arms. This package does not depend
on the environments or on learning.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dynamics.arms import ARMS
from dynamics.description.arm import Arm, Base
from dynamics.description.beams.sections import Section
from dynamics.description.joint import Joint
from dynamics.description.link import Body, Link, Payload
from dynamics.description.mode_rule import RigidLinkWarning
from dynamics.description.mode_shapes import Mode
from dynamics.description.plausibility import ImplausibleArmWarning, ThickLinkWarning
from dynamics.description.urdf.convert import UrdfWarning
from dynamics.description.welds import StiffSegmentsWarning
from dynamics.load import load_arm

if TYPE_CHECKING:
    from dynamics.accuracy.choice import Choice
    from dynamics.accuracy.model_choice import choose_model
    from dynamics.accuracy.scene import JointMotion, Scene
    from dynamics.model import Model, compile_arm
    from dynamics.simulation.simulate import Diverged, simulate
    from dynamics.simulation.stepper import Stepper
    from dynamics.simulation.trajectory import Trajectory
    from dynamics.simulation.validity import limits
    from dynamics.validity import ValidityWarning

__all__ = [
    "ARMS", "Arm", "Base", "Body", "Choice", "Diverged", "ImplausibleArmWarning", "Joint",
    "JointMotion", "Link", "Mode", "Model", "Payload", "RigidLinkWarning", "Scene", "Section",
    "Stepper", "StiffSegmentsWarning", "ThickLinkWarning", "Trajectory", "UrdfWarning",
    "ValidityWarning",
    "choose_model", "compile_arm", "limits", "load_arm", "simulate",
]  # fmt: skip

_LATE = {  # these import numba: only when asked for
    "Model": "model", "compile_arm": "model",
    "Stepper": "simulation.stepper", "Trajectory": "simulation.trajectory",
    "Diverged": "simulation.simulate", "simulate": "simulation.simulate",
    "ValidityWarning": "validity", "limits": "simulation.validity",
    "Choice": "accuracy.choice", "choose_model": "accuracy.model_choice",
    "JointMotion": "accuracy.scene", "Scene": "accuracy.scene",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(import_module(f"dynamics.{_LATE[name]}"), name)
    raise AttributeError(f"module 'dynamics' has no attribute {name!r}")
