"""Sag of links in gravity, for many joint angles and free parameters."""

import math

import numpy as np

from dynamics.model import Model
from dynamics.tracing.equilibrium import bent_coordinates, settling
from dynamics.types import AnyArray, Array


class Sag:
    """Sag of an arm on a fixed base: its bend at rest, under gravity that acts on links as bent.

    Complex arguments carry a direction as imaginary parts, and the result its derivative.

    Parameters
    ----------
    shapes : (m, n) natural modes in which links bend, of which none turns a rotor.
    part : (n, n) of the sag that is wanted.
    """

    def __init__(self, model: Model, shapes: Array, part: Array) -> None:
        stiff = shapes @ model.stiffness
        amplitudes = stiff / np.sum(stiff * shapes, axis=1)[:, None]
        self._bent = bent_coordinates(model.arm)
        self._part = (part @ shapes.T @ amplitudes[:, self._bent]).T
        self._step = settling(model.traced)
        self._change = self._step.forward(1)

    def __call__(self, q: AnyArray, parameters: AnyArray) -> AnyArray:
        """(..., n) parts of the sag at coordinates (..., n) and free parameters (..., p)."""
        lead = np.broadcast_shapes(q.shape[:-1], parameters.shape[:-1])
        count = math.prod(lead)
        at = [
            np.broadcast_to(x, (*lead, x.shape[-1])).reshape(count, x.shape[-1]).T
            for x in (q, q[..., self._bent], parameters)
        ]
        here, along = [x.real for x in at], [x.imag for x in at]
        found: AnyArray = np.array(self._step.map(count)(*here))
        if any(x.any() for x in along):
            found = found + 1j * np.array(self._change.map(count)(*here, found, *along))
        part: AnyArray = found[:-1].T @ self._part
        return part.reshape(*lead, -1)
