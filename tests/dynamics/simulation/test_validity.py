"""Warnings name every assumption of the model that a motion violates."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.accuracy.model_choice import (
    S1,
)
from dynamics import (
    Joint,
    Mode,
    Trajectory,
    ValidityWarning,
    limits,
    simulate,
)
from tests.dynamics.random_arms import compiled


def test_limits_name_every_assumption_that_a_motion_violates() -> None:
    mode = Mode(kind="clamped-free", index=1, direction="y")
    link = replace(S1.links[0], modes=(mode,), joint=Joint(rotor_inertia=0.01))
    model = compiled(replace(S1, links=(link,)))
    first = model.frequencies()[0]

    def moved(rate: float, tip: float) -> Trajectory:
        q, v = np.array([[0.0, 0.0], [0.1, tip]]), np.array([[0.0, 0.0], [rate, 0.0]])
        return Trajectory(np.array([0.0, 1.0]), q, v, np.zeros((2, 3)))

    length = link.length
    assert limits(model, moved(0.49 * first, 0.09 * length)) == ()
    (rate,) = limits(model, moved(-0.51 * first, 0.0))
    assert "Joint 1 turns" in rate
    (bent,) = limits(model, moved(0.0, -0.105 * length))
    assert "Link 1 bends by up to 10% of the link's length" in bent
    assert "tip by up to 0.21 rad" in limits(model, moved(0.0, 0.15 * length))[1]
    stiffening = compiled(replace(model.arm, foreshortening=True))
    assert limits(stiffening, moved(2.0 * first, 0.0)) == ()
    with pytest.warns(ValidityWarning, match="Joint 1 turns"):
        simulate(model, [0.0, 0.0], [0.51 * first, 0.0], None, [0.0, 1e-3])


def test_springs_of_joints_and_torsion_lose_no_stiffness_where_an_arm_spins() -> None:
    twisting = Mode(kind="torsion-fixed-free", index=1, direction="x")
    joint = Joint(rotor_inertia=0.01, stiffness=50.0)
    link = replace(S1.links[0], GJ=10.0, rho_Ip=1e-4, modes=(twisting,), joint=joint)
    model = compiled(replace(S1, links=(link,)))
    q, v = np.zeros((2, 3)), np.array([[0.0, 0.0, 0.0], [1e3, 0.0, 0.0]])
    assert limits(model, Trajectory(np.array([0.0, 1.0]), q, v, np.zeros((2, 3)))) == ()
