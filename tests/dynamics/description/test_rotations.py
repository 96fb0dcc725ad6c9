import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from dynamics.description.rotations import (
    from_euler,
    from_rotation_vector,
    product,
    rotation_matrix,
    to_euler,
    to_rotation_vector,
)

RANDOM = np.random.default_rng(0).normal(size=(20, 3))
ANGLES = [0.0, 1e-12, 1e-5, 1.9e-4, 2.1e-4, 0.5, 3.0, np.pi - 1e-9, np.pi, 4.0, 2.0 * np.pi, 50.0]


def matrix(rotation: Rotation) -> np.ndarray:
    return rotation.as_matrix()


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_vectors_of_any_length_are_quaternions_and_back(angle: float) -> None:
    for axis in RANDOM / np.linalg.norm(RANDOM, axis=1)[:, None]:
        expected = Rotation.from_rotvec(angle * axis)

        quaternion = from_rotation_vector(angle * axis)
        back = np.array(to_rotation_vector(quaternion))

        assert_allclose(rotation_matrix(quaternion), matrix(expected), rtol=0.0, atol=1e-14)
        assert np.linalg.norm(back) < np.pi + 1e-12
        assert_allclose(matrix(Rotation.from_rotvec(back)), matrix(expected), rtol=0.0, atol=1e-14)
        if angle < np.pi:
            assert_allclose(back, angle * axis, rtol=1e-14, atol=1e-15)


def test_a_product_turns_inside_the_turned_frame() -> None:
    p, q = from_rotation_vector(RANDOM[0]), from_rotation_vector(RANDOM[1])

    expected = np.array(rotation_matrix(p)) @ np.array(rotation_matrix(q))

    assert_allclose(rotation_matrix(product(p, q)), expected, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("angles", [*RANDOM[:5], (0.3, np.pi / 2, 0.0), (0.3, -np.pi / 2, 0.0)])
def test_euler_angles_turn_about_axis_3_then_2_then_1(angles: np.ndarray) -> None:
    expected = Rotation.from_euler("ZYX", angles)

    quaternion = from_euler(angles)

    assert_allclose(rotation_matrix(quaternion), matrix(expected), rtol=0.0, atol=1e-14)
    again = from_euler(to_euler(quaternion))
    assert_allclose(rotation_matrix(again), matrix(expected), rtol=0.0, atol=1e-14)
    if abs(angles[1]) < 1.5:
        assert_allclose(to_euler(quaternion), angles, rtol=0.0, atol=1e-13)


def test_at_a_quarter_turn_both_euler_angles_about_one_axis_count() -> None:
    quaternion = from_euler((0.3, np.pi / 2, 0.2))

    theta, phi, psi = to_euler(quaternion)

    assert (phi, psi) == (pytest.approx(np.pi / 2), 0.0)
    assert theta == pytest.approx(0.1)
