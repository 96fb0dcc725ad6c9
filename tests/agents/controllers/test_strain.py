"""Joint PID and feedback of the strain by hand, and along a root locus."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agents.controllers import CONTROLLERS
from agents.controllers.models.linear_model import LinearModels
from agents.controllers.pd import joint_pd
from agents.controllers.strain import (
    PID,
    Chords,
    IntegralResonant,
    PositivePosition,
    StrainFeedback,
)
from agents.metrics import make_batch
from dynamics import ARMS
from tests.agents.controllers.springs import Environment

TWO = "FlexArm/TwoLink-Reach-v0"
GAINS = {"frequency_ratio": 0.2, "damping_ratio": 0.7}


@pytest.fixture
def envs() -> Any:
    """Masses on springs, with the gauges of two links."""
    envs = Environment("sensors")
    envs.core.arm = ARMS["two-link"]
    return envs


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


@pytest.mark.parametrize(
    ("subject", "extra", "state"),
    [
        (PID, {"reset": 1e9}, [[1.0, 1.0]]),
        (StrainFeedback, {"yielding": -1.0}, None),
        (IntegralResonant, {"gain": 1e-9, "corner_ratio": 1e-9}, [[[-1.0, -1.0]]]),
    ],
)
def test_torques_are_limited_once_all_terms_are_added(
    envs: Any, subject: Any, extra: dict[str, float], state: Any
) -> None:
    """Joint PD asks for 1.6 times the limit of the first joint, and the other term for -1.0."""
    pd, shape = joint_pd(envs, *GAINS.values()), Chords(envs, "x")
    unit = pd.torque_limit / pd.stiffness
    bent = np.linalg.solve(shape.turn.T, unit * [1.0, 0.0])
    x = observed(envs, joint_error=-1.6 * unit * [1.0, 0.0], root_curvature=bent)
    before = None if state is None else state * (unit * [1.0, 0.0])
    found, _ = subject(envs, **GAINS, **extra).predict(x, before, np.zeros(1, bool))
    assert found[0] == pytest.approx([0.6, 0.0], abs=1e-6)


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


def test_the_filter_of_positive_position_feedback_swings_about_the_chord(envs: Any) -> None:
    """Step response of a damped oscillator, in closed form."""
    x = observed(envs, root_curvature=[0.03, -0.01])
    weights = {"gain": 0.5, "filter_ratio": 0.7, "filter_damping": 0.4}
    subject = PositivePosition(envs, **GAINS, **weights)
    state: Any = None
    pd, chord, w = subject.pd, Chords(envs, "x")(x), 0.7 * envs.core.scales.locked[0]
    turn, decay = w * np.sqrt(1.0 - 0.4**2), 0.4 * w
    for k in range(1, 40):
        found, state = subject.predict(x, state, np.zeros(1, bool))
        t = k * envs.core.control_dt
        left = np.exp(-decay * t) * (np.cos(turn * t) + decay / turn * np.sin(turn * t))
        assert state[:, 0] == pytest.approx(chord * (1.0 - left))
        assert found == pytest.approx(0.5 * pd.stiffness * state[:, 0] / pd.torque_limit)


@pytest.mark.compiles
@pytest.mark.parametrize("name", ["strain", "ppf", "irc"])
def test_strain_is_not_among_exact_states(name: str) -> None:
    envs = make_batch(TWO, 1, {"obs": "state"})
    with pytest.raises(ValueError, match=f"{name} needs obs='sensors'"):
        CONTROLLERS[name].build(envs, **CONTROLLERS[name].middle)


NO_GAUGES, STRAIGHT = "reads strain gauges, of which this arm has none", "takes an arm that bends"


@pytest.mark.compiles
@pytest.mark.parametrize(
    ("name", "sentence"), [("strain", NO_GAUGES), ("lqg", NO_GAUGES), ("mpc", STRAIGHT)]
)
def test_an_arm_that_does_not_bend_is_refused_as_such(name: str, sentence: str) -> None:
    arm, (obs,) = ARMS["slim"], CONTROLLERS[name].obs
    rigid = replace(arm, links=(replace(arm.links[0], modes=(), damping_ratio=0.0),))
    envs = make_batch("FlexArm/OneLink-Reach-v0", 1, {"obs": obs, "arm": rigid})
    with pytest.raises(ValueError, match=f"{name} {sentence}"):
        CONTROLLERS[name].build(envs, **CONTROLLERS[name].middle)


IRC = {"frequency_ratio": 1.0, "damping_ratio": 1.0}


def test_the_integral_of_the_strain_follows_its_differential_equation(envs: Any) -> None:
    """u' = k (chord - u / gain) from rest under a constant chord, in closed form."""
    subject = IntegralResonant(envs, **IRC, gain=0.5, corner_ratio=0.3)
    core, x = envs.unwrapped.core, observed(envs, root_curvature=[0.003, -0.001])
    chord, corner = Chords(envs, "x")(x), 0.3 * core.scales.locked[0]
    state: Any = None
    for k in range(1, 40):
        found, state = subject.predict(x, state, np.zeros(1, bool))
        grown = 0.5 * chord * (1.0 - np.exp(-corner * k * core.control_dt))
        assert state[:, 0] == pytest.approx(grown)
        assert found == pytest.approx(subject.pd.stiffness * grown / subject.pd.torque_limit)


