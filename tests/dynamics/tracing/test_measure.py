"""Measurements of a state, beside each other."""

import numpy as np
import pytest

from dynamics import Arm, Joint, Link, Mode
from dynamics.model import Model
from dynamics.tracing import graphs


@pytest.mark.parametrize("segments", [1, 3])
def test_the_deflection_of_the_only_link_is_how_far_its_tip_is_from_the_rigid_one(
    segments: int,
) -> None:
    modes = tuple(Mode(kind="hierarchical", index=k, direction="y") for k in (1, 2))
    joint = Joint(rotor_inertia=0.1)
    link = Link(length=0.8, rho_A=0.3, EIz=5.0, modes=modes, segments=segments, joint=joint)
    traced = Model(Arm(links=(link,))).traced
    q = np.random.default_rng(0).uniform(-0.05, 0.05, traced.n)
    found = np.array(graphs.measure(traced)(q, 0.0 * q)).ravel()
    tip, rigid, bent = (found[traced.measurements[x]] for x in ("tip", "rigid_tip", "deflection"))
    np.testing.assert_allclose(bent, [np.linalg.norm(tip - rigid) / 0.8], rtol=1e-12)
