"""Control steps of the nonlinear arm with the plants that controllers expect."""

from functools import lru_cache, partial
from typing import Any

import numpy as np

from agents.controllers.models.linear_model import LinearModels
from dynamics import Stepper, compile_arm

LEAST, MANY = 8, 256  # rows of a batch; from so many on batches grow by that number
FREE = {"payload_mass": "payload", "stiffness": "factor"}  # parameters of the arm, those of a plant


class PlantSteppers:
    """Compiled control steps of the nonlinear arm with the payload and stiffness of each plant.

    They take `substeps` integration steps, by default as many as the environment.
    """

    def __init__(self, core: Any, models: LinearModels, substeps: int | None = None) -> None:
        model = compile_arm(core.arm, free_parameters=tuple(core.randomize))
        self.parameters = np.tile(model.nominal_parameters, (len(models.plants), 1))
        for column, name in enumerate(model.free_parameters):
            if name in FREE:
                self.parameters[:, column] = [getattr(x, FREE[name]) for x in models.plants]
        count = substeps or core.substeps
        dt = core.dt * core.substeps / count
        self._stepper = lru_cache(
            partial(Stepper, model, dt=dt, substeps=count, integrator=core.integrator)
        )

    def __call__(self, rows: int) -> Stepper:
        """A batch of so many rows or a few more, so that few sizes serve all."""
        doubled = max(LEAST, 1 << (rows - 1).bit_length())
        return self._stepper(doubled if rows <= MANY else -(-rows // MANY) * MANY)
