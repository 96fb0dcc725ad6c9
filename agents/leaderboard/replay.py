"""`optimal`: torques of stored bounds, played without feedback.

It is told the seeds of its episodes, which no controller is. It stands beside the others and is not
ranked among them.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from agents.leaderboard.bound import known
from dynamics.types import AnyArray, Array

OPTIMAL = "optimal"


class Replay:
    """Actions of N episodes that start together, step by step, whatever is observed."""

    def __init__(self, actions: Array) -> None:
        self.actions = actions  # (N, T, m) [-]

    def predict(
        self,
        observation: AnyArray,
        state: int | None = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, int]:
        """Actions of the first environments, (n, m) or (m,); the state is the number of steps."""
        step = state or 0
        now = self.actions[:, min(step, self.actions.shape[1] - 1)]
        return (now[: len(observation)] if np.ndim(observation) > 1 else now[0]), step + 1


def replayed(
    env_id: str, track: str, seeds: Sequence[int], folder: Path | None = None
) -> list[int]:
    """Episodes among these that have a bound."""
    bounds = known(env_id, track, folder)
    return [seed for seed in seeds if seed in bounds and np.isfinite(bounds[seed][0])]


def optimal(env_id: str, track: str, seeds: Sequence[int], folder: Path | None = None) -> Replay:
    """Replay of the bounds of episodes; a ValueError if one of them has none."""
    missing = sorted(set(seeds) - set(replayed(env_id, track, seeds, folder)))
    if missing:
        raise ValueError(
            f"{OPTIMAL} has no bound of {env_id} on the track {track!r} for the seeds "
            f"{missing[:5]}; run python -m agents.leaderboard.bound --tasks {env_id} "
            f"--track {track}."
        )
    bounds = known(env_id, track, folder)
    return Replay(np.stack([bounds[seed][1] for seed in seeds]))
