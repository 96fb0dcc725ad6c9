"""Control steps of the nonlinear arm with the plants that controllers expect."""

from functools import lru_cache, partial
from typing import Any

import numpy as np

from agents.controllers.models.linear_model import LinearModels, usual
from dynamics import Stepper, compile_arm
from dynamics.simulation.sampled_motion import SampledMotion
from dynamics.types import AnyArray, Array

LEAST, MANY = 8, 256  # rows of a batch; from so many on batches grow by that number
FREE = {"payload_mass": "payload", "stiffness": "factor"}  # parameters of the arm, those of a plant


class PlantSteppers:
    """Compiled control steps of the nonlinear arm with the payload and stiffness of each plant.

    They take `substeps` integration steps, by default as many as the environment.
    """

    def __init__(self, core: Any, models: LinearModels, substeps: int | None = None) -> None:
        model = compile_arm(core.arm, free_parameters=tuple(core.randomize))
        self.parameters = np.tile(model.nominal_parameters, (len(models.plants), 1))
        middles = usual(core.randomize)
        for column, name in enumerate(model.free_parameters):
            if name in middles:
                self.parameters[:, column] = middles[name]
            elif name in FREE:
                self.parameters[:, column] = [getattr(x, FREE[name]) for x in models.plants]
        self._follow = SampledMotion(model, core.integrator)
        self._substeps = substeps or core.substeps
        self._dt = core.dt * core.substeps / self._substeps
        self._stepper = lru_cache(
            partial(
                Stepper, model, dt=self._dt, substeps=self._substeps, integrator=core.integrator
            )
        )

    def __call__(self, rows: int) -> Stepper:
        """A batch of so many rows or a few more, so that few sizes serve all."""
        doubled = max(LEAST, 1 << (rows - 1).bit_length())
        return self._stepper(doubled if rows <= MANY else -(-rows // MANY) * MANY)

    def motions(self, plants: AnyArray, state: Array, torques: Array) -> Array:
        """Coordinates and rates (T, 2n, P) of P plants after every control step.

        Parameters
        ----------
        state : (2n, P) before the first.
        torques : (T, m, P) [N m] of every step.
        """
        steps, free = np.full(len(torques), self._dt), self.parameters[plants].T
        return self._follow(steps, self._substeps, torques, np.vstack([state, free]))