def locus(gain: float) -> Any:
    """Poles [rad/s] of the one-link arm under the controller itself, sampled every 0.5 ms.

    The loop is closed around the arm's linear model; the law is linear below the torque limit, so
    that it is known by its answers to single readings.
    """
    envs = make_batch("FlexArm/OneLink-Reach-v0", 1, {"control_dt": 5e-4, "obs": "sensors"})
    subject = IntegralResonant(envs, **IRC, gain=gain, corner_ratio=1.0)
    model, limit = LinearModels.of(envs).at(np.zeros(1)), envs.unwrapped.torque_limit
    rate = np.hstack([np.zeros_like(model.shapes[:1]), model.shapes[:1]])
    size, small = len(model.A), 1e-6
    loop = np.zeros((size + 1, size + 1))
    for k, unit in enumerate(np.eye(size + 1)):
        joint, bent = model.C @ unit[:size]
        x = observed(
            envs, joint_error=small * joint, root_curvature=small * bent,
            joint_rate=small * (rate @ unit[:size]),
        )  # fmt: skip
        action, state = subject.predict(x, small * unit[None, None, size:], np.zeros(1, bool))
        torque = action[0] * limit / small
        loop[:, k] = [*(model.A @ unit[:size] + model.B @ torque), state[0, 0, 0] / small]
    return np.log(np.linalg.eigvals(loop).astype(complex)) / 5e-4


def exact_locus(gain: float) -> Any:
    """Closed loop in continuous time from the arm's equations of motion."""
    envs = make_batch("FlexArm/OneLink-Reach-v0", 1, {"obs": "sensors"})
    model, pd = envs.unwrapped.model, joint_pd(envs, *IRC.values())
    n, rest = model.n, np.zeros(model.n)
    A, B = model.linearize(rest, rest, np.zeros(1))
    corner = model.frequencies(rest, joints="locked")[0]
    chord = [model.strain(e, 0, 0.0)[2] * model.arm.links[0].length / 3.0 for e in np.eye(n)]
    push = np.zeros((1, 2 * n + 1))
    push[0, [0, n, 2 * n]] = -pd.stiffness[0], -pd.damping[0], pd.stiffness[0]
    loop = np.vstack([np.hstack([A, np.zeros((2 * n, 1))]) + B @ push, np.zeros(2 * n + 1)])
    loop[-1, :n], loop[-1, -1] = corner * gain * np.array(chord), -corner
    return np.linalg.eigvals(loop)


@pytest.mark.compiles
def test_integral_resonant_control_adds_damping_along_its_root_locus() -> None:
    """The first oscillation decays twice as fast at a gain of 1, and no pole turns unstable."""
    ratios = []
    for gain in (0.0, 0.1, 0.3, 1.0):
        exact, found = exact_locus(gain), locus(gain)
        assert found.real.max() < 0.0
        for pole in exact[np.abs(exact) < 100.0]:
            assert np.abs(found - pole).min() < 0.05 * abs(pole)
        first = found[(found.imag > 5.0) & (found.imag < 50.0)]
        ratios.append(float((-first.real / np.abs(first)).min()))
    assert ratios == sorted(ratios)
    assert ratios[-1] > 2.0 * ratios[0]
