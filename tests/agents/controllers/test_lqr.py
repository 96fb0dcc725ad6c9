"""Cost of the linear quadratic regulator, in torques over their limits and tips over the band."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.controllers.lqr import JOINTS, Cost
from dynamics.types import Array
from flexarm_env.task.tasks import SETTLED_BAND

REACH, MOVE_TIME, LIMIT, MODES = 2.0, 0.7, np.array([3.0, 0.5]), 4
EFFORT, LEAD = 0.2, 0.3


def test_a_cost_is_that_of_the_tip_the_joints_and_the_shares_of_torque() -> None:
    """Rates count as the way within the lead."""
    rng = np.random.default_rng(0)
    core = SimpleNamespace(move_time=MOVE_TIME)
    base = SimpleNamespace(reach=REACH, torque_limit=LIMIT.tolist(), core=core)
    models: Any = SimpleNamespace(joints=[0, 3])
    model: Any = SimpleNamespace(
        modes=np.zeros((MODES, 6)),
        tip=rng.normal(size=(3, MODES)),
        shapes=rng.normal(size=(6, MODES)),
    )
    Q, R = Cost(SimpleNamespace(unwrapped=base), models, effort=EFFORT, lead=LEAD).of(model)

    def place(y: Array) -> float:
        tip, joints = model.tip @ y / REACH, JOINTS * model.shapes[models.joints] @ y
        return float(tip @ tip + joints @ joints) / SETTLED_BAND**2

    x, share = rng.normal(size=2 * MODES), rng.uniform(-1.0, 1.0, 2)
    expected = place(x[:MODES]) + place(LEAD * MOVE_TIME * x[MODES:])
    assert x @ Q @ x == pytest.approx(expected, rel=1e-12)
    assert (share * LIMIT) @ R @ (share * LIMIT) == pytest.approx(EFFORT * share @ share, rel=1e-12)
