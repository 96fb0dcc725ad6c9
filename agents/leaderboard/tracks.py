"""Tasks of the leaderboard, and conditions ("tracks") under which controllers meet them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from agents.controllers import CONTROLLERS
from flexarm_env import IDS
from flexarm_env.registration import is_harder, registered, without_variant

# a floating arm holds its tip on the target in many postures, of which the classical controllers
# know one
RANKED = tuple(
    env_id
    for env_id in IDS
    if "Goal" not in env_id and "FreeFlyer" not in env_id and not is_harder(env_id)
)
HARDER = tuple(filter(is_harder, IDS))  # with events or a cost: ranked apart


@dataclass(frozen=True, kw_only=True)
class Track:
    """Keywords of the environments on which controllers are ranked."""

    text: str
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    obs: tuple[str, ...] = ("state", "sensors")  # kinds of observation, the preferred first
    design: str  # track for which controllers are tuned and trained
    spread: Mapping[str, Any] | None = None  # keywords with which policies may train for it alone


TRACKS = {
    "state": Track(text="exact states, the arm as described", design="state"),
    "laboratory": Track(
        text='`hardware="laboratory"`: sensors, delay, drawn payload and stiffness',
        kwargs={"hardware": "laboratory"}, obs=("sensors",), design="laboratory",
    ),
    "transfer": Track(
        text=(
            "controllers of `laboratory`, unchanged, and policies trained for it (`-spread`), on a "
            "reference model of the arm with more payload, less stiffness and longer delays than "
            "are drawn there"
        ),
        kwargs={
            "hardware": {
                "preset": "laboratory", "payload": (0.5, 0.75), "stiffness": (0.8, 0.9),
                "delay": (2, 3),
            },
            "fidelity": "reference",
        },
        obs=("sensors",), design="laboratory",
        spread={
            "hardware": {
                "preset": "laboratory", "payload": (0.4, 0.85),
                "stiffness": (0.75, 0.95), "delay": (1, 4),
            },
        },
    ),
    "wide": Track(
        text=(
            "sensors of `laboratory`, and plants so different that one fixed controller fits none: "
            "payload 0 to 200 % of the last link with its tip, stiffness 60 to 140 %"
        ),
        kwargs={
            "hardware": {"preset": "laboratory", "payload": (0.0, 2.0), "stiffness": (0.6, 1.4)}
        },
        obs=("sensors",), design="wide",
    ),
}  # fmt: skip


def designed_for(env_id: str) -> str:
    """Id for which controllers are tuned and trained: of an event or a cost the id without it.

    Refuses ids that are not of this package.
    """
    plain = registered(env_id)
    return without_variant(plain) if is_harder(plain) else plain


def keywords(name: str, track: str) -> dict[str, Any]:
    """Keywords of the environment in which a controller acts on a track."""
    return {**TRACKS[track].kwargs, "obs": _observed(name, track)}


def takes_part(name: str, env_id: str, track: str) -> bool:
    """True if a controller can act on a task and a track."""
    task = IDS[env_id]["kwargs"]["task"]
    return _observed(name, track) is not None and task in CONTROLLERS[name].tasks


def _observed(name: str, track: str) -> str | None:
    """Kind of observation that a controller takes on a track; None if it can use none of them.

    A policy, or a user's class, takes the preferred one.
    """
    kinds = TRACKS[track].obs
    usable = CONTROLLERS[name].obs if name in CONTROLLERS else kinds
    return next((kind for kind in kinds if kind in usable), None)


def track_of(name: str, env_id: str, kwargs: Mapping[str, Any]) -> str | None:
    """Track on which a controller or an algorithm has these keywords, or trains with them."""
    given = _given(kwargs)
    if env_id not in RANKED:
        return None
    return next((x for x in TRACKS if given in (_plain(keywords(name, x)), _spread(x))), None)


def is_spread(env_id: str, kwargs: Mapping[str, Any]) -> bool:
    """True if these keywords serve to train for a track, and are those of none."""
    return env_id in RANKED and _given(kwargs) in map(_spread, TRACKS)


def _given(kwargs: Mapping[str, Any]) -> Any:
    exact = kwargs.get("hardware", "ideal") == "ideal"
    return _plain({"obs": "state" if exact else "sensors", **kwargs})


def _spread(track: str) -> Any:
    spread = TRACKS[track].spread
    return None if spread is None else _plain({**spread, "obs": TRACKS[track].obs[0]})


def _plain(kwargs: Mapping[str, Any]) -> Any:
    """Keywords as a file has them, which knows lists alone."""
    return json.loads(json.dumps(kwargs, default=str))
