"""Gymnasium environments for robot arms whose links bend.

Importing this package registers FlexArm/{OneLink,TwoLink,SixLink}-{Reach,Track,Damp}-v0;
`gym.make("flexarm_env:FlexArm/OneLink-Reach-v0")` does both at once.
"""

import difflib
from typing import Any

import gymnasium as gym

from flexarm_env.env import FlexArmEnv
from flexarm_env.rewards import REWARDS, TERMS, TipTrackingReward, VibrationSuppressionReward
from flexarm_env.tasks import TASKS
from flexarm_env.vector import FlexArmVectorEnv

__all__ = [
    "IDS",
    "REWARDS",
    "TASKS",
    "TERMS",
    "FlexArmEnv",
    "FlexArmVectorEnv",
    "SB3VecEnv",
    "TipTrackingReward",
    "VibrationSuppressionReward",
    "registered",
]

SCENES: dict[str, tuple[str, float, int]] = {  # preset, control_dt [s], steps per episode
    "OneLink": ("slim", 0.02, 150),
    "TwoLink": ("deluca-siciliano", 0.05, 240),
    "SixLink": ("six-link", 0.02, 150),
}
IDS: dict[str, dict[str, Any]] = {
    f"FlexArm/{scene}-{task}-v0": {
        "kwargs": {"task": task, "arm": arm, "control_dt": control_dt},
        "max_episode_steps": steps,
    }
    for scene, (arm, control_dt, steps) in SCENES.items()
    for task in TASKS
}

for _id, _spec in IDS.items():
    if _id not in gym.registry:
        gym.register(
            _id,
            entry_point="flexarm_env.env:FlexArmEnv",
            vector_entry_point="flexarm_env.vector:FlexArmVectorEnv",
            **_spec,
        )


def registered(env_id: str) -> str:
    """An id of this package, without the prefix `flexarm_env:`; any other is refused.

    For ids that come from a file: Gymnasium would import whatever module stands before the colon.
    """
    plain = env_id.removeprefix("flexarm_env:")
    if plain in IDS:
        return plain
    near = difflib.get_close_matches(plain, IDS, n=1)
    remedy = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(IDS)}."
    raise ValueError(f"{env_id[:80]!r} is not an environment of flexarm; {remedy}")


def __getattr__(name: str) -> Any:
    """`SB3VecEnv` on demand: stable-baselines3 is optional."""
    if name == "SB3VecEnv":
        from flexarm_env.sb3 import SB3VecEnv

        return SB3VecEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
