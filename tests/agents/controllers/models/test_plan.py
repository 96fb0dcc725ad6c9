"""Planned moves, against the torques and the bending that they cause."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import controller
from agents.controllers.models.linear_model import LinearModels
from agents.controllers.models.plan import Plan, TimedMoves
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import Reference
from agents.leaderboard.tracks import keywords
from agents.metrics import episode_metrics, make_batch, record

REACH, AGILE, TRACK = (
    f"FlexArm/{name}-v0" for name in ("TwoLink-Reach", "OneLink-ReachAgile", "OneLink-Track")
)


def planned(
    env_id: str, load: float, steps: int, **kwargs: Any
) -> tuple[Any, TimedMoves, list[Plan]]:
    """Environment, planner, and its plans while the arm rests at its start."""
    envs = make_batch(env_id, 3, {"obs": "state", **kwargs})
    planner = TimedMoves(envs, LinearModels.of(envs), load)
    observation, _ = envs.reset(seed=[1, 2, 3])
    plans: list[Any] = [None]
    for k in range(steps):
        plans.append(planner.follow(observation, plans[-1], np.full(3, k == 0)))
    return envs, planner, plans[1:]


@pytest.mark.parametrize(
    ("env_id", "kwargs"), [(REACH, {}), (AGILE, {}), (AGILE, {"deflection_limit": 0.05})]
)
def test_a_move_takes_its_share_of_torque_or_of_bending(
    env_id: str, kwargs: dict[str, Any]
) -> None:
    """Along the plan one of them reaches the share, and none goes beyond it."""
    load = 0.7
    envs, planner, plans = planned(env_id, load, 200, **kwargs)
    base, models = envs.unwrapped, planner.models
    reference, most = Reference(models, [models.middle]), np.zeros(3)
    for plan in plans:
        offset, torque = (part[:, 0] for part in reference.along(plan.motion))
        torques = np.abs(torque / base.torque_limit).max(axis=1)
        bent = np.abs(offset @ models.bends.T).max(axis=1) / base.core.arguments["deflection_limit"]
        most = np.maximum(most, np.maximum(torques, bent))
    assert most == pytest.approx(load, rel=0.03)


def test_a_plan_leads_smoothly_to_the_target() -> None:
    """Rates are the slopes of angles, accelerations those of rates; nothing is left at the end."""
    _, planner, plans = planned(REACH, 0.5, 300)
    dt = planner.models.control_dt
    way, rate, acceleration = (
        np.array([getattr(plan.motion, name) for plan in plans])
        for name in ("way", "rate", "acceleration")
    )
    assert np.abs(plans[0].remaining_error).min() > 0.25
    assert not plans[-1].remaining_error.any()
    assert np.gradient(way, dt, axis=0)[1:-1] == pytest.approx(rate[1:-1], abs=2e-3)
    assert np.diff(rate, axis=0) / dt == pytest.approx(acceleration[1:])
    coming = np.array([plan.motion.coming for plan in plans])
    assert coming[:-1] == pytest.approx(acceleration[1:])


def test_a_move_of_one_link_takes_the_root_of_its_share_of_the_time() -> None:
    envs = make_batch(AGILE, 1, {"obs": "state"})
    slow, fast = (TimedMoves(envs, LinearModels.of(envs), load) for load in (0.1, 0.4))
    still = np.zeros(1)
    whole = slow.time(still, np.array([0.8]))
    assert whole == pytest.approx(2.0 * slow.time(still, np.array([-0.2])))
    assert whole == pytest.approx(2.0 * fast.time(still, np.array([0.8])))
    assert slow.time(still, still) == 0.0


def test_nothing_is_planned_where_joints_start_on_the_target() -> None:
    _, _, plans = planned(TRACK, 0.5, 2)
    assert plans[0].remaining_error == pytest.approx(0.0, abs=1e-6)
    assert plans[1].motion.rate == pytest.approx(plans[1].target.rate, abs=1e-6)


def test_an_episode_that_starts_gets_its_own_plan() -> None:
    envs, planner, plans = planned(REACH, 0.5, 40)
    observation, _ = envs.reset(seed=[7, 8, 9])
    mixed = planner.follow(observation, plans[-1], np.array([False, True, False]))
    alone = planner.follow(observation, None, np.ones(3, bool))
    assert mixed.remaining_error[1] == pytest.approx(alone.remaining_error[1])
    assert mixed.rise[1] == alone.rise[1]
    assert mixed.rise[[0, 2]] == pytest.approx(plans[-1].rise[[0, 2]])
    assert list(mixed.steps) == [40.0, 0.0, 40.0]


@pytest.mark.parametrize("track", ["state", "laboratory"])
def test_a_plan_ends_in_control_about_the_target(track: str) -> None:
    """At the end actions are those of LQR or LQG without a plan, whose clip is wide."""
    name = "lqr" if track == "state" else "lqg"
    weights = {"effort": 10.0, "lead": 0.2} | ({"disturbance": 0.1} if name == "lqg" else {})
    envs = make_batch(REACH, 4, keywords(name, track))
    subject = controller(f"{name}-planned", envs, weights | {"load": 0.5})
    plain: Any = controller(name, envs, weights | {"clip": 100.0})
    motion = record(subject, envs, range(4))
    assert episode_metrics(motion)["success"].all()
    observation, _ = envs.reset(seed=list(range(4)))
    state, other, apart = None, None, []
    for k in range(300):
        fresh = np.full(4, k == 0)
        action, state = subject.predict(observation, state, fresh)
        same, other = plain.predict(observation, other, fresh)
        if name == "lqg":
            other = plain.told(other, action)
        apart.append(np.abs(action - same).max())
        observation = envs.step(action.astype(np.float32))[0]
    assert apart[0] > 0.3
    assert np.max(apart[-30:]) < 1e-3


def test_rates_about_a_plan_are_the_slopes_of_places_about_it() -> None:
    """With exact states, while LQR holds the arm on the plan."""
    envs = make_batch("FlexArm/OneLink-Reach-v0", 4, {"obs": "state"})
    subject: Any = controller("lqr-planned", envs, {"effort": 1.0, "lead": 0.2, "load": 0.8})
    observation, _ = envs.reset(seed=0)
    state, found = None, []
    for k in range(40):
        fresh = np.full(4, k == 0)
        estimates, _ = subject.observer.observe(observation, state, fresh)
        found.append([estimate.x for estimate in estimates])
        action, state = subject.predict(observation, state, fresh)
        observation = envs.step(action.astype(np.float32))[0]
    x = np.array(found)  # (steps, N, 2 r)
    places, rates = np.split(x, 2, axis=2)
    slopes = (places[2:] - places[:-2]) / (2.0 * envs.unwrapped.control_dt)
    size = np.abs(rates[:, :, 0]).max()
    assert np.abs(slopes[:, :, 0] - rates[1:-1, :, 0]).max() < 0.35 * size


def test_filters_follow_the_arm_along_a_plan() -> None:
    """Tip of the estimate and its reference against the true one, while the arm is moving."""
    envs = make_batch("FlexArm/OneLink-Reach-v0", 16, keywords("lqg", "laboratory"))
    weights = {"effort": 1.0, "lead": 0.2, "disturbance": 0.1, "load": 0.8}
    subject: Any = controller("lqg-planned", envs, weights)
    core, joints = envs.unwrapped.core, subject.observer.models.joints
    read, state, found, naive = Reading.of(envs), None, [], []
    observation, _ = envs.reset(seed=0)
    for k in range(15):
        action, state = subject.predict(observation, state, np.full(16, k == 0))
        observation = envs.step(action.astype(np.float32))[0]
    estimates, state = subject.observer.observe(observation, state, np.zeros(16, bool))
    for i, estimate in enumerate(estimates):
        model, true = estimate.model, core.q[i].copy()
        true[joints] -= envs.unwrapped.joint_target()[i]
        believed = model.shapes @ estimate.x[: len(model.modes)]
        believed[joints] += state.plan.remaining_error[i]
        found.append(np.linalg.norm(model.tip_of @ (believed - true)))
        angle = read(core.outputs().obs[i], "joint_error")
        naive.append(np.linalg.norm(model.tip_of[:, joints] @ angle - model.tip_of @ true))
    assert np.median(found) < 0.3 * np.median(naive)
