"""Torques that a target's path will need, by what has been observed of it.

Where the target moves, observations hold it half a move time ahead and one move time ahead. What
they showed since then fills the path between; at the start, two angles are all that is known of it.
"""

from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from agents.controllers.models.linear_model import LinearModels
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import Course, torques
from dynamics.types import AnyArray, Array


class Preview:
    """Torques of references at times (K,) [s] from now."""

    def __init__(self, env: Any, models: LinearModels, times: Array) -> None:
        self.read, self.models, self.times = Reading.of(env), models, times
        self.half = 0.5 * env.unwrapped.core.move_time
        useful = times.size and "target_near" in self.read
        self._kept = max(1, int(self.half / models.control_dt)) if useful else 0

    def see(self, x: AnyArray, course: Course, before: Array | None, fresh: AnyArray) -> Array:
        """(N, L, 2, m) [rad] ways of the target half a move time and one ahead, latest first."""
        seen = np.full((len(x), self._kept, 2, course.way.shape[1]), np.nan)
        if self._kept:
            for k, name in enumerate(("target_near", "target_far")):
                seen[:, 0, k] = course.way + self.read(x, name)
            if before is not None:
                seen[~fresh, 1:] = before[~fresh, :-1]
        return seen

    def torques(self, course: Course, seen: Array, i: int, plant: int) -> Array:
        """(K, m) [N m] of a plant in episode i; beyond what is seen the target goes on evenly."""
        if not self._kept:
            return np.zeros((len(self.times), course.way.shape[1]))
        path = self._path(course, seen, i)
        shown = np.minimum(self.times, path.x[-1])
        rate, acceleration = path(shown, 1), path(shown, 2)  # which is zero at the end
        way = path(shown) + (self.times - shown)[:, None] * rate
        posture = np.tile(course.posture[i], (len(shown), 1))
        coming = Course(posture, way, rate, acceleration, acceleration)
        return torques(self.models, coming, plant)

    def _path(self, course: Course, seen: Array, i: int) -> CubicSpline:
        """Way of the target from now on."""
        age = self.models.control_dt * np.arange(self._kept)
        times = np.concatenate([[0.0], self.half - age, 2.0 * self.half - age])
        ways = np.concatenate([course.way[i][None], seen[i, :, 0], seen[i, :, 1]])
        known = np.flatnonzero(np.isfinite(ways[:, 0]))
        known = known[np.argsort(times[known])]
        ends = (1, course.rate[i]), (2, np.zeros_like(course.rate[i]))
        return CubicSpline(times[known], ways[known], bc_type=ends)
