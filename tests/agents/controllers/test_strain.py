"""Joint PID, strain feedback and positive position feedback by hand."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import CONTROLLERS
from agents.controllers.pd import joint_pd
from agents.controllers.strain import PID, Chords, PositivePosition, StrainFeedback
from agents.metrics import make_batch

TWO = "FlexArm/TwoLink-Reach-v0"
GAINS = {"frequency_ratio": 0.2, "damping_ratio": 0.7}


@pytest.fixture
def envs() -> Any:
    return make_batch(TWO, 1, {"obs": "sensors"})


def observed(envs: Any, **parts: Any) -> Any:
    """Observation (1, size) with parts in physical units, the others zero."""
    base = envs.unwrapped
    x = np.zeros((1, base.single_observation_space.shape[0]))
    for name, value in parts.items():
        x[0, base.observation_slices[name]] = np.array(value) / base.observation_scales[name]
    return x


def test_pid_adds_the_integral_of_the_error(envs: Any) -> None:
    core, pd = envs.unwrapped.core, joint_pd(envs, *GAINS.values())
    subject = PID(envs, **GAINS, reset=2.0)
    x = observed(envs, joint_error=[0.01, -0.02])
    first, state = subject.predict(x)
    second, state = subject.predict(x, state, np.zeros(1, bool))
    share = core.control_dt / (2.0 * core.move_time)
    extra = -pd.stiffness * share * np.array([0.01, -0.02]) / pd.torque_limit
    alone = pd.predict(x)[0][0]
    assert first[0] == pytest.approx(alone + extra)
    assert second[0] == pytest.approx(alone + 2.0 * extra)
    again, _ = subject.predict(x, state, np.ones(1, bool))
    assert again == pytest.approx(first)


def test_pid_does_not_wind_up_at_the_torque_limit(envs: Any) -> None:
    subject = PID(envs, **GAINS, reset=0.01)
    _, state = subject.predict(observed(envs, joint_error=[3.0, 0.0]))
    assert state[0, 0] == 0.0


def test_chords_turn_as_beams_under_a_tip_force(envs: Any) -> None:
    """A force F bends to F l / EI at the root, and deflects the tip by F l^3 / 3 EI."""
    links = envs.unwrapped.core.arm.links
    force = np.array([0.1, -0.2])
    lengths, rigidity = (np.array([getattr(x, name) for x in links]) for name in ("length", "EIz"))
    found = Chords(envs, "x")(observed(envs, root_curvature=force * lengths / rigidity))
    assert found[0] == pytest.approx(force * lengths**2 / (3.0 * rigidity))


def test_joints_yield_towards_the_bent_links(envs: Any) -> None:
    x = observed(envs, root_curvature=[0.03, 0.0])
    pd = joint_pd(envs, *GAINS.values())
    found, _ = StrainFeedback(envs, **GAINS, yielding=2.0).predict(x)
    chord = Chords(envs, "x")(x)
    assert found == pytest.approx(2.0 * pd.stiffness * chord / pd.torque_limit)
    assert found[0, 0] > 0.0


def test_the_filter_of_positive_position_feedback_rests_at_the_chord(envs: Any) -> None:
    x = observed(envs, root_curvature=[0.03, -0.01])
    weights = {"gain": 0.5, "filter_ratio": 1.0, "filter_damping": 0.8}
    subject = PositivePosition(envs, **GAINS, **weights)
    state: Any = None
    for _ in range(400):
        found, state = subject.predict(x, state, np.zeros(1, bool))
    pd, chord = subject.pd, Chords(envs, "x")(x)
    assert state[0] == pytest.approx(chord)
    assert found == pytest.approx(0.5 * pd.stiffness * chord / pd.torque_limit)


@pytest.mark.parametrize("name", ["strain", "ppf"])
def test_strain_is_not_among_exact_states(name: str) -> None:
    envs = make_batch(TWO, 1, {"obs": "state"})
    with pytest.raises(ValueError, match=f"{name} needs obs='sensors'"):
        CONTROLLERS[name].build(envs, **CONTROLLERS[name].middle)
