"""Parameters that `python -m agents.tune` has found, in agents/tuned.json.

The file has id -> track -> name of a controller -> parameters, score, trials and episodes.
"""

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from agents.controllers import CONTROLLERS
from agents.files import atomic_write
from agents.leaderboard.tracks import TRACKS, designed_for
from agents.sentences import one_line
from dynamics.description import validate

STORE = Path(__file__).with_name("tuned.json")


@lru_cache(maxsize=1)
def tuned() -> dict[str, Any]:
    """Contents of tuned.json."""
    return read(STORE)


def is_tuned(name: str, env_id: str, track: str) -> bool:
    """True if a controller has nothing to tune, or its parameters are stored."""
    stored = _stored(env_id, track)
    return not CONTROLLERS[name].ranges or name in stored


def parameters_of(name: str, env_id: str, track: str) -> dict[str, float]:
    """Copy of a controller's stored parameters; a ValueError if it was not tuned there."""
    found = _stored(env_id, track).get(name)
    if found is None:
        raise ValueError(
            f"{name} was not tuned for {env_id} on the track {track!r}; name other --tracks, or "
            f"run python -m agents.tune --tasks {designed_for(env_id)} "
            f"--tracks {TRACKS[track].design} --controllers {name}."
        )
    return dict(found["parameters"])


def _stored(env_id: str, track: str) -> Mapping[str, Any]:
    """Results of the conditions for which controllers are designed, by name."""
    found: Mapping[str, Any] = tuned().get(designed_for(env_id), {})
    return found.get(TRACKS[validate.known(track, "track", TRACKS)].design, {})


def read(path: Path) -> dict[str, Any]:
    """Contents of a file of results, empty if there is none; a ValueError if it has none."""
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: has no results of agents.tune ({one_line(error)}).") from None
    if not isinstance(found, dict):
        raise ValueError(f"{path}: must be a table by task, got {validate.shown(found)}.")
    return found


def store(path: Path, env_id: str, track: str, name: str, found: Mapping[str, Any]) -> None:
    """Add one result to the file, whatever it has by now."""
    data = read(path)
    data.setdefault(env_id, {}).setdefault(track, {})[name] = dict(found)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")
