"""Input shapers against the residual vibration of their impulses, in closed form."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eig

from agents.controllers import CONTROLLERS
from agents.controllers.shaped import TOLERATED, Impulses, ShapedPD, convolved, ei, zv, zvd
from dynamics.types import Array
from tests.agents.controllers.springs import JOINTS, LIMIT, Environment

Shaper = Callable[[float, float], Impulses]
GAINS: dict[str, Any] = {"frequency_ratio": 0.3, "damping_ratio": 1.0}


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


class Linear:
    """Masses on springs under joint PD, beside the controller that it is made for."""

    def __init__(self, modes: int) -> None:
        self.envs = Environment()
        self.envs.core.control_dt = self.envs.models.control_dt = 0.004
        self.subject = ShapedPD(self.envs, zv, **GAINS, rise=0.02, modes=modes)
        self.model = self.subject.models.at(np.zeros(2))

    def left(self) -> list[float]:
        """Residual vibration per light oscillation, slowest first, 0.8 s after a step."""
        model, pd, size = self.model, self.subject.pd, len(self.model.modes)
        x, state, fresh = np.zeros(2 * size), None, np.ones(1, bool)
        x[:size] = model.modes[:, JOINTS] @ [1e-3, -1e-3]
        for _ in range(200):
            action, state = self.subject.predict(self.observed(x), state, fresh)
            x = model.A @ x + model.B @ (action[0] * LIMIT)
            fresh[:] = False
        joints = model.shapes[JOINTS]
        gain = np.hstack([pd.stiffness[:, None] * joints, pd.damping[:, None] * joints])
        values, left, _ = eig(model.A - model.B @ gain, left=True)
        lightly = values.imag > -3.0 * np.log(np.abs(values))
        turning = [k for k in np.argsort(values.imag) if lightly[k]]
        # without a decay, so that the modes compare
        return [float(abs(left[:, k].conj() @ x) / abs(values[k]) ** 200) for k in turning]

    def observed(self, x: Array) -> Array:
        """(1, size) observation of a linear state."""
        place, rate = (self.model.shapes[JOINTS] @ part for part in np.split(x, 2))
        return self.envs.observed(joint_error=place[None], joint_rate=rate[None])


@pytest.mark.usefixtures("springs_alone")
def test_a_shaper_of_two_oscillations_leaves_both_still() -> None:
    """In a linear simulation; a shaper of one leaves the other, none leaves both."""
    none, one, two = (np.array(Linear(modes).left()) for modes in (0, 1, 2))
    assert len(none) == 2
    assert np.all(two < 0.02 * none)
    assert one[0] < 0.02 * none[0]
    assert one[1] > 0.2 * none[1]
    table = CONTROLLERS["pd-zv-2"].build(Linear(0).envs, **GAINS, rise=1.0)
    assert (table.shaper, table.modes) == (zv, 2)
    table = CONTROLLERS["pd-zvd-2"].build(Linear(0).envs, **GAINS, rise=1.0)
    assert (table.shaper, table.modes) == (zvd, 2)
