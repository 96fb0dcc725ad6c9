from math import pi

import numpy as np
from numpy.testing import assert_allclose
from scipy.linalg import eigh

from dynamics import ARMS, Mode
from dynamics.description.mode_shapes import shape
from dynamics.formulations.link_constants import link_constants
from tests.dynamics.formulations.test_link_constants import a_link, modes


def test_the_slim_arm_has_its_measured_clamped_frequencies() -> None:
    """2.08 and 13.92 Hz measured by Yuan, Book and Huggins, 1993: within 1 %."""
    (link,) = ARMS["slim"].links
    clamped = [Mode(kind="clamped-tip-mass", index=k, direction="y") for k in (1, 2)]
    beta = np.array([shape(mode, link.beam).beta for mode in clamped])
    frequency = beta**2 / (2.0 * pi) * np.sqrt(link.EIz / (link.rho_A * link.length**4))
    assert_allclose(frequency, (2.08, 13.92), rtol=0.01)


def test_a_bar_stretches_at_its_textbook_frequencies() -> None:
    """(2 k - 1) pi / (2 l) sqrt(EA / rho A): limit (36) of Zohoor and Khorsandijou."""
    bar = a_link(
        *modes("axial-fixed-free", 4, "axial"), tip_mass=0.0, tip_inertia=((0.0,) * 3,) * 3
    )
    constants = link_constants(bar)
    expected = (np.arange(1, 5) - 0.5) * pi / bar.length * np.sqrt(bar.EA / bar.rho_A)
    K, M = np.array(constants.K), np.array(constants.s)
    assert_allclose(np.sqrt(np.diag(K) / np.diag(M)), expected, rtol=1e-13)
    assert_allclose(K - np.diag(np.diag(K)), 0.0, atol=1e-9)

    polynomials = link_constants(
        a_link(*modes("axial-poly", 8, "axial"), tip_mass=0.0, tip_inertia=((0.0,) * 3,) * 3)
    )
    squares = eigh(np.array(polynomials.K), np.array(polynomials.s), eigvals_only=True)
    assert_allclose(np.sqrt(squares[:2]), expected[:2], rtol=1e-6)
