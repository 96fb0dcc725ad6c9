"""Derivatives of logged motions by the unknowns of a fit, held against differences."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.accuracy.measured_data import GAUGE, PRESET, clean_log, noisy, rig
from dynamics import load_arm
from dynamics.measured.fit import BOUNDS, fit
from dynamics.measured.log_file import Log
from dynamics.measured.motion import LoggedMotion
from dynamics.types import Array

EVERY = BOUNDS | {
    "viscous_1": (0.0, 0.05), "coulomb_1": (0.0, 0.01), "torque_1": (0.5, 2.0),
    "gain_gauge_1": (0.5, 2.0), "gain_encoder_1": (0.5, 2.0), "delay_gauge_1": (0.0, 0.05),
    "delay_encoder_1": (0.0, 0.05), "lag_gauge_1": (0.0, 0.02), "lag_encoder_1": (0.0, 0.02),
}  # fmt: skip
STARTS: dict[str, dict[str, Any]] = {
    "estimated": {}, "rest": {"start": "rest"}, "measured": {"start": "measured", "shooting": 0.1}
}  # fmt: skip


@pytest.fixture(scope="module")
def log() -> Log:
    return noisy(clean_log(rig()), 0)


def differences(
    motion: LoggedMotion, x: Array, samples: int | None = None, width: float = 1e-5
) -> Array:
    """(k, N, c) central differences."""
    moved = np.diag(width * motion.unknowns.size)
    ahead, behind = (motion.signals(x + s * moved, samples) for s in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * width * motion.unknowns.size[:, None, None]))


@pytest.mark.parametrize(("start", "gravity"), [*((x, 0.0) for x in STARTS), ("measured", -4.0)])
def test_slopes_are_derivatives_of_the_signals(start: str, gravity: float, log: Log) -> None:
    """By every unknown, by extrapolated differences."""
    arm = replace(load_arm(PRESET), gravity=(0.0, gravity, 0.0))
    motion = LoggedMotion(arm, log.since(0.5, 1.0), [GAUGE], EVERY, **STARTS[start])
    motion.substeps = 8
    table = motion.unknowns
    share = np.random.default_rng(0).uniform(0.2, 0.4, table.size.size)
    x = np.where(table.asked, table.low, table.nominal) + share * np.minimum(table.size, 1.0)
    found = motion.slopes(x)
    exact = (4.0 * differences(motion, x) - differences(motion, x, width=2e-5)) / 3.0
    size = np.abs(exact).max(axis=(1, 2), keepdims=True)
    assert np.all(size > 0.0)
    assert_allclose(found / size, exact / size, atol=1e-6)


def test_a_fit_by_differences_is_the_same(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameters and intervals, to a thousandth of the interval."""
    exact = fit(PRESET, log, [GAUGE])
    monkeypatch.setattr(LoggedMotion, "slopes", differences)
    rough = fit(PRESET, log, [GAUGE])
    half = np.ptp(exact.intervals, axis=1)[:, None] / 2.0
    assert_allclose(rough.intervals / half, exact.intervals / half, atol=1e-3)
