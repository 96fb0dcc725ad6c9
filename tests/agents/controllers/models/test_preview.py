"""Torques that a path will need, against the environment's own target later on."""

from dataclasses import astuple
from typing import Any

import numpy as np
import pytest

from agents.controllers import controller
from agents.controllers.models.linear_model import LinearModels
from agents.controllers.models.plan import Planner
from agents.controllers.models.preview import Preview
from agents.controllers.models.reference import Course, Reference
from agents.metrics import episode_metrics, make_batch, record

TRACK = "FlexArm/TwoLink-Track-v0"
EPISODES = 4


def watched(steps: int, times: Any) -> tuple[Any, list[Any], list[Any], list[Any]]:
    """Preview, and what it sees, plans and the environment's targets after every step."""
    envs = make_batch(TRACK, EPISODES, {"obs": "state"})
    models = LinearModels.of(envs)
    planner, preview = Planner(envs, models), Preview(envs, models, times)
    observation, _ = envs.reset(seed=list(range(EPISODES)))
    plans: list[Any] = [None]
    seen: list[Any] = [None]
    targets = []
    for k in range(steps):
        fresh = np.full(EPISODES, k == 0)
        plans.append(planner.follow(observation, plans[-1], fresh))
        seen.append(preview.see(observation, plans[-1].target, seen[-1], fresh))
        targets.append(envs.unwrapped.joint_target().copy())
        observation = envs.step(np.zeros((EPISODES, 2), np.float32))[0]
    return preview, seen[1:], plans[1:], targets


@pytest.mark.parametrize("start", [32, 60])
def test_torques_ahead_are_those_of_the_path_later_on(start: int) -> None:
    """From half a move time on, against the reference's own torques, which it extrapolates."""
    steps = np.array([1, 5, 12, 20, 31, 50])
    preview, seen, plans, _ = watched(start + 53, 0.05 * (steps + 0.5))
    reference = Reference(preview.models, [preview.models.middle])
    middle = np.full(EPISODES, preview.models.middle)
    for i, found in enumerate(preview.torques(plans[start].target, seen[start], middle)):
        later = [reference.along(plans[start + k].target)[1][i, 0] for k in steps]
        assert np.abs(found - later).max() < 0.05 * np.abs(later).max()


@pytest.mark.parametrize(("start", "accuracy"), [(0, 0.05), (32, 1e-4), (60, 1e-4)])
def test_the_path_is_that_of_the_target(start: int, accuracy: float) -> None:
    """At the start two angles of it are known, later all of the coming move time."""
    steps = np.array([1, 5, 12, 20, 31, 50, 60])
    preview, seen, plans, targets = watched(start + 61, np.array([0.5]))
    way = np.array(targets) - targets[0]
    path = preview._path(plans[start].target, seen[start], np.arange(EPISODES))
    assert np.abs(path(0.05 * steps) - way[start + steps]).max() < accuracy


def test_beyond_what_is_seen_the_target_goes_on_evenly() -> None:
    """A constant rate needs the torque of the turning arm, and none of its acceleration."""
    times = np.array([2.0, 4.0])  # in and beyond a move time of 3.05 s
    preview, seen, plans, _ = watched(40, times)
    middle = np.full(EPISODES, preview.models.middle)
    found = preview.torques(plans[-1].target, seen[-1], middle)[0]
    path = preview._path(plans[-1].target, seen[-1], np.array([0]))
    end, rate = path(path.x[-1])[0], path(path.x[-1], 1)[0]
    model, joints = preview.models.model, preview.models.joints
    q, v = np.zeros((2, 1, model.n))
    q[0, joints] = plans[-1].target.posture[0] + end + (4.0 - path.x[-1]) * rate
    v[0, joints] = rate
    expected = model.inverse_dynamics(q, v, np.zeros_like(q))[0, joints]
    assert found[1] == pytest.approx(expected)
    assert np.abs(found[0]).max() > 2.0 * np.abs(found[1]).max()


