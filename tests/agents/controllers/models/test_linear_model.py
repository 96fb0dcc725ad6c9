"""Plants of the linear models, and the memory for their postures."""

import numpy as np
import pytest

from agents.controllers.models import linear_model
from agents.controllers.models.linear_model import LinearModels
from agents.metrics import make_batch

REACH = "FlexArm/OneLink-Reach-v0"


def test_plants_are_spread_evenly_over_what_is_drawn_and_beyond() -> None:
    """By half of it on both sides, but no mass is negative; the middle is that of what is drawn."""
    envs = make_batch(REACH, 1, {"hardware": "laboratory"})
    models, drawn = LinearModels.of(envs), envs.unwrapped.core.randomize
    masses, factors = models.levels
    low, high = drawn["payload_mass"]
    assert masses == pytest.approx(np.linspace(low, low + 1.5 * (high - low), 10))
    low, high = drawn["stiffness"]
    assert factors == pytest.approx(np.linspace(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low, 5))
    assert [plant.factor for plant in models.plants] == factors * 10
    carried = [plant.model.arm.payload.mass for plant in models.plants]
    assert carried == pytest.approx(np.repeat(masses, 5))
    middle = models.plants[models.middle]
    assert middle.model.arm.payload.mass == pytest.approx(sum(drawn["payload_mass"]) / 2)
    assert middle.factor == pytest.approx(sum(drawn["stiffness"]) / 2)


def test_models_of_old_postures_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long trainings meet a new posture in every episode."""
    monkeypatch.setattr(linear_model, "KEPT", 2)
    core = make_batch("FlexArm/TwoLink-Reach-v0", 1).unwrapped.core
    models = LinearModels(core.arm, core.control_dt, ())
    for angle in range(5):
        models.at(np.array([0.0, float(angle)]))
    assert models._model.cache_info().currsize == 2
