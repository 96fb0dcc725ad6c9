"""Predictive control against LQR where no limit binds, and against its limits where they do."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from agents.controllers import controller, mpc
from agents.controllers.lqr import Cost, Gain, riccati
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


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"lead": 1e30}, r"effort \(1\) and lead \(1e\+30\) leave .* without a solution; take"),
        ({"effort": 1e30}, r"effort \(1e\+30\) and lead \(0.1\) leave"),
        ({"horizon": 1e9}, r"horizon must be at most \d+(\.\d)? here, .* got 1e\+09"),
    ],
)
@pytest.mark.parametrize("name", ["mpc", "nmpc"])
def test_parameters_with_which_nothing_can_be_computed_are_refused_at_once(
    name: str, given: dict[str, float], sentence: str
) -> None:
    usual = {"effort": 1.0, "lead": 0.1, "horizon": 0.5, "margin": 0.9}
    with pytest.raises(ValueError, match=sentence):
        controller(name, make_batch(REACH, 1, {"obs": "state"}), usual | given)


def test_without_active_limits_the_plan_begins_as_lqr(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost-to-go behind the horizon is LQR's, so the horizon does not matter."""
    monkeypatch.setattr(mpc, "BLOCKS", (1,))
    plan, gain, models = laws(REACH)
    model = models.at(np.zeros(1))
    for x in np.random.default_rng(0).normal(size=(5, len(model.A))):
        x *= 0.01 * plan.cost.limit / np.abs(gain.of(model)[0] @ x)
        estimate = steady(plan, model, x, np.zeros(1))
        assert plan([estimate]) == pytest.approx(gain([estimate]), rel=1e-6)


