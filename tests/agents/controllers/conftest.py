"""Controllers of masses on springs."""

import pytest

from agents.controllers import nmpc
from agents.controllers.models.linear_model import LinearModels
from agents.controllers.observers import extended, kalman, steps
from tests.agents.controllers import springs


@pytest.fixture
def springs_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The springs' models and steps, and loops in plain Python: nothing is compiled."""
    monkeypatch.setattr(LinearModels, "of", staticmethod(lambda env: env.models))
    for module in (nmpc, extended):
        monkeypatch.setattr(module, "PlantSteppers", springs.Steppers)
    for name in ("_copy", "_move", "_surprise_of"):
        monkeypatch.setattr(steps, name, getattr(steps, name).py_func)
    for module, name in ((kalman, "take"), (kalman, "predict"), (extended, "correct")):
        monkeypatch.setattr(module, name, getattr(steps, name).py_func)
    monkeypatch.setattr(nmpc, "_program", nmpc._program.py_func)
