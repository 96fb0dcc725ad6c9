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

    def torques(self, course: Course, seen: Array, plants: AnyArray) -> Array:
        """(N, K, m) [N m] of the plants (N,); beyond what is seen the target goes on evenly."""
        found = np.zeros((len(plants), len(self.times), course.way.shape[1]))
        if not self._kept:
            return found
        _, alike = np.unique(np.isfinite(seen[..., 0]), axis=0, return_inverse=True)
        for k in range(alike.max() + 1):
            group = np.flatnonzero(alike == k)
            path = self._path(course, seen, group)
            shown = np.minimum(self.times, path.x[-1])
            rate, acceleration = path(shown, 1), path(shown, 2)  # which is zero at the end
            way = path(shown) + (self.times - shown)[:, None, None] * rate
            posture = np.broadcast_to(course.posture[group], way.shape)
            for plant in np.unique(plants[group]):
                these = plants[group] == plant
                coming = Course(*(
                    x[:, these].reshape(-1, x.shape[2])
                    for x in (posture, way, rate, acceleration, acceleration)
                ))  # fmt: skip
                needed = torques(self.models, coming, int(plant))
                needed = needed.reshape(len(self.times), -1, way.shape[2])
                found[group[these]] = needed.swapaxes(0, 1)
        return found

    def _path(self, course: Course, seen: Array, group: AnyArray) -> CubicSpline:
        """Ways (G, m) of the targets of episodes (G,) that have seen as much, from now on."""
        age = self.models.control_dt * np.arange(self._kept)
        times = np.concatenate([[0.0], self.half - age, 2.0 * self.half - age])
        now, near, far = course.way[group][:, None], seen[group, :, 0], seen[group, :, 1]
        ways = np.concatenate([now, near, far], axis=1).swapaxes(0, 1)
        known = np.flatnonzero(np.isfinite(ways[:, 0, 0]))
        known = known[np.argsort(times[known])]
        rate = course.rate[group]
        ends = (1, rate), (2, np.zeros_like(rate))
        return CubicSpline(times[known], ways[known], bc_type=ends)
