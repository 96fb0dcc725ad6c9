"""Motions under torques that change at samples: one compiled call, with derivatives if wanted."""

import numpy as np

from dynamics.backends.numba_llvm.program import sampled
from dynamics.model import Model
from dynamics.types import AnyArray, Array

LANES_ALONG = 8  # of motions with derivatives


def sampled_motion(
    model: Model, steps: Array, substeps: int, torques: AnyArray, state: AnyArray
) -> AnyArray:
    """Coordinates and rates (N, 2n, P) of P motions at the samples after the first.

    Complex arguments carry a direction as imaginary parts; those of the result are its derivatives
    along that direction. A motion that has diverged is not finite from then on.

    Parameters
    ----------
    steps : (N,) [s] integration steps after every sample but the last.
    substeps : integration steps between samples.
    torques : (N, n_torque, P) after every sample but the last.
    state : (2n + n_parameter, P) coordinates, rates and free parameters at the first sample.
    """
    along = np.iscomplexobj(torques) or np.iscomplexobj(state)
    lanes, count = LANES_ALONG if along else model.lanes, state.shape[-1]
    program = model.program(lanes, "rk4", sampled(model.traced), derivatives=along)
    width = -(-count // lanes) * lanes
    given = (*_parts(state, width, along), *_parts(torques, width, along))
    found = [np.empty((len(steps), 2 * model.n, width)) for _ in range(1 + along)]
    program.follow(steps, substeps, model.workspace(program), *given, *found)
    path, *direction = (part[..., :count] for part in found)
    return path + 1j * direction[0] if along else path


def _parts(values: AnyArray, width: int, along: bool) -> list[Array]:
    """Values, and their direction if wanted; the last motion again up to a width."""
    columns = np.minimum(np.arange(width), values.shape[-1] - 1)
    parts = (values.real, values.imag) if along else (values,)
    return [np.ascontiguousarray(part[..., columns]) for part in parts]
