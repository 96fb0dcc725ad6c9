"""States with quaternions: the way back, and rates."""

import numpy as np

from dynamics.description.rotations import (
    from_rotation_vector,
    product,
    to_rotation_vector,
)
from dynamics.simulation.quaternion_state import (
    quaternions,
    rates,
    with_quaternion,
    with_rotation_vector,
)

Q, V = np.random.default_rng(0).uniform(-0.9, 0.9, (2, 8))


def test_a_state_survives_the_way_to_quaternions_and_back() -> None:
    np.testing.assert_allclose(with_rotation_vector(with_quaternion(Q)), Q, rtol=1e-12)


def test_rates_are_those_of_a_base_that_turns_about_its_own_axes() -> None:
    """Beside central differences of attitudes that a small rotation follows."""
    x, h = with_quaternion(Q), 1e-5

    def after(h: float) -> np.ndarray:
        attitude = product(x[3:7].tolist(), from_rotation_vector((h * V[3:6]).tolist()))
        return np.concatenate([Q[:3] + h * V[:3], attitude, Q[6:] + h * V[6:]])

    np.testing.assert_allclose(rates(x, V), (after(h) - after(-h)) / (2.0 * h), atol=1e-9)


def test_the_attitudes_of_a_motion_turn_on_where_a_rotation_vector_jumps() -> None:
    """Two turns about one axis: shortest rotation vectors jump at half a turn."""
    axis, angles = np.array([0.6, 0.0, -0.8]), np.linspace(0.0, 4.0 * np.pi, 50)
    expected = np.column_stack([np.cos(angles / 2.0), np.outer(np.sin(angles / 2.0), axis)])
    q = np.array([[0.0, 0.0, 0.0, *to_rotation_vector(x)] for x in expected.tolist()])

    for sign in (1.0, -1.0):
        found = quaternions(q, sign * expected[0])
        np.testing.assert_allclose(found, sign * expected, rtol=0.0, atol=1e-12)
