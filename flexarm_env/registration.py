"""The registered ids: arms and control steps times tasks."""

import difflib
from typing import Any

import gymnasium as gym

from flexarm_env.tasks import TASKS

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


def register() -> None:
    """Make the ids known to Gymnasium, once."""
    for env_id, spec in IDS.items():
        if env_id not in gym.registry:
            gym.register(
                env_id,
                entry_point="flexarm_env.env:FlexArmEnv",
                vector_entry_point="flexarm_env.vector:FlexArmVectorEnv",
                **spec,
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
