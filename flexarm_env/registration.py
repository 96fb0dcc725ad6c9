"""Registered environment ids: every scene (arm, control step, episode length) with every task."""

import difflib
from typing import Any

import gymnasium as gym

from flexarm_env.task.tasks import TASKS

SCENES: dict[str, tuple[str, float, int]] = {  # preset, control_dt [s], steps per episode
    "OneLink": ("slim", 0.02, 150),
    "TwoLink": ("two-link", 0.05, 240),
    "SixLink": ("six-link", 0.02, 150),
    "FreeFlyer": ("free-flyer", 0.05, 240),
}
FLOATING = ("FreeFlyer",)  # scenes whose base floats: Reach alone, see `tasks.refuse_floating`
FIXED = tuple(scene for scene in SCENES if scene not in FLOATING)
NAMED = 3  # ids that an error names
AGILE: dict[str, tuple[float, ...]] = {  # [N m] torque limits of Reach, about three times the usual
    "OneLink": (3.0,),
    "TwoLink": (0.39, 0.126),
}
# scene, task and end of an id, and its further keywords: what happens in mid-episode, or costs
HARDER: dict[tuple[str, str, str], dict[str, Any]] = {
    ("OneLink", "Track", "Drop"): {"event": "drop"},
    ("TwoLink", "Reach", "Jump"): {"event": "jump"},
    ("OneLink", "Reach", "Push"): {"event": "push"},
    ("OneLink", "Reach", "Strain"): {"curvature_limit": 0.4},
}
# Return of a solved episode: a little below the mean of tuned LQR on exact states.
THRESHOLDS: dict[str, float] = {
    "OneLink-Reach": 110.0, "OneLink-Track": 145.0, "OneLink-Damp": 95.0,
    "TwoLink-Reach": 175.0, "TwoLink-Track": 225.0, "TwoLink-Damp": 160.0,
    "SixLink-Reach": 95.0, "SixLink-Track": 115.0, "SixLink-Damp": 75.0,
    "OneLink-ReachAgile": 110.0, "TwoLink-ReachAgile": 120.0,
}  # fmt: skip


def _spec(scene: str, task: str, variant: str = "", **keywords: Any) -> dict[str, Any]:
    arm, control_dt, steps = SCENES[scene]
    return {
        "kwargs": {"task": task, "arm": arm, "control_dt": control_dt, **keywords},
        "max_episode_steps": steps,
        "reward_threshold": THRESHOLDS.get(f"{scene}-{task}{variant}"),
    }


IDS: dict[str, dict[str, Any]] = (
    {f"FlexArm/{scene}-{task}-v0": _spec(scene, task) for scene in FIXED for task in TASKS}
    | {
        f"FlexArm/{scene}-ReachAgile-v0": _spec(scene, "Reach", "Agile", torque_limit=limits)
        for scene, limits in AGILE.items()
    }
    | {
        f"FlexArm/{scene}-ReachGoal-v0": _spec(scene, "Reach", "Goal", obs="goal")
        for scene in FIXED
    }
    | {f"FlexArm/{scene}-Reach-v0": _spec(scene, "Reach") for scene in FLOATING}
    | {
        f"FlexArm/{scene}-{task}{end}-v0": _spec(scene, task, end, **keywords)
        for (scene, task, end), keywords in HARDER.items()
    }
)


def register() -> None:
    """Register the ids with Gymnasium, unless they are registered already."""
    for env_id, spec in IDS.items():
        if env_id not in gym.registry:
            gym.register(
                env_id,
                entry_point="flexarm_env.interfaces.env:FlexArmEnv",
                vector_entry_point="flexarm_env.interfaces.vector:FlexArmVectorEnv",
                **spec,
            )


def is_harder(env_id: str) -> bool:
    """True if something happens in mid-episode, or costs."""
    return not {"event", "curvature_limit"}.isdisjoint(IDS[env_id]["kwargs"])


def without_variant(env_id: str) -> str:
    """The id of the same scene and task, without what follows the task."""
    return f"{env_id.partition('-')[0]}-{IDS[env_id]['kwargs']['task']}-v0"


def registered(env_id: str) -> str:
    """Return an id of this package without the prefix `flexarm_env:`; refuse any other id.

    Ids from a file go through here, because Gymnasium imports the module named before a colon.
    """
    plain = env_id.removeprefix("flexarm_env:")
    if plain in IDS:
        return plain
    near = difflib.get_close_matches(plain, IDS, n=1)
    first = ", ".join(list(IDS)[:NAMED])
    others = f"known: {first}, and {len(IDS) - NAMED} more in flexarm_env.IDS."
    remedy = f"did you mean {near[0]!r}?" if near else others
    raise ValueError(f"{env_id[:80]!r} is not an environment of flexarm; {remedy}")
