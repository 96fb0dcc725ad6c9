"""Gymnasium environments for robot arms with flexible links.

Importing this package registers FlexArm/{OneLink,TwoLink,SixLink}-{Reach,Track,Damp}-v0,
FlexArm/FreeFlyer-Reach-v0 and the variants in `IDS`;
`gym.make("flexarm_env:FlexArm/OneLink-Reach-v0")` does both at once.
"""

from pathlib import Path
from typing import Any

import dynamics

if Path(dynamics.__file__).resolve().parents[1] != Path(__file__).resolve().parents[1]:
    raise ImportError(
        f"{dynamics.__file__} hides flexarm's package 'dynamics'; rename it, or run from another "
        "folder."
    )

from dynamics.description.arm import Arm
from dynamics.extras import missing
from flexarm_env.accuracy.certificates import choose_by
from flexarm_env.interfaces.env import FlexArmEnv
from flexarm_env.interfaces.vector import FlexArmVectorEnv
from flexarm_env.plant import GravityWarning
from flexarm_env.registration import IDS, register, registered
from flexarm_env.task.rewards import REWARDS, TERMS, TipTrackingReward, VibrationSuppressionReward
from flexarm_env.task.tasks import TASKS

__all__ = [
    "IDS",
    "REWARDS",
    "TASKS",
    "TERMS",
    "FlexArmEnv",
    "FlexArmVectorEnv",
    "GravityWarning",
    "SB3VecEnv",
    "TipTrackingReward",
    "TorchVecEnv",
    "VibrationSuppressionReward",
    "registered",
]

register()


def _choose(arm: Arm, control_dt: float, tolerance: float) -> dict[str, Any]:
    """Import the search for a model where it is made."""
    from flexarm_env.certify import choice

    return choice.chosen(arm, control_dt, tolerance)


choose_by(_choose)


def __getattr__(name: str) -> Any:
    """Import `SB3VecEnv` and `TorchVecEnv` on first use: what they need is optional."""
    if name == "SB3VecEnv":
        from flexarm_env.interfaces.sb3 import SB3VecEnv

        return SB3VecEnv
    if name == "TorchVecEnv":
        try:
            from flexarm_env.interfaces.tensors.vec_env import TorchVecEnv
        except ModuleNotFoundError as error:
            raise missing(error, name, "train") from None

        return TorchVecEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
