"""Rigid arms: operation counts, and a short round trip."""

import numpy as np
import pytest

from benchmarks.accuracy import rigid_arms


@pytest.mark.parametrize("n", [3, 6])
def test_inverse_dynamics_takes_no_more_than_the_thesis(n: int) -> None:
    found = rigid_arms.counted(rigid_arms.general(n))

    assert found["multiplications"] <= 100 * n - 107
    assert found["additions"] <= 88 * n - 96
    assert found["divisions"] == 0
    assert found["sines and cosines"] == 2 * n


def test_each_joint_of_a_general_arm_takes_as_many_products_as_in_the_thesis() -> None:
    products = [rigid_arms.counted(rigid_arms.general(n))["multiplications"] for n in (4, 5, 6)]
    assert np.diff(products).tolist() == [100, 100]


def test_the_page_has_the_measured_values(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(rigid_arms.FOLLOWED, "stanford", 0.5)
    trip = rigid_arms.round_trip("stanford", 3)

    text = rigid_arms.page(rigid_arms.counts(), {"stanford": trip})

    assert trip["error"][0] == 0.0
    assert 0.0 < max(trip["error"]) < 1e-11
    assert trip["fastest growth [1/s]"] > 4.0
    assert f"| stanford | 0.5 s | {max(trip['error']):.1e} rad or m | 4.92 /s |" in text
    assert "| general, N = 6 | 486 | 432 | 493, 432 |" in text
