"""Models of one arm with the same deflection."""

from dataclasses import replace

import numpy as np
import pytest

from dynamics import ARMS, Arm, Joint, Link, Mode
from dynamics.accuracy.fidelity import Fidelity, everything
from dynamics.accuracy.same_shape import transferred
from dynamics.model import Model


@pytest.mark.parametrize("name", ["slim", "two-link", "six-link", "free-flyer"])
def test_a_model_in_segments_has_the_tip_and_its_velocity(name: str) -> None:
    """Beside many modes in one piece: at deflections of a tenth, to 1e-5 of the reach."""
    arm = ARMS[name]
    fine = Fidelity(counts=everything(arm, 3, 2), segments=(4,) * arm.n_joint, polynomial=True,
                    foreshortening=True).arm(arm)  # fmt: skip
    rng, joints = np.random.default_rng(0), list(arm.joint_index)
    q, v = np.zeros((2, 3, arm.n))
    modal = [k for k, text in enumerate(arm.names) if text.startswith("d")]
    lengths = np.array([arm.links[int(arm.names[k][1]) - 1].length for k in modal])
    q[:, joints], v[:, joints] = rng.normal(0.0, 1.0, (2, 3, arm.n_joint))
    q[:, modal] = 0.01 * lengths * rng.uniform(-1.0, 1.0, (3, len(modal)))
    v[:, modal] = rng.uniform(-1.0, 1.0, (3, len(modal))) * lengths * 0.2

    moved, turned = transferred(q, v, arm, fine)

    own, other = Model(arm), Model(fine)
    for row in range(3):
        apart = own.tip(q[row]) - other.tip(moved[row])
        assert np.linalg.norm(apart) < 1e-4 * arm.reach
        faster = own.tip_velocity(q[row], v[row]) - other.tip_velocity(moved[row], turned[row])
        assert np.linalg.norm(faster) < 3e-3 * np.linalg.norm(own.tip_velocity(q[row], v[row]))


def test_there_and_back_is_the_same_and_joints_stay() -> None:
    arm = ARMS["two-link"]
    fine = Fidelity(counts=((4, 0, 0), (4, 0, 0)), segments=(1, 1), polynomial=True,
                    foreshortening=True).arm(arm)  # fmt: skip
    rng = np.random.default_rng(1)
    q, v = 0.03 * rng.normal(size=(2, 5, arm.n))
    there = transferred(q, v, arm, fine)
    back = transferred(*there, fine, arm)
    np.testing.assert_allclose(back[0], q, atol=1e-12)
    np.testing.assert_allclose(back[1], v, atol=1e-9)
    straight = replace(arm, foreshortening=False)
    assert transferred(q, v, straight, straight)[0] is not q


def test_pinned_modes_and_clamped_ones_of_a_link_have_the_same_tip() -> None:
    """Their joint angles differ by the slope at the root, which turns with pinned modes alone.

    The tips of linear models differ by products of deflections.
    """
    arms = [
        Arm(links=(Link(length=1.0, rho_A=0.5, EIz=20.0, modes=tuple(
            Mode(kind=kind, index=k + 1, direction="y") for k in range(count)),
            joint=Joint(rotor_inertia=5e-4)),))
        for kind, count in (("pinned-free", 2), ("hierarchical", 6))
    ]  # fmt: skip
    pinned, clamped = map(Model, arms)
    q, v = np.array([[0.3, 3e-3, 4e-4]]), np.array([[0.2, 0.05, -0.01]])

    moved, turned = transferred(q, v, *arms)

    assert np.linalg.norm(pinned.tip(q[0]) - clamped.tip(moved[0])) < 5e-5
    faster = pinned.tip_velocity(q[0], v[0]) - clamped.tip_velocity(moved[0], turned[0])
    assert np.linalg.norm(faster) < 3e-3
    np.testing.assert_allclose(clamped.encoders @ moved[0], pinned.encoders @ q[0], atol=1e-12)
    back = transferred(moved, turned, arms[1], arms[0])
    np.testing.assert_allclose(back[0], q, atol=1e-4)
