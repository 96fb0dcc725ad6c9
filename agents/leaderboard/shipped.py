"""Trained policies that come with the package: agents/policies/TASK/TRACK/ALGORITHM/seedN."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from agents.leaderboard.tracks import designed_for
from agents.policy import Policy, load_policy, save_policy

FOLDER = Path(__file__).parents[1] / "policies"
LINKS = {"residual": "on", "advised": "advised-by", "alone": "watching", "reference": "ahead-of"}
LINKS |= {"distilled": "of"}


def name_of(policy: Policy) -> str:
    """Algorithm of a policy, with its base, and "-stacked"."""
    about = policy.about
    base = about.get("base", about.get("expert"))
    return ranked_as(about.get("algorithm", "policy"), base, policy.stack)


def ranked_as(algorithm: str, base: Mapping[str, Any] | None, stack: int) -> str:
    """Algorithm with the base on which the policy acts, such as "-on-lqg", and "-stacked"."""
    return algorithm + on_base(base) + "-stacked" * (stack > 1)


def on_base(base: Mapping[str, Any] | None) -> str:
    """Part of a name that tells the base of a policy; empty without one."""
    return "" if base is None else f"-{LINKS[base['learned']]}-{base['controller']}"


def place(env_id: str, track: str) -> Path:
    """Folder of a task's policies for a track."""
    return FOLDER / env_id.split("/")[1] / track


def ship(policy: Policy, env_id: str, track: str) -> None:
    """Store a policy among those of the package."""
    seed = policy.about.get("seed", 0)
    save_policy(policy, place(env_id, track) / name_of(policy) / f"seed{seed}")


@cache
def shipped(env_id: str, track: str) -> dict[str, list[Policy]]:
    """Policies of a task and track: one per training seed, by name."""
    found: dict[str, list[Policy]] = {}
    for folder in sorted(place(designed_for(env_id), track).glob("*/seed*")):
        found.setdefault(folder.parent.name, []).append(load_policy(folder))
    return found