def test_episodes_of_any_age_and_plant_are_served_together_as_alone() -> None:
    """Plants differ in payload; two of four episodes have just begun."""
    envs = make_batch(TRACK, 4, {"obs": "sensors", "hardware": "laboratory"})
    models = LinearModels.of(envs)
    planner, preview = Planner(envs, models), Preview(envs, models, np.array([0.1, 0.4, 0.9]))
    observation, _ = envs.reset(seed=list(range(4)))
    plan, seen = None, None
    for k in range(6):
        fresh = np.array([k == 0, k in (0, 4), k == 0, k in (0, 4)])
        plan = planner.follow(observation, plan, fresh)
        seen = preview.see(observation, plan.target, seen, fresh)
        observation = envs.step(np.zeros((4, 2), np.float32))[0]
    assert plan is not None
    count = len(models.plants)
    plants = np.array([0, count - 1, count // 2, 0])
    together = preview.torques(plan.target, seen, plants)
    for i, plant in enumerate(plants):
        one = Course(*(x[i : i + 1] for x in astuple(plan.target)))
        alone = preview.torques(one, seen[i : i + 1], np.array([plant]))
        assert together[i] == pytest.approx(alone[0], abs=1e-9)
        other = preview.torques(one, seen[i : i + 1], np.array([(plant + count // 2) % count]))
        assert np.abs(other - alone).max() > 1e-3 * np.abs(alone).max()


def test_an_episode_that_starts_remembers_no_other_path() -> None:
    preview, seen, plans, _ = watched(10, np.array([0.5]))
    x = np.zeros((EPISODES, sum(part.stop - part.start for part in preview.read.slices.values())))
    after = preview.see(x, plans[-1].target, seen[-1], np.array([True, False, False, False]))
    assert np.isfinite(after[0, :, 0, 0]).sum() == 1
    assert np.isfinite(after[1, :, 0, 0]).sum() == 11


def test_a_control_step_may_be_longer_than_half_a_move() -> None:
    """The two angles that are shown are the path."""
    envs = make_batch("FlexArm/OneLink-Track-v0", 1, {"obs": "state", "control_dt": 0.4})
    models = LinearModels.of(envs)
    preview, planner = Preview(envs, models, np.array([0.5])), Planner(envs, models)
    observation, _ = envs.reset(seed=0)
    fresh = np.ones(1, bool)
    target = planner.follow(observation, None, fresh).target
    path = preview._path(target, preview.see(observation, target, None, fresh), np.array([0]))
    near, far = (preview.read(observation, f"target_{name}")[0] for name in ("near", "far"))
    assert path([preview.half, 2.0 * preview.half])[:, 0] == pytest.approx(np.array([near, far]))


def test_nothing_is_seen_of_a_resting_target() -> None:
    envs = make_batch("FlexArm/TwoLink-Reach-v0", 2, {"obs": "state"})
    models = LinearModels.of(envs)
    preview, planner = Preview(envs, models, np.array([0.1, 0.2])), Planner(envs, models)
    observation, _ = envs.reset(seed=0)
    target = planner.follow(observation, None, np.ones(2, bool)).target
    seen = preview.see(observation, target, None, np.ones(2, bool))
    assert seen.size == 0
    assert preview.torques(target, seen, np.zeros(2, int)) == pytest.approx(np.zeros((2, 2, 2)))


def test_predictive_control_prepares_for_torques_that_it_will_lack() -> None:
    """The payload is too heavy for the paths; LQG, with the same weights, is farther off."""
    kwargs = {"obs": "sensors", "hardware": {"payload": (0.75, 0.75)}}
    envs, found = make_batch("FlexArm/OneLink-Track-v0", 16, kwargs), {}
    weights = {"effort": 0.1, "lead": 0.02, "disturbance": 0.1}
    for name, more in (("lqg", {"clip": 10.0}), ("mpc-kalman", {"horizon": 1.0, "margin": 1.0})):
        motions = record(controller(name, envs, weights | more), envs, range(16))
        found[name] = episode_metrics(motions)["tip_error_rms"]
    assert np.quantile(found["lqg"], 0.75) > 0.01 * envs.unwrapped.reach
    assert np.quantile(found["mpc-kalman"], 0.75) < 0.7 * np.quantile(found["lqg"], 0.75)
