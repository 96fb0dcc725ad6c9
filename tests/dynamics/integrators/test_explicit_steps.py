"""Steps up to which coordinates stay explicit in Numerov's method."""

import numpy as np
import pytest

from dynamics import Mode
from dynamics.formulations.linearized import explicit_steps, linear_arm
from dynamics.integrators.newmark import SAFE
from dynamics.integrators.table import INTEGRATORS
from dynamics.simulation.step_limits import amplification
from tests.dynamics.integrators.test_integrators import FASTEST, TWO_LINK, planar
from tests.dynamics.random_arms import compiled


def test_numerov_stays_stable_far_beyond_its_own_limit() -> None:
    """Its own limit, sqrt(6) over the highest frequency of the straight arm, is the first step."""
    chain = compiled(TWO_LINK).chain
    steps = explicit_steps(chain)
    arm = linear_arm(chain, np.zeros(6))
    own = linear_arm(chain, np.zeros(6))
    object.__setattr__(own, "aid", lambda kind: np.full(6, np.inf))

    assert steps.min() == pytest.approx(SAFE * np.sqrt(6.0) / FASTEST, rel=1e-9)
    assert np.isinf(steps[[0, 3]]).all()
    for share in (0.9, 1.1, 3.0, 30.0):
        dt = share * np.sqrt(6.0) / FASTEST
        assert (amplification(own, "numerov", dt) < 1.0 + 1e-6) == (share < 1.0)
        assert amplification(arm, "numerov", dt) < 1.0 + 1e-6


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_short_step_of_every_method_neither_grows_nor_decays(name: str) -> None:
    arm = linear_arm(compiled(TWO_LINK).chain, np.zeros(6))
    assert amplification(arm, name, 1e-3 / FASTEST) == pytest.approx(1.0, abs=2e-6)


def test_coupled_coordinates_become_fast_together() -> None:
    """Powers of x couple all modes of a link; hierarchical shapes couple none."""
    for kind, distinct in (("poly", 1), ("hierarchical", 3)):
        modes = tuple(Mode(kind=kind, index=k, direction="y") for k in (1, 2, 3))
        steps = explicit_steps(compiled(planar(1, modes=modes)).chain)
        assert len(np.unique(steps[1:])) == distinct


def test_each_limit_is_that_of_the_coordinates_which_are_explicit_below_it() -> None:
    """Of one link, whose inertia no posture changes; those with shorter limits are fast."""
    modes = tuple(Mode(kind="hierarchical", index=k, direction="y") for k in (1, 2, 3))
    chain = compiled(planar(1, modes=modes)).chain
    steps, arm = explicit_steps(chain), linear_arm(chain, np.zeros(4))
    for limit in np.unique(steps[1:]):
        aid = np.where(steps < limit, steps, np.inf)
        object.__setattr__(arm, "aid", lambda kind, aid=aid: aid)
        for share in (0.98, 1.02):
            growth = amplification(arm, "numerov", share * limit / SAFE)
            assert (growth < 1.0 + 1e-6) == (share < 1.0)
