"""Named scenarios: files load, wrong ones are refused, motions agree with known results."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from benchmarks.scenarios import __main__ as scenarios
from benchmarks.scenarios import file as scenario_file
from benchmarks.scenarios import motions as scenario_runs
from dynamics import ARMS, Arm
from dynamics.arms.measures import hertz
from dynamics.formulations.kinematics import outward, poses
from dynamics.model import Model
from dynamics.simulation.nominal_motion import Cycloidal, NominalTorque, stiffened
from tests.paths import ROOT

PAGE = ROOT / "docs" / "scenarios.md"
BARE: dict[str, Any] = {
    "title": "t", "about": "a", "arm": "korayem-two-link", "t_end": 1.0,
}  # fmt: skip


@pytest.mark.parametrize("name", scenarios.names())
def test_a_committed_scenario_loads_with_a_start_for_both_arms(name: str) -> None:
    scenario = scenarios.load(name)

    assert scenario.title
    assert scenario.about
    for arm in (scenario.arm, stiffened(scenario.arm)):
        q, v = scenario.start(arm)
        assert q.shape == v.shape == (arm.n - arm.base.n,)
    if scenario.torque is not None:
        assert np.shape(scenario.torque(0.5 * scenario.t_end)) == (scenario.arm.n_joint,)


def test_every_scenario_has_its_place_on_the_page() -> None:
    assert scenarios.names() == list(scenarios.ORDER)


WRONG: dict[str, tuple[Mapping[str, object], str]] = {
    "unknown key": ({"duration": 1.0}, "Unknown key 'duration' in the scenario"),
    "no such arm": ({"arm": "korayem"}, "Unknown arm 'korayem'"),
    "arm of the wrong type": ({"arm": 3}, "arm must be a preset's name"),
    "text for a number": ({"t_end": "1e1"}, "t_end .* must be a number, got the text"),
    "no duration": ({"t_end": 0.0}, "t_end must be positive"),
    "unknown coordinate": ({"initial": {"q": {"q3": 1.0}}}, "Unknown key 'q3' in initial.q"),
    "start in pieces": ({"initial": {"p": {}}}, "Unknown key 'p' in initial"),
    "no such link": ({"keep": [1, 3]}, "keep must be between 1 and 2, got 3"),
    "change of no link": ({"links": {3: {}}}, "a key of links must be between 1 and 2"),
    "unknown entry of a link": ({"links": {1: {"EI": 1.0}}}, "Unknown key 'EI' in links"),
    "heavy in the wrong way": ({"payload": {"mass": -1.0}}, "Payload.mass must not be negative"),
    "unknown torque": ({"torque": {"type": "sine"}}, "torque.type must be one of"),
    "torque without values": ({"torque": {"type": "step"}}, "torque.values is missing"),
    "torque at a mode": (
        {"torque": {"type": "ramp", "rates": {"d1_1": 1.0}}}, "Unknown key 'd1_1' in torque.rates",
    ),
    "ramp with a goal": (
        {"torque": {"type": "ramp", "rates": {}, "goal": {}}}, "Unknown key 'goal' in torque",
    ),
    "nominal from a start that moves": (
        {
            "initial": {"qd": {"q1": 1.0}},
            "torque": {"type": "nominal", "goal": {}, "duration": 1.0},
        },
        "needs a fixed base and a start at rest",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_scenario_is_refused(case: str) -> None:
    change, sentence = WRONG[case]
    with pytest.raises(ValueError, match=sentence):
        scenario_file.scenario_from_dict(BARE | change)


def test_a_missing_key_of_a_scenario_is_named() -> None:
    with pytest.raises(ValueError, match="arm is missing"):
        scenario_file.scenario_from_dict({key: BARE[key] for key in ("title", "about", "t_end")})


def test_an_unknown_name_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    assert scenarios.main(["one-lnk"]) == 2
    assert "one-link-step" in capsys.readouterr().err


def test_a_scenario_changes_only_the_named_properties() -> None:
    arm = scenarios.load("planar-arm-100kg").arm
    shoulder, elbow, wrist = ARMS["srms-like"].links[1:4]

    assert arm.payload is not None
    assert arm.payload.mass == 100.0
    assert arm.links[0] == replace(shoulder, damping_ratio=0.0, modes=arm.links[0].modes)
    assert arm.links[1] == replace(elbow, damping_ratio=0.0, modes=arm.links[1].modes)
    assert arm.links[2] == replace(wrist, length=1.8796)  # wrist and hand
    assert {mode.direction for link in arm.links for mode in link.modes} == {"y"}


def test_the_ramp_ends_at_the_step() -> None:
    ramp, step = (scenarios.load(f"one-link-{kind}").torque for kind in ("ramp", "step"))
    assert ramp is not None
    assert step is not None

    assert_allclose([ramp(0.0), ramp(1.0), ramp(2.0)], [[0.0], [2.5], [5.0]])
    assert_allclose([step(0.0), step(2.0)], [[5.0], [5.0]])


def test_the_angle_of_a_sprung_joint_includes_the_springs_deflection() -> None:
    arm = scenarios.load("planar-arm").arm
    values = {"q1": 1.0, "s1": 0.1, "q2": 2.0, "s2": 0.2, "q3": 3.0}
    row = np.array([[values.get(name, 9.0) for name in arm.names]])

    assert_allclose(scenario_runs.across(arm, row), [[1.1, 2.2, 3.0]])


def test_the_damping_of_the_loaded_arm_is_half_a_per_cent() -> None:
    """Damping of the lowest mode, from the decay of the linearised arm with joints locked."""
    arm = scenarios.load("spatial-arm-500kg-damped").arm
    model = Model(arm)
    moving = np.setdiff1d(np.arange(arm.n), arm.joint_index)
    A, _ = model.linearize(np.zeros(arm.n), np.zeros(arm.n), np.zeros(arm.n_joint))
    M = model.mass_matrix(np.zeros(arm.n))
    forces = M @ A[arm.n :]  # of all coordinates, by each of them and its rate
    held = np.linalg.solve(
        M[np.ix_(moving, moving)],
        np.hstack([forces[np.ix_(moving, moving)], forces[np.ix_(moving, arm.n + moving)]]),
    )
    n = len(moving)
    values = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), held]))
    slowest = values[np.argmin(np.abs(values))]

    assert abs(slowest) == pytest.approx(2.0 * np.pi * hertz(arm)[0], rel=1e-4)
    assert -slowest.real / abs(slowest) == pytest.approx(0.005, rel=0.02)


def test_the_rigid_link_turns_as_a_rigid_body_and_a_stiff_link_with_it() -> None:
    """5 N m on a uniform rod and its hub: theta = tau t^2 / (2 J)."""
    scenario = replace(scenarios.load("one-link-step"), t_end=0.25, n_out=6)
    (link,) = scenario.arm.links
    stiff = replace(scenario.arm, links=(replace(link, EIz=1e4 * 200.0),))
    expected = 5.0 * scenario.times**2 / 2.0 / (0.5 + 2.7 * 1.5**3 / 3.0)

    soft, rigid = scenario_runs.twins(scenario)
    hard = scenario_runs.follow(scenario, stiff)

    assert_allclose(rigid.joints[:, 0], expected, rtol=1e-9, atol=1e-12)
    away = [np.abs(run.joints[:, 0] - expected).max() for run in (soft, hard)]
    assert away[0] > 1e-3
    assert away[1] < 2e-4 * away[0]  # as one over the stiffness, give or take the phase
    assert scenario_runs.figures(scenario, soft, rigid)["joints apart [deg]"] > 0.06


def test_the_rigid_twin_follows_the_cycloid_of_its_nominal_torque() -> None:
    scenario = scenarios.load("one-link-nominal")
    motion = Cycloidal(start=(0.0,), goal=(np.pi / 2.0,), duration=2.0)

    rigid = scenario_runs.follow(scenario, stiffened(scenario.arm))

    expected = np.array([motion(t)[0] for t in scenario.times])
    assert_allclose(rigid.joints, expected, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("name", ["planar-arm-100kg", "spatial-arm", "six-links"])
def test_the_traced_torque_is_that_of_newton_and_euler(name: str) -> None:
    scenario = scenarios.load(name)
    assert isinstance(scenario.torque, scenario_file.Nominal)
    for t in (0.0, 0.3, 1.7):
        expected = NominalTorque(scenario.arm, scenario.torque.motion)(t)
        assert_allclose(scenario.torque(t), expected, rtol=1e-10, atol=1e-12)


RELEASED = """
    0.1 -89.712027 3.878018 0.0784376 -1.9973023 0.192151 0.216450
    0.25 -88.582255 -0.481421 0.0411844 -1.9995582 0.055073 -0.058306
    0.5 -88.392341 -3.824692 -0.0107341 -1.9988578 -0.059302 0.072568
    1.0 -92.159648 2.232737 -0.0366952 -1.9992859 -0.085856 -0.047243"""


def test_the_hanging_links_move_as_in_an_independent_implementation() -> None:
    """t [s], angles [deg], tip [m] and deflections [mm] of an independent implementation."""
    scenario = scenarios.load("two-links-two-modes")
    run = scenario_runs.follow(scenario, scenario.arm)

    for row in RELEASED.strip().splitlines():
        t, q1, q2, x, y, w1, w2 = (float(entry) for entry in row.split())
        k = int(np.argmin(np.abs(scenario.times - t)))
        assert scenario.times[k] == pytest.approx(t, abs=1e-12)
        assert np.degrees(run.joints[k]) == pytest.approx((q1, q2), abs=2e-6)
        assert run.path.tip[k, :2] == pytest.approx((x, y), abs=1e-7)
        assert 1e3 * run.bend[k, :, 0] == pytest.approx((w1, w2), abs=2e-6)
    assert scenario_runs.drifts(scenario, run)["energy drift"] < 1e-8
    assert run.path.integrator == "dop853"


def test_the_flying_body_turns_over_as_in_eulers_equations() -> None:
    scenario = scenarios.load("flying-body")
    base = scenario.arm.base
    moments = np.diag(base.inertia)
    euler = solve_ivp(
        lambda _, w: np.cross(moments * w, w) / moments,
        (0.0, scenario.t_end), base.angular_velocity_body, "DOP853", scenario.times,
        rtol=1e-12, atol=1e-12,
    )  # fmt: skip

    body, same = scenario_runs.twins(scenario)

    assert body is same
    assert_allclose(body.path.v[:, 3:6], euler.y.T, rtol=0.0, atol=1e-5)
    assert body.path.v[:, 5].min() < -1.9  # over
    found = scenario_runs.drifts(scenario, body)
    assert max(found.values()) < 1e-7
    assert set(found) == {"energy drift", "linear momentum drift", "angular momentum drift"}


def test_the_flying_beam_vibrates_as_one_free_at_both_ends() -> None:
    """4.730^2/(2 pi L^2) sqrt(EI/rho A), less a bead of one per cent at one end, both planes."""
    arm = scenarios.load("flying-beam").arm
    (beam,) = arm.links
    free = 4.730041**2 / (2.0 * np.pi * beam.length**2) * (100.0) ** 0.5

    assert sorted(hertz(arm, "free"))[:2] == pytest.approx((free, free), rel=0.03)


def test_the_tip_of_a_link_of_segments_is_measured_from_its_root() -> None:
    """With the joint's frame at the world's; the rate is the derivative of the deflection."""
    arm = scenarios.load("fixed-base").arm
    model = Model(arm)
    q, v = _bent(arm)
    frames = poses(outward(model.chain, q.tolist(), v.tolist()))
    expected = np.array(frames[model.bodies[0].stop - 1].tip)[1:]

    bend, rates = scenario_runs.deflections(model, q[None], v[None])
    ahead, behind = (
        scenario_runs.deflections(model, (q + h * v)[None], v[None])[0] for h in (1e-5, -1e-5)
    )

    assert_allclose(bend[0, 0], expected, rtol=1e-12)
    assert_allclose(rates, (ahead - behind) / 2e-5, rtol=1e-6, atol=1e-9)


def _bent(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    q, v = rng.normal(scale=0.05, size=(2, arm.n))
    q[0] = 0.0
    return q, v


def test_the_committed_page_is_that_of_the_stored_figures() -> None:
    results = json.loads((PAGE.parent / "results" / "scenarios.json").read_text(encoding="utf-8"))

    assert list(results["scenarios"]) == scenarios.names()
    assert PAGE.read_text(encoding="utf-8") == scenarios.page(results)
    for name in scenarios.names():
        assert (PAGE.parent / "results" / f"scenario_{name}.png").exists()
