"""Short forms of the stability maps: failure and stability on both sides of each boundary."""

import numpy as np
import pytest

from benchmarks.accuracy import stability
from dynamics.integrators.table import INTEGRATORS

FROZEN = ("exponential", "numerov")  # methods that take the stiffness of the straight arm


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_method_fails_exactly_where_its_amplification_predicts(integrator: str) -> None:
    """Over step and damping: an A-stable method never fails, others fail beyond their boundary.

    Exponential steps and Numerov's fail if the stiffness is far from the frozen one.
    """
    found = stability.method_map(integrator, 9)
    failed = np.array(found["failed"])
    assert np.array_equal(failed, found["predicted"])
    limited = np.isfinite(INTEGRATORS[integrator].limit) or integrator.startswith(FROZEN)
    assert failed.any() == limited
    assert not failed.all()


def test_the_linear_link_fails_when_it_spins_faster_than_its_own_frequency() -> None:
    """The instability is an artefact of the linear model; foreshortening removes it."""
    linear = stability.spin_map(False, 12)
    failed = np.array(linear["failed"])
    assert np.array_equal(failed, linear["predicted"])
    assert failed.any()
    assert not failed.all()
    assert not np.any(stability.spin_map(True, 12)["failed"])


def test_delay_destabilises_joint_pd_where_the_sampled_loop_predicts() -> None:
    """One cell in twenty may be too near the boundary to grow or decay within 20 s."""
    found = stability.loop_map(0.1, 8)
    failed, predicted = np.array(found["failed"]), np.array(found["predicted"])
    assert np.mean(failed == predicted) > 0.95
    assert failed[1:, -1].all()
    assert not failed[:, 0].any()


def test_the_right_shapes_depend_on_the_hub() -> None:
    """One clamped mode errs by 10 % with a light hub, by 1e-4 with a heavy one; pinned: reverse."""
    found = stability.shape_map()
    error = {name: np.abs(values) for name, values in found["error"].items()}
    assert error["clamped-free, 1"][0] > 0.1 > 1e-4 > error["clamped-free, 1"][-1]
    assert error["pinned-free, 1"][-1] > 0.1 > 1e-4 > error["pinned-free, 1"][0]
    assert np.all(error["clamped-free, 2"] < error["clamped-free, 1"])
