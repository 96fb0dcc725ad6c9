"""Joints that slide, joints with springs, and rigid bodies of any form, against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from dynamics import Arm, Body, Model, elimination, gibbs_appell
from tests.dynamics import brute_force
from tests.dynamics.random_arms import (
    Array,
    floats,
    random_arm,
    random_state,
    random_torque,
    torque_matrix,
)

CASES = [(seed, 1 + seed % 5, seed % 4) for seed in range(12)]  # seed, links, most modes per link
any_arm = pytest.mark.parametrize("case", CASES, ids=str)


def mixed_arm(seed: int, n_link: int, n_mode: int) -> Arm:
    """A random flexible arm, some of its joints sliding, sprung or both, some links mere bodies."""
    arm = random_arm(seed, n_link, n_mode)
    rng = np.random.default_rng([seed, 3])
    links = []
    for link in arm.links:
        pinned = any(mode.kind == "pinned-free" for mode in link.modes)
        joint = link.joint
        if rng.random() < 0.5 and not pinned:
            joint = replace(joint, type="prismatic")
        if rng.random() < 0.5:
            joint = replace(
                joint, stiffness=rng.uniform(50.0, 500.0), spring_damping=rng.uniform(0.0, 0.5),
                rotor_inertia=0.1,
            )  # fmt: skip
        link = replace(link, joint=joint)
        if not link.modes:
            link = replace(link, segments=1, rho_A=0.0, length=0.0, body=random_body(rng))
        links.append(link)
    return replace(arm, links=tuple(links))


def random_body(rng: np.random.Generator) -> Body:
    turn = Rotation.random(random_state=rng).as_matrix()
    inertia = turn @ np.diag(rng.uniform(0.02, 0.04, 3)) @ turn.T
    com = tuple(rng.normal(0.0, 0.2, 3))
    return Body(mass=rng.uniform(0.5, 2.0), com=com, inertia=tuple(map(tuple, inertia)))


def composite(arm: Arm, q: Array, v: Array) -> tuple[Array, Array]:
    chain = Model(arm).chain
    M = gibbs_appell.mass_matrix(chain, floats(q))
    return np.array(M), np.array(gibbs_appell.bias(chain, floats(q), floats(v)))


def test_mixed_arms_have_everything() -> None:
    links = [link for case in CASES for link in mixed_arm(*case).links]
    kinds = {(k.joint.type, k.joint.elastic, bool(k.modes), k.body is None) for k in links}
    assert len(kinds) == 8
    assert any(k.joint.elastic and any(m.kind == "pinned-free" for m in k.modes) for k in links)
    assert any(k.segments > 1 and k.joint.elastic and k.modes for k in links)


@any_arm
def test_mass_matrix_and_bias_are_those_of_brute_force(case: tuple[int, int, int]) -> None:
    """Kinetic energy and energy of acceleration of all bodies, springs by their definition."""
    arm = mixed_arm(*case)
    q, v = random_state(arm)
    M, h = composite(arm, q, v)

    expected = brute_force.mass_matrix(arm, q)
    forces = brute_force.inertial_forces(arm, q, v, 0.0 * v)
    forces += brute_force.resisting_forces(arm, q, v)

    assert_allclose(M, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())
    assert_allclose(h, forces, rtol=0.0, atol=1e-11 * np.abs(forces).max())


@any_arm
def test_elimination_solves_the_composite_equations(case: tuple[int, int, int]) -> None:
    arm = mixed_arm(*case)
    (q, v), tau = random_state(arm), random_torque(arm)
    M, h = composite(arm, q, v)

    a = elimination.accelerations(Model(arm).chain, floats(q), floats(v), floats(tau))

    expected = np.linalg.solve(M, torque_matrix(arm) @ tau - h)
    assert_allclose(a, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())
