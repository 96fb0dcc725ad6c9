"""Inverse dynamics with flexible feed-forward, against rigid mechanics and the environment."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import controller
from agents.controllers.inverse import InverseDynamics
from agents.controllers.pd import joint_pd
from agents.leaderboard.tracks import keywords
from agents.metrics import episode_metrics, make_batch, record
from agents.tuned import parameters_of

REACH = "FlexArm/OneLink-Reach-v0"
BLIND = {"frequency_ratio": 1e-6, "damping_ratio": 1e-6}  # feedback that does nothing


def played(envs: Any, subject: Any, seeds: list[int]) -> tuple[Any, Any]:
    """(T, N, m) torques of a controller and what is left of the joint errors (N, m) [rad]."""
    base = envs.unwrapped
    observation, _ = envs.reset(seed=seeds)
    state, torques = None, []
    for _ in range(base.core.max_steps - 1):
        action, state = subject.predict(observation, state, np.zeros(len(seeds), bool))
        torques.append(action * base.torque_limit)
        observation = envs.step(action.astype(np.float32))[0]
    part = base.observation_slices["joint_error"]
    return np.array(torques), observation[:, part] * base.observation_scales["joint_error"]


def test_torques_fed_forward_move_the_inertia_to_the_target() -> None:
    """Without feedback: torque adds up to no rate, and twice integrated to the move times J."""
    envs = make_batch(REACH, 3, {"obs": "state"})
    model, dt = envs.unwrapped.model, envs.unwrapped.control_dt
    observation, _ = envs.reset(seed=[1, 2, 3])
    at = envs.unwrapped.observation_slices["joint_error"]
    move = -observation[:, at] * envs.unwrapped.observation_scales["joint_error"]
    torques, left = played(envs, InverseDynamics(envs, **BLIND, load=0.3), [1, 2, 3])
    inertia = model.mass_matrix(np.zeros(model.n))[0, 0]
    rate = np.cumsum(torques, axis=0) * dt / inertia
    assert rate[-1] == pytest.approx(np.zeros((3, 1)), abs=1e-6)
    assert rate.sum(axis=0) * dt == pytest.approx(move, rel=1e-3)
    assert np.abs(left).max() < 0.05 * np.abs(move).min()


@pytest.mark.parametrize(("scene", "track"), [("OneLink", "state"), ("TwoLink", "laboratory")])
def test_bent_links_are_expected_on_a_path(scene: str, track: str) -> None:
    """Tuned by as many trials, joint PD has five times the RMS tip error."""
    env_id, found = f"FlexArm/{scene}-Track-v0", {}
    for name in ("inverse", "pd"):
        envs = make_batch(env_id, 16, keywords(name, track))
        subject = controller(name, envs, parameters_of(name, env_id, track))
        found[name] = np.median(episode_metrics(record(subject, envs, range(16)))["tip_error_rms"])
    assert 5.0 * found["inverse"] < found["pd"]


def test_the_plan_bends_the_links_as_the_environment_does() -> None:
    """Without feedback, far below the first frequency: joints run ahead of the tip as planned."""
    envs = make_batch(REACH, 1, {"obs": "state"})
    base, subject = envs.unwrapped, InverseDynamics(envs, **BLIND, load=0.05)
    at, scale = base.observation_slices["joint_error"], base.observation_scales["joint_error"]
    observation, _ = envs.reset(seed=[1])
    state, gaps, tips = None, [], []
    for _ in range(base.core.max_steps // 2):
        action, state = subject.predict(observation, state, np.zeros(1, bool))
        error, left = (observation[:, at] * scale)[0, 0], state.plan.remaining_error
        gaps.append([error - left[0, 0], (state.offset - left)[0, 0]])
        observation, _, _, _, info = envs.step(action.astype(np.float32))
        tips.append(info["tip_deflection"][0])
    true, planned = np.array(gaps).T
    assert np.abs(planned).max() * base.reach == pytest.approx(max(tips), rel=0.2)
    assert np.abs(true - planned).max() < 0.3 * np.abs(planned).max()


def test_feedback_is_joint_pd_about_the_plan() -> None:
    """At the end of a plan nothing is left of it but joint PD about the target."""
    envs = make_batch("FlexArm/TwoLink-Reach-v0", 2, {"obs": "sensors"})
    gains = {"frequency_ratio": 0.2, "damping_ratio": 0.7}
    subject, pd = InverseDynamics(envs, **gains, load=0.5), joint_pd(envs, *gains.values())
    observation, _ = envs.reset(seed=[1, 2])
    state, fresh = None, np.ones(2, bool)
    for _ in range(240):
        action, state = subject.predict(observation, state, fresh)
        fresh[:] = False
    assert action == pytest.approx(pd.predict(observation)[0])
    again, _ = subject.predict(observation, state, np.ones(2, bool))
    assert again == pytest.approx(subject.predict(observation)[0])
    assert np.abs(again).max() < 0.2 * np.abs(action).max()  # a plan begins slowly


def test_joints_that_turn_as_planned_are_not_damped() -> None:
    """The planned rate is that of the bent plan's angles; any other rate is damped."""
    envs = make_batch(REACH, 1, {"obs": "state"})
    base, blind = envs.unwrapped, InverseDynamics(envs, **BLIND, load=0.3)
    damping = InverseDynamics(envs, frequency_ratio=1e-6, damping_ratio=3e5, load=0.3)
    x, state, other, before = envs.reset(seed=[1])[0].astype(float), None, None, None
    for _ in range(20):
        wanted, state = blind.predict(x, state, np.zeros(1, bool))
        rate = 0.0 if before is None else (state.offset - before) / base.control_dt
        before = state.offset
        x[:, base.observation_slices["joint_rate"]] = rate / base.observation_scales["joint_rate"]
        found, other = damping.predict(x, other, np.zeros(1, bool))
        assert found == pytest.approx(wanted, abs=1e-6)
    x[:, base.observation_slices["joint_rate"]] += 0.01
    assert damping.predict(x, other, np.zeros(1, bool))[0] < found - 1e-3
