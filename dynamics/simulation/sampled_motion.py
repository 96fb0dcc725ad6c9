"""Motions under torques that change at samples: one compiled call, with derivatives if wanted."""

from types import ModuleType

import numpy as np

from dynamics.backends.numba_llvm.program import sampled
from dynamics.model import Model
from dynamics.types import AnyArray, Array

LANES_ALONG = 8  # of motions with derivatives


class SampledMotion:
    """Motions of an arm under torques that change at samples.

    Complex arguments carry a direction as imaginary parts; those of the result are its derivatives
    along that direction.
    """

    def __init__(self, model: Model, integrator: str = "rk4") -> None:
        self._model, self._integrator = model, integrator
        self._programs: dict[tuple[int, bool], tuple[ModuleType, Array]] = {}

    def __call__(self, steps: Array, substeps: int, torques: AnyArray, state: AnyArray) -> AnyArray:
        """Coordinates and rates (N, 2n, P) of P motions at the samples after the first.

        A motion that has diverged is not finite from then on.

        Parameters
        ----------
        steps : (N,) [s] integration steps after every sample but the last.
        substeps : integration steps between samples.
        torques : (N, n_torque, P) after every sample but the last.
        state : (2n + n_parameter, P) coordinates, rates and free parameters at the first sample.
        """
        along, count = np.iscomplexobj(torques) or np.iscomplexobj(state), state.shape[-1]
        lanes = LANES_ALONG if along else 1 if count == 1 else self._model.lanes
        program, workspace = self._program(lanes, along)
        width = -(-count // lanes) * lanes
        given = (*_parts(state, width, along), *_parts(torques, width, along))
        found = [np.empty((len(steps), 2 * self._model.n, width)) for _ in range(1 + along)]
        program.follow(steps, substeps, workspace, *given, *found)
        path, *direction = (part[..., :count] for part in found)
        return path + 1j * direction[0] if along else path

    def _program(self, lanes: int, along: bool) -> tuple[ModuleType, Array]:
        """Compiled motions, without or with derivatives, and their workspace."""
        if (lanes, along) not in self._programs:
            model = self._model
            program = model.program(lanes, self._integrator, sampled(model.traced), along)
            self._programs[lanes, along] = program, model.workspace(program)
        return self._programs[lanes, along]


def _parts(values: AnyArray, width: int, along: bool) -> list[Array]:
    """Values, and their direction if wanted; the last motion again up to a width."""
    columns = np.minimum(np.arange(width), values.shape[-1] - 1)
    parts = (values.real, values.imag) if along else (values,)
    return [np.ascontiguousarray(part[..., columns]) for part in parts]
