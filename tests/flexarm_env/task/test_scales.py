"""Steps by rule: stable wherever the tasks lead, with friction of the joints."""

import math
from typing import Any

import numpy as np
import pytest

from dynamics import Arm, load_arm
from dynamics.model import Model
from dynamics.simulation.step_limits import largest_step
from flexarm_env.task.observations import curvature_columns, curvature_scale
from flexarm_env.task.scales import (
    DEFLECTION_LIMIT,
    EXTENT,
    SAFE,
    integration,
    scales,
    stable_steps,
)

CONTROL_DT = 0.02  # [s]
BEAM = {
    "rho_A": 0.2,
    "EIz": 50.0,
    "modes": [{"kind": "clamped-tip-mass", "index": 1, "direction": "y"}],
}


def arm(*links: dict[str, Any]) -> Arm:
    return load_arm({"links": [BEAM | link for link in links]})


STICKING = arm(
    {"length": 0.8, "EIz": 6.0, "tip_mass": 0.15, "joint": {"rotor_inertia": 5e-4, "coulomb": 0.5}}
)
FASTEST_STRETCHED = arm(  # 2.3 times as fast as at home
    {"length": 1.0, "joint": {"rotor_inertia": 0.1}},
    {"length": 0.3, "tip_mass": 1.0, "joint": {"rotor_inertia": 1.0}},
)
SEGMENTS = arm(  # damping across segments is explicit
    {
        "length": 0.6, "tip_mass": 0.4, "damping_ratio": 0.3, "segments": 2,
        "modes": [{"kind": "hierarchical", "index": k, "direction": "y"} for k in (1, 2)],
        "joint": {"rotor_inertia": 1e-3},
    }
)  # fmt: skip


@pytest.mark.parametrize("arm", [STICKING, FASTEST_STRETCHED])
@pytest.mark.parametrize("integrator", [None, "rk4", "numerov"])
def test_steps_by_rule_are_stable_in_all_postures(arm: Arm, integrator: str | None) -> None:
    name, substeps = integration(arm, CONTROL_DT, integrator)
    model, home, dt = Model(arm), np.array(scales(arm).home), CONTROL_DT / substeps
    for angle in np.linspace(-EXTENT, EXTENT, 9):
        q = np.zeros(arm.n)
        q[list(arm.joint_index)] = home + angle
        assert largest_step(model, q, name, dt) == dt


@pytest.mark.parametrize("integrator", ["midpoint", "numerov"])
def test_a_margin_is_left_where_the_rule_had_to_find_the_limit(integrator: str) -> None:
    _, substeps = integration(STICKING, CONTROL_DT, integrator)
    model, q, dt = Model(STICKING), np.zeros(STICKING.n), CONTROL_DT / substeps
    assert largest_step(model, q, integrator, 1.2 * dt) == 1.2 * dt


@pytest.mark.parametrize("integrator", ["midpoint", "extrapolated-midpoint"])
def test_implicit_steps_just_within_the_limit_are_not_enough(integrator: str) -> None:
    limit = largest_step(Model(SEGMENTS), np.zeros(SEGMENTS.n), integrator, 1.0)
    least = math.ceil(1.1 * CONTROL_DT / limit)
    dt = CONTROL_DT / stable_steps(SEGMENTS, CONTROL_DT, integrator, least)
    assert 0.9 * SAFE * limit < dt <= SAFE * limit


@pytest.mark.parametrize("name", ["six-link", "srms-like"])
def test_vibrations_of_all_modes_together_keep_every_link_within_its_limit(name: str) -> None:
    arm, at = load_arm(name), 0
    vibration = np.array(scales(arm).vibration)
    for link in Model(arm).chain.links:
        m = len(link.K)
        moved = vibration[:, at : at + m] @ np.reshape(link.tip_phi, (-1, 3))[:m]
        assert np.linalg.norm(moved, axis=1).sum() <= DEFLECTION_LIMIT * link.length
        at += m


def test_curvatures_are_scaled_by_that_under_a_tip_force_which_bends_by_a_tenth() -> None:
    """F l / EI where F l^3 / (3 EI) = l / 10; along y and z of each link."""
    modes = [{"kind": "clamped-free", "index": 1, "direction": way} for way in "yz"]
    both = arm(*({"length": l, "EIy": 9.0, "modes": modes} for l in (0.6, 0.3)))
    expected = np.repeat([0.3 / 0.6, 0.3 / 0.3], 2)
    np.testing.assert_allclose(curvature_scale(both, curvature_columns(both)), expected, rtol=1e-9)
