"""Momentum that a step loses on a floating base, though the tip may stay where it belongs."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dynamics.description.arm import Arm
from flexarm_env.certify.episodes import Episodes, environment

COUNT, STEPS = 32, 40  # episodes, and their control steps


def momentum_error(arm: Arm, keywords: Mapping[str, Any], integrator: str, substeps: int) -> float:
    """Largest drift of the momentum in episodes of held torques from rest.

    It is relative to the largest momentum of the base alone, linear [N s] or about its own axis
    [N m s]. Infinite if an episode diverges; zero for a fixed base, for a torque on the base, and
    for drawn parameters, of which the model's momentum knows nothing.
    """
    core = environment(arm, COUNT, {**keywords, "integrator": integrator, "substeps": substeps})
    if not core.arm.base.n or core.randomize or len(core.torque_limit) > arm.n_joint:
        return 0.0
    drift, largest = np.zeros(2), np.zeros(2)
    base = core.arm.base

    def watch() -> None:
        for q, v in zip(core.q, core.v, strict=True):
            own = base.mass * v[:2], base.inertia[2][2] * v[2:3]
            for sizes, parts in ((drift, core.model.momentum(q, v)), (largest, own)):
                sizes[:] = np.maximum(sizes, [np.linalg.norm(part) for part in parts])

    trace = Episodes.drawn(core, ("held",), COUNT, STEPS).played(core, watch=watch)
    return float("inf") if trace.diverged.any() else float((drift / largest).max())
