"""Motions of a scene, and invalid motions that are refused."""

from dataclasses import replace
from typing import Any

import pytest
from numpy.testing import assert_allclose

from benchmarks.accuracy.model_choice import TRIALS
from dynamics import Scene, choose_model
from dynamics.accuracy.rollout import SAMPLES, STRIDES, _strides
from dynamics.accuracy.scene import JointMotion, bang_bang, cycloid, release


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"joint_angles": (), "joint_rates": ()}, "joint_angles must hold one angle per joint"),
        ({"joint_rates": (0.0, 0.0)}, "joint_rates must have 1 numbers, got 2"),
        ({"t_end": -1.0}, "t_end must be positive, got -1.0"),
        ({"t_end": float("nan")}, "t_end"),
        ({"torque": 3.0}, "torque must be a function of time or None, got 3.0"),
    ],
)
def test_invalid_motions_are_refused(change: dict[str, Any], sentence: str) -> None:
    values = {"joint_angles": (0.0,), "joint_rates": (0.0,), "t_end": 1.0}
    with pytest.raises(ValueError, match=sentence):
        JointMotion(**{**values, **change})


def test_a_scene_must_fit_the_arm_and_the_tolerance_be_positive() -> None:
    arm, motion = TRIALS["heavy hub"].arm, TRIALS["heavy hub"].scene.motions[0]
    with pytest.raises(ValueError, match="at least one motion"):
        Scene(motions=())
    with pytest.raises(ValueError, match=r"joint_angles must have shape \(1,\).*got \(2,\)"):
        choose_model(arm, Scene(motions=(release((0.0, 0.0), t_end=1.0),)), 1e-3)
    odd = replace(motion, torque=lambda t: [0.0, 0.0])
    with pytest.raises(ValueError, match=r"torque must have shape \(1,\).*got \(2,\)"):
        choose_model(arm, Scene(motions=(odd,)), 1e-3)
    with pytest.raises(ValueError, match=r"tolerance must be positive, got 0\.0"):
        choose_model(arm, Scene(motions=(motion,)), 0.0)


def test_bang_bang_cycloid_and_release_have_the_described_torques() -> None:
    pulse = bang_bang((2.0, 0.5), pulse=0.2, t_end=1.0)
    assert pulse.knots == (0.0, 0.2, 0.4, 1.0)
    assert pulse.torque is not None
    assert_allclose([pulse.torque(t) for t in (0.1, 0.3, 0.5)], [[2, 0.5], [-2, -0.5], [0, 0]])
    smooth = cycloid((2.0,), duration=0.4, t_end=1.0)
    assert smooth.torque is not None
    assert_allclose([smooth.torque(t)[0] for t in (0.1, 0.3, 0.4)], [2.0, -2.0, 0.0], atol=1e-12)
    assert release((0.1,), t_end=1.0).torque is None


@pytest.mark.parametrize("share", [0.1, 0.3, 0.9, 1.7, 9.0])
def test_samples_are_compared_as_densely_as_four_steps_between_them_allow(share: float) -> None:
    dt = share / SAMPLES
    stride, steps, width = _strides(release((0.1,), t_end=1.0), dt)
    assert width == pytest.approx(stride / SAMPLES, rel=0.05)  # whole strides in the motion
    assert stride == STRIDES[0] or width >= 4.0 * dt
    assert stride == STRIDES[-1] or width < 8.0 * dt
    assert steps == max(1, round(width / dt))
