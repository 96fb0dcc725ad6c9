"""Arguments of `episode.begin`: what an environment draws at the start of an episode."""

from typing import Any

import numpy as np

from dynamics.description.arm import Arm
from dynamics.types import Array
from flexarm_env.compiled.rows import Rows
from flexarm_env.task.scales import MOVE, Scales
from flexarm_env.task.tasks import base_poses

FIRST = ("q", "v", "centre", "amplitude", "frequency", "phase", "free")  # as in episode.py


def arguments(
    ranges: Array, arm: Arm, scales: Scales, rate_scale: float, drawn: Array, rows: Rows
) -> tuple[Any, ...]:
    """Ranges to draw from, and the rows to write.

    `ranges` are those of the task, `drawn` (n_drawn, 2) those of the rows from "free" on.
    """

    def of_modes(shapes: tuple[tuple[float, ...], ...]) -> Array:
        return np.array(shapes).reshape(len(shapes), len(scales.modal_scale))

    return (
        ranges,
        np.array(scales.home),
        np.array(arm.joint_index, dtype=np.uint64),
        base_poses(arm.base),
        of_modes(scales.vibration),
        of_modes(scales.vibration_rate),
        np.array([MOVE, rate_scale**2 / MOVE]),
        drawn,
        np.array([rows.slices[name].start for name in FIRST], dtype=np.uint64),
    )
