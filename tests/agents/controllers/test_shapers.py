"""Input shapers against the residual vibration of their impulses, in closed form."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from agents.controllers.shaped import TOLERATED, Impulses, convolved, ei, zv, zvd

Shaper = Callable[[float, float], Impulses]


def residual(impulses: Impulses, frequency: float, damping: float) -> float:
    """Residual vibration over that of one impulse (Singer and Seering 1990, equation 3)."""
    amplitudes, times = impulses
    decay = frequency * damping
    turn = frequency * math.sqrt(1.0 - damping**2) * times
    grown = amplitudes * np.exp(decay * times)
    last = math.exp(-decay * times[-1])
    return last * math.hypot(float(grown @ np.cos(turn)), float(grown @ np.sin(turn)))


@pytest.mark.parametrize("shaper", [zv, zvd, ei])
@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3])
def test_amplitudes_add_up_to_one(shaper: Shaper, damping: float) -> None:
    amplitudes, times = shaper(7.0, damping)
    assert amplitudes.sum() == pytest.approx(1.0)
    assert times[0] == 0.0
    assert np.all(amplitudes > 0.0)


@pytest.mark.parametrize("shaper", [zv, zvd])
@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3])
def test_zero_vibration_at_the_modelled_frequency(shaper: Shaper, damping: float) -> None:
    assert residual(shaper(7.0, damping), 7.0, damping) < 1e-12


def test_zvd_is_flat_and_ei_is_bounded_about_the_modelled_frequency() -> None:
    near = 7.0 * (1.0 + 1e-4)
    assert residual(zv(7.0, 0.0), near, 0.0) == pytest.approx(0.5e-4 * math.pi, rel=1e-3)
    assert residual(zvd(7.0, 0.0), near, 0.0) < 1e-7
    assert residual(ei(7.0, 0.0), 7.0, 0.0) == pytest.approx(TOLERATED)
    errors = [residual(ei(7.0, 0.0), 7.0 * r, 0.0) for r in np.linspace(0.82, 1.18, 37)]
    assert max(errors) < 1.1 * TOLERATED
    assert min(errors) < 0.1 * TOLERATED


def test_two_shapers_in_a_row_cancel_both_frequencies() -> None:
    both = convolved(zv(7.0, 0.1), zv(20.0, 0.02))
    assert residual(both, 7.0, 0.1) < 1e-12
    assert residual(both, 20.0, 0.02) < 1e-12
