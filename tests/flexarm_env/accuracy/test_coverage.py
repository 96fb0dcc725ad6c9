"""An environment has a certificate where one holds, and says why where none does."""

import gymnasium as gym
import pytest

import flexarm_env  # noqa: F401
from dynamics.accuracy.progress import Progress
from dynamics.load import load_arm
from flexarm_env.accuracy.certificates import scene

ID = "FlexArm/OneLink-Reach-v0"


def test_drawn_parameters_have_no_certificate_and_no_tolerance() -> None:
    drawn = gym.make(ID, randomize={"payload_mass": (0.0, 0.1)}).unwrapped
    assert drawn.certificate is None
    assert "randomize (['payload_mass'])" in drawn.uncertified
    assert "both ends of each range" in drawn.uncertified
    with pytest.raises(ValueError, match=r"tolerance \(0.01 m\) covers the arm as described.*ends"):
        gym.make(ID, randomize={"payload_mass": (0.0, 0.1)}, tolerance=0.01)


def test_a_step_that_was_not_measured_says_so() -> None:
    env = gym.make(ID, integrator="rk4", substeps=17).unwrapped
    assert env.certificate is None
    assert "never measured" in env.uncertified


def test_torques_of_a_certificate_change_only_at_control_steps() -> None:
    """So that an environment, which starts its method at each of them, can follow."""
    for motion in scene(load_arm("slim"), 0.02).motions:
        assert motion.hold == 0.02
        assert all(abs(t / 0.02 - round(t / 0.02)) < 1e-9 for t in motion.knots)


def test_progress_shows_stages_only_if_asked(capsys: pytest.CaptureFixture[str]) -> None:
    for shown in (None, False, True):
        with Progress(shown) as line:
            line.stage("reference")
            line.motion()
            line.result("0.1 m")
        text = capsys.readouterr().err
        assert ("reference: 1 motions" in text and "0.1 m" in text) == (shown is True)