def root(matrix: Any) -> Any:
    """C with C'C = matrix, which may be singular."""
    values, vectors = np.linalg.eigh(matrix)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def test_the_plan_costs_least_of_all_within_the_limits_of_torque() -> None:
    """By SciPy's bounded least squares, on costs of simulated motions; most torques are limited."""
    plan, _, models = laws("FlexArm/TwoLink-Reach-v0", margin=1e3)
    model = models.at(np.array([0.3, -0.4]))
    (Q, R), limit = plan.cost.of(model), plan.cost.limit
    P = riccati(model.A, model.B, Q, R)
    count = limit.size * (plan.blocks[-1] + 1)

    def residuals(x: Any, actions: Any) -> Any:
        """Whose squares are the cost, along a motion."""
        found = []
        for block in plan.blocks:
            torque = limit * actions.reshape(-1, limit.size)[block]
            x = model.A @ x + model.B @ torque
            found += [np.sqrt(R) @ torque, root(Q) @ x]
        found[-1] = root(P) @ x
        return np.concatenate(found)

    far = np.concatenate([model.modes.sum(axis=1), np.zeros(len(model.A) // 2)])
    for size in (0.02, 0.1, 0.3):
        none = residuals(size * far, np.zeros(count))
        rows = np.array([residuals(0.0 * far, one) for one in np.eye(count)]).T
        found = lsq_linear(rows, -none, (-1.0, 1.0), method="bvls", tol=1e-14).x
        (torque,) = plan([steady(plan, model, size * far, 0.0 * limit)])
        assert torque == pytest.approx(
            limit * found[: limit.size], rel=1e-4, abs=1e-5 * limit.max()
        )


def test_a_torque_does_not_depend_on_what_was_solved_before() -> None:
    """Alone in a new controller, or after others whose limits were active."""
    near, far = (size * np.arange(1.0, 5.0) for size in (0.01, -0.4))
    for env_id in (REACH, AGILE):
        (plan, _, models), (other, _, _) = laws(env_id), laws(env_id)
        model = models.at(np.zeros(1))
        estimates = [
            steady(plan, model, np.resize(x, len(model.A)), np.zeros(1)) for x in (near, far)
        ]
        after = [plan(estimates[::-1])[1], plan(estimates)[0]]
        assert after == pytest.approx(np.tile(other(estimates[:1]), (2, 1)), rel=1e-9)


def test_a_far_target_takes_the_torque_that_is_left() -> None:
    plan, _, models = laws(REACH)
    model = models.at(np.zeros(1))
    limit = plan.cost.limit
    far = model.modes @ np.eye(models.model.n)[models.joints[0]]
    x = np.concatenate([-far, 0.0 * far])
    for forward in (-0.5, 0.0, 0.5):
        found = plan([steady(plan, model, x, forward * limit)])
        assert np.all(np.abs(found) <= (1.0 + 1e-9) * limit)
    (found,) = plan([steady(plan, model, x, 0.0 * limit)])
    assert found == pytest.approx(limit, rel=1e-9)


def test_bending_beyond_its_share_is_undone_alike_on_both_sides() -> None:
    """It cannot be undone within a control step, so the program must let it be."""
    plan, _, models = laws(REACH, margin=0.1)
    model = models.at(np.zeros(1))
    bent = np.zeros(len(model.A))
    rows = model.bend[np.any(model.bend, axis=1)]
    bent[: len(model.A) // 2] = np.linalg.pinv(rows)[:, 0] * 0.6 * plan.deflection_limit
    found = [plan([steady(plan, model, sign * bent, np.zeros(1))]).item() for sign in (1.0, -1.0)]
    assert found[0] == pytest.approx(-found[1], rel=1e-6)
    free, _, _ = laws(REACH, margin=1e3)
    unbound = free([steady(free, model, bent, np.zeros(1))]).item()
    assert abs(found[0] - unbound) > 0.1 * plan.cost.limit.item()


@pytest.mark.parametrize("absurd", [np.nan, np.inf, 1e58])
def test_a_state_that_the_solver_would_refuse_in_silence_is_an_error(absurd: float) -> None:
    plan, _, models = laws(REACH)
    model = models.at(np.zeros(1))
    x = np.full(len(model.A), absurd)
    with pytest.raises(FloatingPointError, match="observer, which has diverged"):
        plan([steady(plan, model, x, np.zeros(1))])


def test_arms_of_a_batch_are_decided_as_each_alone() -> None:
    """Their references' torques differ, and two arms have one program."""
    plan, _, models = laws("FlexArm/TwoLink-Reach-v0")
    random, size = np.random.default_rng(0), plan.cost.limit.size
    estimates = []
    for angle in (0.0, 0.5, 0.5):
        model = models.at(np.full(size, angle))
        x = 3e-4 * random.normal(size=len(model.A))
        ahead = plan.cost.limit * random.uniform(-1.0, 1.0, (plan.blocks[-1], size))
        estimates.append(Estimate(model, x, 0.1 * ahead[0], ahead))
    together = plan(estimates)
    assert np.all(np.abs(together) < plan.cost.limit)
    for estimate, torques in reversed(list(zip(estimates, together, strict=True))):
        assert np.array_equal(plan([estimate])[0], torques)


def test_a_program_that_the_solver_gives_up_is_an_error() -> None:
    plan, gain, models = laws(REACH)
    model = models.at(np.zeros(1))
    x = np.ones(len(model.A))
    x *= 100.0 * plan.cost.limit / np.abs(gain.of(model)[0] @ x)
    far = steady(plan, model, x, np.zeros(1))
    assert np.abs(plan([far])[0]) == pytest.approx(plan.cost.limit)
    plan._program(model).solver.settings = {"iter_limit": 1}
    with pytest.raises(FloatingPointError, match="exit flag -4 of DAQP"):
        plan([far])


def test_links_bend_no_further_than_the_share_of_their_limit() -> None:
    """At three times the torque the blind law breaks the limit, and the plan stays within it."""
    envs = make_batch(AGILE, 16, {"obs": "state"})
    limit = envs.unwrapped.core.arguments["deflection_limit"]
    found = {}
    for margin in (0.6, 0.8):
        subject = mpc.predictive(envs, "mpc", effort=1.0, lead=0.1, horizon=0.6, margin=margin)
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
    subject = mpc.predictive(lab, "mpc-kalman", **weights, disturbance=0.01)
    assert record(subject, envs, range(32)).failed.mean() < 0.1
    subject.observer.caution = 0.0
    assert record(subject, envs, range(32)).failed.mean() > 0.3
