"""Bounds of the package: their torques still reach them in the environment."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.leaderboard.bound import FOLDER, reached, stored
from agents.leaderboard.motions import Episode, plant

FILES = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if "SixLink" in path.stem else [])
    for path in sorted(FOLDER.glob("*.npz"))
]


@pytest.mark.skip(reason="older than the defaults: python -m agents.leaderboard.bound")
@pytest.mark.parametrize("path", FILES)
def test_stored_torques_reach_their_bounds(path: Path) -> None:
    name, track, _ = path.name.split(".")
    env_id = f"FlexArm/{name}"
    batches: dict[int, Any] = {}
    found = stored(env_id, track)
    assert found is not None
    for seed, best, actions in list(zip(found.seeds, found.best, found.actions, strict=True))[:5]:
        episode = Episode(env_id, plant(env_id, track), int(seed), batches)
        motion = episode.follow(actions[None].astype(np.float64))[0]
        assert reached(episode, motion) == pytest.approx(best, rel=1e-3)
