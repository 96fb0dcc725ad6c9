"""Motions between samples, held against the stepper and against their own differences."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Stepper, compile_arm
from dynamics.model import Model
from dynamics.simulation.sampled_motion import SampledMotion
from dynamics.types import AnyArray, Array

COUNT, SAMPLES, SUBSTEPS = 3, 12, 4
FREE = ("stiffness", "damping")
STEPS = 1e-3 * np.linspace(1.0, 2.0, SAMPLES)


@pytest.fixture(scope="module")
def model() -> Model:
    return compile_arm("quanser-rotary-flexible-link", free_parameters=FREE)


def given(model: Model, seed: int, size: float = 1.0) -> tuple[Array, Array]:
    """Torques and states in motion."""
    rng = np.random.default_rng(seed)
    torques = rng.normal(size=(SAMPLES, model.n_torque, COUNT))
    moved = 0.01 * rng.normal(size=(2 * model.n, COUNT))
    free = 0.1 * rng.random((len(FREE), COUNT))
    return size * torques, size * np.vstack([moved, free])


def path(model: Model, torques: AnyArray, state: AnyArray) -> AnyArray:
    return SampledMotion(model)(STEPS, SUBSTEPS, torques, state)


def test_a_sampled_motion_is_that_of_the_stepper(model: Model) -> None:
    torques, state = given(model, 0)
    stepper = Stepper(model, COUNT, dt=1.0, substeps=SUBSTEPS)
    stepper.q[:], stepper.v[:], stepper.parameters[:] = np.split(state.T, [model.n, 2 * model.n], 1)
    expected = []
    for dt, torque in zip(STEPS.tolist(), torques, strict=True):
        stepper.dt, stepper.torque[:] = dt, torque.T
        stepper.advance()
        expected.append(np.vstack([stepper.q.T, stepper.v.T]))
    assert_allclose(path(model, torques, state), expected, rtol=1e-12, atol=1e-12)


def test_imaginary_parts_are_derivatives_along_a_direction(model: Model) -> None:
    """By extrapolated differences."""
    here, along = given(model, 0), given(model, 1, size=0.1)

    def difference(h: float) -> AnyArray:
        ahead, behind = (
            path(model, *(x + s * y for x, y in zip(here, along, strict=True))) for s in (h, -h)
        )
        return (ahead - behind) / (2.0 * h)

    exact = (4.0 * difference(1e-3) - difference(2e-3)) / 3.0
    found = path(model, *(x + 1j * y for x, y in zip(here, along, strict=True)))
    assert_allclose(found.real, path(model, *here), rtol=1e-10, atol=1e-12)
    size = np.abs(exact).max(axis=(0, 2), keepdims=True)
    assert_allclose(found.imag / size, exact / size, atol=1e-8)
