"""Limits of errors, and when a curve leaves them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexarm_env.certify.certificate import _until
from flexarm_env.certify.search import Limits


@pytest.mark.parametrize(
    ("share", "curve", "kept"), [(0.9, 0.9, True), (1.1, 0.9, False), (0.9, 1.1, False)]
)
def test_errors_stay_within_limits_of_the_reach(share: float, curve: float, kept: bool) -> None:
    """Limits are of the reach, errors in metres; one kind or instant beyond them is enough."""
    limits: Any = Limits.__new__(Limits)
    limits.reach, limits.share, limits.curve = 0.5, {"a": 0.02}, {"b": np.array([0.01, 0.04])}
    found: Any = SimpleNamespace(
        share={"a": 0.01 * share}.get, curve={"b": np.array([0.001, 0.02 * curve])}.get
    )
    assert limits.keep(found) is kept


def test_a_curve_leaves_its_level_after_the_first_step_beyond() -> None:
    assert _until(np.array([0.0, 0.2, 0.05, 0.3]), 0.1, 0.02) == pytest.approx(0.04)
    assert _until(np.array([0.0, 0.1]), 0.1, 0.02) is None
