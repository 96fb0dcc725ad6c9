"""Motions free of their integration's error, or the reason why not."""

from typing import Any

import numpy as np
import pytest

from dynamics import ARMS
from dynamics.rollout import SAMPLES, Rollout, Unsettled
from dynamics.scene import bang_bang

ARM, MOTION = ARMS["slim"], bang_bang((0.5,), pulse=0.25, t_end=1.0)
GROWTH = 40.0  # [1/s]


def path(leaving: float) -> np.ndarray:
    """(N, 3) [m] a tip that grows beyond every bound at that time [s]."""
    t = np.linspace(0.0, MOTION.t_end, SAMPLES + 1)
    x = np.exp(np.minimum(GROWTH * (t - leaving), 800.0)) * 2.0 * ARM.reach
    return np.stack([x, 0.0 * t, 0.0 * t], axis=1)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("first", [0.005, 0.4])
def test_steps_that_blow_up_are_refined(monkeypatch: pytest.MonkeyPatch, first: float) -> None:
    """The finer, the later they do, until they do not: no motion diverges like that."""
    steps: list[float] = []

    def tips(self: Rollout, motion: Any, method: str, dt: float) -> np.ndarray:
        steps.append(dt)
        return path(min(first * steps[0] / dt, 3.0 * MOTION.t_end))

    monkeypatch.setattr(Rollout, "tips", tips)
    settled = Rollout(ARM).settled(MOTION, 1e-6)
    np.testing.assert_allclose(settled, path(3.0 * MOTION.t_end), atol=1e-6)


def test_a_motion_that_diverges_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the same time with every step, and after two of them."""
    steps: list[float] = []

    def tips(self: Rollout, motion: Any, method: str, dt: float) -> np.ndarray:
        steps.append(dt)
        return path(0.5 + dt)

    monkeypatch.setattr(Rollout, "tips", tips)
    with pytest.raises(Unsettled, match=r"leaves the reach \(1\.\d+ m\)"):
        Rollout(ARM).settled(MOTION, 1e-6)
    assert len(steps) == 2
