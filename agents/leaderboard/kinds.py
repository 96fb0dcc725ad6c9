"""Kind of a ranked controller, by what it needs while it acts, and its base."""

from collections.abc import Mapping
from typing import Any

from agents.controllers import CONTROLLERS
from agents.leaderboard.shipped import policies_of

CLASSICAL, ON_MODEL, LEARNED = KINDS = ("classical", "learned-on-model", "learned")


def needs(name: str, env_id: str, track: str) -> dict[str, str | None]:
    """Kind and base of a controller on a task and track, both null for what is none of ours."""
    if name in CONTROLLERS:
        return {"kind": CLASSICAL, "base": None}
    policies = policies_of(env_id, track).get(name)
    return described(policies[0].about) if policies else {"kind": None, "base": None}


def described(about: Mapping[str, Any]) -> dict[str, str | None]:
    """Kind and base of a policy, from its description.

    A policy acts on a model where its base computes with one: to act, or to estimate what the
    policy sees.
    """
    base = about["base"]["controller"] if "base" in about else None
    return {"kind": ON_MODEL if base and CONTROLLERS[base].model else LEARNED, "base": base}
