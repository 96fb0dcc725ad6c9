"""Nonlinear predictive control against the linear models, LQR and SciPy."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, minimize

from agents.controllers import nmpc
from agents.controllers.lqr import Cost, Gain, regulator
from agents.controllers.models.linear_model import LinearModels
from agents.controllers.observers.exact import Estimate
from agents.metrics import episode_metrics, make_batch, record

DAMP, AGILE = "FlexArm/SixLink-Damp-v0", "FlexArm/OneLink-ReachAgile-v0"
TWO = "FlexArm/TwoLink-Reach-v0"
FINE = {"obs": "state", "integrator": "rk4", "substeps": 400}
WEIGHTS = {"effort": 1.0, "lead": 0.1}


def law_of(envs: Any, effort: float = 1.0) -> nmpc.Nonlinear:
    cost = Cost(envs, LinearModels.of(envs), effort=effort, lead=0.1)
    return nmpc.Nonlinear(envs, cost, horizon=0.5, margin=0.9)


def about(law: nmpc.Nonlinear, posture: Any, scale: float, count: int) -> list[Estimate]:
    """Estimates whose joints are off by `scale` [rad], at rest."""
    models, rng = law.cost.models, np.random.default_rng(0)
    model, found = models.at(np.array(posture)), []
    for _ in range(count):
        place = np.zeros(models.model.n)
        place[models.joints] = scale * rng.uniform(-1.0, 1.0, len(models.joints))
        x = np.concatenate([model.modes @ place, np.zeros(len(model.modes))])
        found.append(Estimate(model, x, np.zeros(law.limit.size), np.empty((0, law.limit.size))))
    return found


@pytest.mark.parametrize("plant", [0, -1])
def test_a_resting_motion_is_linearized_as_the_linear_model_has_it(plant: int) -> None:
    """Differences of finely integrated control steps against the exponential of the matrices."""
    law = law_of(make_batch(TWO, 1, FINE | {"hardware": "laboratory", "obs": "sensors"}))
    models, m = law.cost.models, law.limit.size
    model = models.at(np.array([0.0, 0.7]), range(len(models.plants))[plant])
    scene = law._scene([Estimate(model, np.zeros(len(model.A)), np.zeros(m), np.empty((0, m)))])
    none = np.zeros((law.steps, 1, 1, m))
    A, B = law._linearized(scene, law._open_loop(scene, none, none, np.zeros(1)), 0)
    scaled = model.B * law.limit
    for k in (0, law.steps - 1):
        np.testing.assert_allclose(A[k].T, model.A, atol=1e-5 * np.abs(model.A).max())
        np.testing.assert_allclose(B[k].T, scaled, atol=1e-5 * np.abs(scaled).max())


def problem(rng: Any, size: int = 12, rows: int = 4) -> tuple[Any, ...]:
    root = rng.normal(size=(size, size))
    least, most = -rng.uniform(0.5, 1.0, size), rng.uniform(0.5, 1.0, size)
    bent, bending = 0.2 * rng.normal(size=rows), rng.normal(size=(rows, size))
    return root @ root.T + np.eye(size), 30.0 * rng.normal(size=size), least, most, bent, bending


def test_changes_are_those_that_scipy_finds() -> None:
    """Within limits of torque and of bending, most of which are active somewhere."""
    rng, margin, held = np.random.default_rng(0), 0.6, np.zeros(2)
    for _ in range(10):
        curvature, slope, least, most, bent, bending = problem(rng)
        found = nmpc._solved(margin, curvature, slope, least, most, bent, bending)
        expected = minimize(
            lambda d, H, f: (d @ (f + 0.5 * H @ d), f + H @ d), 0.0 * slope, (curvature, slope),
            jac=True, method="SLSQP", bounds=Bounds(least, most), options={"ftol": 1e-12},
            constraints=LinearConstraint(bending, -margin - bent, margin - bent),
        ).x  # fmt: skip
        np.testing.assert_allclose(found, expected, atol=1e-4)
        bound = np.abs(bent + bending @ found) > margin - 1e-6
        held += np.sum((found == least) | (found == most)), np.sum(bound)
    assert np.all(held > 5)


def test_bending_yields_where_torques_cannot_keep_it() -> None:
    """A link that is bent too far cannot be straightened within the limits of torque."""
    curvature, slope, least, most, bent, bending = problem(np.random.default_rng(0))
    bent[0] = 50.0
    found = nmpc._solved(0.6, curvature, slope, least, most, bent, bending)
    assert np.all((found >= least) & (found <= most))
    furthest = np.where(bending[0] > 0.0, least, most)
    assert found == pytest.approx(furthest)


def test_a_program_without_a_solution_changes_nothing() -> None:
    curvature, slope, least, most, bent, bending = problem(np.random.default_rng(0))
    found = nmpc._solved(0.6, curvature, slope, most, least, bent, bending)  # contradictory limits
    assert found == pytest.approx(0.0 * slope, abs=0.0)


@pytest.mark.parametrize("effort", [1.0, 1e3])
def test_near_the_target_one_step_leads_from_no_torques_to_those_of_lqr(effort: float) -> None:
    """There the arm is linear, no limit binds, and LQR is the optimum."""
    law = law_of(make_batch(TWO, 1, FINE), effort)
    law.blocks = np.arange(law.steps)
    estimates = about(law, [0.0, 0.7], 1e-5, 4)
    scene, none = law._scene(estimates), np.zeros((law.steps, 4, 1, law.limit.size))
    found = law._changes(scene, law._open_loop(scene, none, none, np.zeros(1)))
    best = law._closed_loop(scene)
    most = np.abs(best.action).max()
    assert most < 0.1
    np.testing.assert_allclose(found, best.action, atol=0.002 * most)
    np.testing.assert_allclose(law._changes(scene, best), 0.0, atol=0.002 * most)
    x, later = scene.x[:, 0], scene.P - scene.Q
    cost_to_go = np.einsum("ia,iab,ib->i", x, later, x)
    np.testing.assert_allclose(law._costs(scene, best)[:, 0], cost_to_go, rtol=1e-3)
    np.testing.assert_allclose(law(estimates), Gain(law.cost)(estimates), atol=0.002 * most)


def test_a_motion_costs_less_than_that_of_lqr_where_torques_are_limited() -> None:
    """Six links far from the target, whose twelve integration steps are linearized as one."""
    law = law_of(make_batch(DAMP, 1, {"obs": "state"}))
    estimates = about(law, [0.0, 0.4, -0.3, 0.2, 0.1, 0.3], 1.5, 4)
    scene = law._scene(estimates)
    first = law._closed_loop(scene)
    again = law._open_loop(scene, first.action, first.action, np.zeros(1))
    np.testing.assert_allclose(again.x, first.x, rtol=1e-9, atol=1e-12)
    changes = law._changes(scene, first)
    assert np.abs(first.action + changes).max() <= 1.0 + 1e-9
    assert (law.steppers(1).substeps, law.coarse(1).substeps) == (12, 1)
    tried = law._open_loop(scene, first.action, changes, nmpc.SHARES)
    costs = law._costs(scene, tried)
    assert np.all(costs.min(axis=1) < law._costs(scene, first)[:, 0])
    best = costs.argmin(axis=1)
    assert len(set(best)) > 1
    np.testing.assert_array_equal(law(estimates), law.limit * tried.action[0, np.arange(4), best])


def test_where_every_change_costs_more_the_torque_is_that_of_lqr(monkeypatch: Any) -> None:
    law = law_of(make_batch(DAMP, 1, {"obs": "state"}))
    estimates = about(law, np.zeros(6), 1e-4, 2)
    monkeypatch.setattr(law, "_changes", lambda scene, moved: np.ones_like(moved.action))
    expected = np.clip(Gain(law.cost)(estimates), -law.limit, law.limit)
    np.testing.assert_allclose(law(estimates), expected)


def test_estimates_are_served_alike_side_by_side_and_alone() -> None:
    """Of two postures and plants."""
    law = law_of(make_batch(DAMP, 1, {"obs": "sensors", "hardware": "laboratory"}))
    estimates = about(law, [0.0, 0.4, -0.3, 0.2, 0.1, 0.3], 0.3, 2)
    other = law.cost.models.at(np.zeros(6), 0)
    estimates.append(Estimate(other, estimates[0].x, estimates[0].forward, estimates[0].ahead))
    alone = np.array([law([estimate])[0] for estimate in estimates])
    np.testing.assert_allclose(law(estimates), alone, atol=1e-6 * law.limit.max())
    assert np.abs(alone[0] - alone[2]).max() > 0.01 * law.limit.max()


def test_where_every_motion_diverges_the_torque_is_that_of_lqr() -> None:
    law = law_of(make_batch(DAMP, 1, {"obs": "state"}))
    estimates = about(law, np.zeros(6), 1e150, 2)
    scene = law._scene(estimates)
    first = law._closed_loop(scene)
    assert not first.whole.any()
    assert np.all(law._costs(scene, first) == np.inf)
    expected = np.clip(Gain(law.cost)(estimates), -law.limit, law.limit)
    np.testing.assert_allclose(law(estimates), expected)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_where_costs_overflow_nothing_warns() -> None:
    law = law_of(make_batch(AGILE, 1, {"obs": "state"}))
    assert np.isfinite(law(about(law, np.zeros(1), 1e158, 2))).all()


def test_motions_that_overflow_cost_infinitely_much_and_are_not_changed() -> None:
    """Terms of both signs add up to infinity less infinity; the solver gets no such program."""
    law = law_of(make_batch(AGILE, 1, {"obs": "state"}))
    scene = law._scene(about(law, np.zeros(1), 0.1, 1))
    moved = law._closed_loop(scene)
    moved.x = 1e308 * np.random.default_rng(0).choice([-1.0, 1.0], moved.x.shape)
    with np.errstate(over="ignore", invalid="ignore"):
        assert law._costs(scene, moved) == np.inf
        np.testing.assert_array_equal(law._changes(scene, moved), 0.0)


def test_links_bend_no_further_than_the_share_of_their_limit() -> None:
    """At three times the torque the blind law breaks the limit, and the plan stays within it."""
    envs = make_batch(AGILE, 16, {"obs": "state"})
    core, found = envs.unwrapped.core, {}
    for margin in (0.6, 0.8):
        run = record(
            nmpc.nonlinear(envs, "nmpc", **WEIGHTS, horizon=0.6, margin=margin), envs, range(16)
        )
        assert not run.failed.any()
        assert episode_metrics(run)["success"].all()
        length = core.arm.links[0].length
        found[margin] = np.nanmax(run.tip_deflection) / (
            core.arguments["deflection_limit"] * length
        )
    assert found[0.6] == pytest.approx(0.6, abs=0.06)
    assert found[0.8] == pytest.approx(0.8, abs=0.06)


def test_six_links_settle_sooner_than_with_lqr() -> None:
    envs = make_batch(DAMP, 6, {"obs": "state"})
    subjects = (
        nmpc.nonlinear(envs, "nmpc", **WEIGHTS, horizon=1.0, margin=0.7),
        regulator(envs, "lqr", **WEIGHTS, clip=1.0),
    )
    ours, linear = (
        episode_metrics(record(subject, envs, range(6)))["score"].mean() for subject in subjects
    )
    assert ours > linear + 0.05
