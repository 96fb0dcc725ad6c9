"""Predictive control against LQR where no limit binds, and against its limits where they do."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import mpc
from agents.controllers.lqr import Cost, Gain
from agents.controllers.models.linear_model import LinearModel, LinearModels
from agents.controllers.observers.exact import Estimate
from agents.metrics import episode_metrics, make_batch, record

REACH, AGILE = "FlexArm/OneLink-Reach-v0", "FlexArm/OneLink-ReachAgile-v0"


def laws(env_id: str, margin: float = 0.9) -> tuple[Any, Any, LinearModels]:
    envs = make_batch(env_id, 1, {"obs": "state"})
    models = LinearModels.of(envs)
    cost = Cost(envs, models, effort=1.0, lead=0.2)
    return mpc.Predictive(envs, cost, horizon=0.5, margin=margin), Gain(cost, 1e9), models


def steady(plan: Any, model: LinearModel, x: Any, forward: Any) -> Estimate:
    """Estimate with a torque of the reference that stays as it is."""
    return Estimate(model, x, forward, np.tile(forward, (plan.blocks[-1], 1)))


def test_without_active_limits_the_plan_begins_as_lqr(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost-to-go behind the horizon is LQR's, so the horizon does not matter."""
    monkeypatch.setattr(mpc, "BLOCKS", (1,))
    plan, gain, models = laws(REACH)
    model = models.at(np.zeros(1))
    for x in np.random.default_rng(0).normal(size=(5, len(model.A))):
        x *= 0.1 * plan.cost.limit / np.abs(gain.of(model) @ x)
        estimate = steady(plan, model, x, np.zeros(1))
        assert plan([estimate]) == pytest.approx(gain([estimate]), rel=0.01)


def test_a_far_target_takes_the_torque_that_is_left() -> None:
    plan, _, models = laws(REACH)
    model = models.at(np.zeros(1))
    limit = plan.cost.limit
    far = model.modes @ np.eye(models.model.n)[models.joints[0]]
    x = np.concatenate([-far, 0.0 * far])
    for forward in (-0.5, 0.0, 0.5):
        found = plan([steady(plan, model, x, forward * limit)])
        assert np.all(np.abs(found) <= 1.001 * limit)
    (found,) = plan([steady(plan, model, x, 0.0 * limit)])
    assert found == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize("absurd", [np.nan, np.inf, 1e58])
def test_a_state_that_the_solver_would_refuse_in_silence_is_an_error(absurd: float) -> None:
    plan, _, models = laws(REACH)
    model = models.at(np.zeros(1))
    x = np.full(len(model.A), absurd)
    with pytest.raises(FloatingPointError, match="observer, which has diverged"):
        plan([steady(plan, model, x, np.zeros(1))])


def test_links_bend_no_further_than_the_share_of_their_limit() -> None:
    """At three times the torque the blind law breaks the limit, and the plan stays within it."""
    envs = make_batch(AGILE, 16, {"obs": "state"})
    limit = envs.unwrapped.core.arguments["deflection_limit"]
    found = {}
    for margin in (0.6, 0.8):
        subject = mpc.MPC(envs, effort=1.0, lead=0.1, horizon=0.6, margin=margin)
        run = record(subject, envs, range(16))
        assert not run.failed.any()
        assert episode_metrics(run)["success"].all()
        length = envs.unwrapped.core.arm.links[0].length
        found[margin] = np.nanmax(run.tip_deflection) / (limit * length)
    assert found[0.6] == pytest.approx(0.6, abs=0.06)
    assert found[0.8] == pytest.approx(0.8, abs=0.06)


def test_a_payload_beyond_those_of_the_laboratory_does_not_break_the_arm() -> None:
    """At three times the torque, which bends a heavy arm too far before its payload shows."""
    lab = make_batch(AGILE, 1, {"hardware": "laboratory"})
    heavy = {"preset": "laboratory", "payload": (0.6, 0.75), "stiffness": (0.8, 0.9), "delay": 3}
    envs = make_batch(AGILE, 32, {"hardware": heavy})
    weights = {"effort": 0.0034, "lead": 0.27, "horizon": 1.3, "margin": 0.65}
    subject = mpc.KalmanMPC(lab, **weights, disturbance=0.01)
    assert record(subject, envs, range(32)).failed.mean() < 0.1
    subject.observer.caution = 0.0
    assert record(subject, envs, range(32)).failed.mean() > 0.3


def test_torques_are_held_for_whole_blocks() -> None:
    assert mpc.blocks_of(9) == [0, 1, 2, 3, 4, 5, 6, 6, 7]
    assert max(np.bincount(mpc.blocks_of(60))) == mpc.BLOCKS[-1]
