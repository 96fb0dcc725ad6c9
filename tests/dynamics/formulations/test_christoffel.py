"""Christoffel's H against the recursion's velocity terms and the rate of the mass matrix."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dynamics import Arm, Model, compile_arm
from dynamics.formulations.table import FORMULATIONS
from dynamics.types import Array
from tests.dynamics.random_arms import random_arm, random_state, two_link_spatial

ARMS = [random_arm(1, 1, 3), random_arm(3, 2, 3), two_link_spatial(), random_arm(4, 3, 3)]


@pytest.fixture(params=ARMS, ids=lambda arm: f"{arm.n_joint}-link-{arm.n}", scope="module")
def arm(request: pytest.FixtureRequest) -> Arm:
    """Arm without damping and friction, so that all rate terms are inertial."""
    links = tuple(
        replace(
            link, damping_beta=0.0, damping_ratio=0.0,
            joint=replace(link.joint, viscous=0.0, coulomb=0.0),
        )
        for link in request.param.links
    )  # fmt: skip
    return replace(request.param, links=links)


def slope(f: Callable[[float], Array], step: float = 1e-4) -> Array:
    """Derivative at zero by central differences of order six."""
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    return sum(w * (f(k * step) - f(-k * step)) for k, w in weights.items()) / (60.0 * step)


def asymmetry(model: Model, q: Array, v: Array, H: Array) -> float:
    """Largest entry of W + W', W = dM/dt - 2 H, relative to that of H."""
    W = slope(lambda t: model.mass_matrix(q + t * v)) - 2.0 * H
    return float(np.abs(W + W.T).max() / np.abs(H).max())


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_h_moves_by_christoffels_form(arm: Arm, formulation: str) -> None:
    """H v = h(q, v) - h(q, 0): H from automatic differentiation of M, h from the recursion."""
    model = compile_arm(arm, formulation=formulation)
    q, v = random_state(arm)

    velocity_terms = model.bias(q, v) - model.bias(q, 0.0 * v)

    Hv = model.christoffel(q, v) @ v
    size = np.abs(model.christoffel(q, v)) @ np.abs(v)
    assert np.abs((Hv - velocity_terms) / size).max() < 1e-11


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_M_dot_less_twice_H_is_skew(arm: Arm, formulation: str) -> None:
    model = compile_arm(arm, formulation=formulation)
    q, v = random_state(arm)

    assert asymmetry(model, q, v, model.christoffel(q, v)) < 1e-9
    u = random_state(arm, 1)[1]
    H = model.christoffel(q, u)
    assert np.array_equal(H.shape, (arm.n, arm.n))
    assert np.abs(model.christoffel(q, 2.0 * u) - 2.0 * H).max() <= 1e-12 * np.abs(H).max()


def test_other_matrices_with_the_same_forces_are_not_skew(arm: Arm) -> None:
    """N - N'/2 with N = d(M v)/dq gives the same forces, so Christoffel's form is needed."""
    model = compile_arm(arm)
    q, v = random_state(arm)
    H = model.christoffel(q, v)
    N = np.array([slope(lambda t, e=e: model.mass_matrix(q + t * e) @ v) for e in np.eye(arm.n)]).T
    other = N - 0.5 * N.T

    assert np.abs(other @ v - H @ v).max() < 1e-8 * np.abs(H @ v).max()
    assert asymmetry(model, q, v, other) > 1e-3


def test_a_linear_rotation_has_no_energy_behind_its_forces() -> None:
    """With theta_dot as the rate of 1 + theta~ no H of M gives h; with Book's E_dot one does."""
    arm = replace(ARMS[2], rotation="linear", gravity=(0.0, 0.0, 0.0))
    links = tuple(
        replace(k, damping_beta=0.0, joint=replace(k.joint, viscous=0.0)) for k in arm.links
    )
    arm = replace(arm, links=links)
    q, v = random_state(arm)
    errors = {}
    for name in FORMULATIONS:
        model = compile_arm(arm, formulation=name)
        Hv = model.christoffel(q, v) @ v
        velocity_terms = model.bias(q, v) - model.bias(q, 0.0 * v)
        errors[name] = np.abs(Hv - velocity_terms).max() / np.abs(Hv).max()

    assert errors["book"] < 1e-11
    assert errors["gibbs_appell"] > 1e-4
    assert errors["complement"] == pytest.approx(errors["gibbs_appell"], rel=1e-6)
