"""Short form of the work-precision charts, and growth of cost."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from matplotlib.figure import Figure

import flexarm_env  # noqa: F401  (registers the ids)
from benchmarks.arms import undamped
from benchmarks.speed import cost
from benchmarks.work_precision import charts as precision_charts
from benchmarks.work_precision import run as work_precision
from benchmarks.work_precision.scenes import SETTINGS, Level
from dynamics import compile_arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.tracing.operation_counts import operations


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    return work_precision.quick()


@pytest.fixture(scope="module")
def scene(results: dict[str, Any]) -> dict[str, Any]:
    return results["scenes"]["S1"]


def runs(scene: dict[str, Any], integrator: str) -> list[dict[str, Any]]:
    """Runs of the default model by decreasing step."""
    mine = [p for p in scene["points"] if p["model"] == scene["default"]["model"]]
    return sorted((p for p in mine if p["integrator"] == integrator), key=lambda p: -p["dt"])


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_errors_fall_at_the_order_of_the_method(scene: dict[str, Any], integrator: str) -> None:
    """Errors are those from the same model's converged integration; at one step they may cancel."""
    fine = [p for p in runs(scene, integrator) if p["integration"] > work_precision.ENOUGH][-5:]
    logs = np.log([[p["dt"], p["integration"]] for p in fine]).T
    assert np.polyfit(*logs, 1)[0] > INTEGRATORS[integrator].order - 0.3
    assert fine[-1]["integration"] < 1e-4


@pytest.mark.parametrize(
    "integrator", [name for name, method in INTEGRATORS.items() if method.limit < np.inf]
)
def test_runs_beyond_the_stability_limit_are_stored_as_diverged(
    scene: dict[str, Any], integrator: str
) -> None:
    setting = SETTINGS["S1"]
    model = compile_arm(setting.arm)
    fastest = model.frequencies(setting.start(model)[0], joints="free").max()
    limit = INTEGRATORS[integrator].limit
    beyond = [p for p in runs(scene, integrator) if p["dt"] * fastest > 1.5 * limit]
    within = [p for p in runs(scene, integrator) if p["dt"] * fastest < 0.7 * limit]
    assert beyond
    assert all(p["total"] == np.inf for p in beyond)
    assert all(p["total"] < 1.0 for p in within)


def test_a_run_that_overflows_within_one_call_has_diverged() -> None:
    """The stepper keeps the state before such a call, which looks like an arm at rest."""
    setting = SETTINGS["S1"]
    model = compile_arm(Level(modes=2, foreshortening=True).arm(setting.arm))
    whole = work_precision.Step(setting.times.size - 1, 40)
    assert work_precision.follow(model, setting, "rk4", whole) is None


def test_the_three_errors_obey_the_triangle_inequality(scene: dict[str, Any]) -> None:
    """Model, integration and total error are measured independently."""
    finite = [p for p in scene["points"] if p["total"] < np.inf]
    assert len(finite) > 20
    for point in finite:
        model = scene["models"][point["model"]]["model error"]
        assert point["total"] <= point["error"] + 1e-12
        assert point["error"] == model + point["integration"]
        if point.get("stride", 1) == 1:  # at all output times
            assert point["total"] >= abs(model - point["integration"]) - 1e-12


def test_the_pareto_line_falls_and_nothing_lies_below_it(scene: dict[str, Any]) -> None:
    line = scene["front"]
    assert len(line) > 2
    assert np.all(np.diff([p["cpu"] for p in line]) > 0.0)
    assert np.all(np.diff([p["error"] for p in line]) < 0.0)
    finite = [p for p in scene["points"] if np.isfinite(p["error"])]  # the cheapest run may diverge
    for point in finite:
        assert any(p["cpu"] <= point["cpu"] and p["error"] <= point["error"] for p in line)


def test_the_default_is_on_the_chart(scene: dict[str, Any]) -> None:
    marked = [p for p in scene["points"] if p["default"]]
    assert len(marked) == 1
    assert marked[0].items() >= scene["default"].items()
    assert marked[0]["error"] < 1e-2


@pytest.mark.parametrize("family", ["OneLink", "TwoLink", "SixLink"])
def test_the_default_is_that_of_the_environment(family: str) -> None:
    core: Any = gym.make(f"FlexArm/{family}-Reach-v0").unwrapped
    core = core.core
    setting = next(s for s in SETTINGS.values() if s.title.startswith(family))
    assert setting.arm == undamped(core.arm)
    integrator, step = work_precision.default_of(setting)
    assert (integrator, step.substeps) == (core.integrator, core.substeps)
    assert step.dt(setting) == pytest.approx(core.control_dt / core.substeps)
    assert np.array_equal(setting.motion.torque(0.0), core.torque_limit)
    charted = work_precision.models_of(setting)[0] != "default"  # as one of the levels
    assert charted == (family == "OneLink")  # the others' last links have fewer modes


def test_the_error_of_a_rigid_link_is_the_known_one(scene: dict[str, Any]) -> None:
    """It is 7.0e-3 of the length for S1; every mode reduces it."""
    errors = [row["model error"] for row in scene["models"].values()]
    assert errors[0] == pytest.approx(7.0e-3, rel=0.01)
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]


def test_the_linear_model_diverges_in_the_spin_up_and_one_foreshortened_mode_does_not() -> None:
    setting = SETTINGS["S3"]
    error = {}
    for foreshortening in (False, True):
        level = Level(modes=1, foreshortening=foreshortening)
        model = compile_arm(level.arm(setting.arm))
        step = work_precision.Step(1, 1)
        tips = work_precision.follow(model, setting, work_precision.ACCURATE, step)
        error[foreshortening] = work_precision.apart(tips, setting.truth, setting)
    assert error[False] == np.inf
    assert error[True] < 1e-3


@pytest.mark.slow
def test_many_segments_agree_with_the_nonlinear_beam() -> None:
    """The truths of other scenes are made of segments; S1 also has a beam to compare with."""
    setting = SETTINGS["S1"]
    level = SETTINGS["slim"].refined[-1]
    tips, _ = work_precision.converged(compile_arm(level.arm(setting.arm)), setting, 1)
    assert work_precision.apart(tips, setting.truth, setting) < setting.floor


def test_results_are_plain_json_with_a_table_and_pictures(
    results: dict[str, Any], tmp_path: Path
) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    text = json.dumps(work_precision.plain(results))
    assert json.loads(text, parse_constant=refuse)["scenes"]["S1"]["points"]
    assert "diverged" in text
    assert {"machine", "versions", "commit", "command"} == set(results["scenes"]["S1"]["made"])
    precision_charts.draw(results, tmp_path)
    for name in ("work_precision", "work_precision_S1"):
        assert (tmp_path / name).with_suffix(".png").stat().st_size > 10_000
    table = precision_charts.page(results)
    for target in precision_charts.TARGETS:
        found = precision_charts.cheapest(results["scenes"]["S1"], target)
        assert f"| {target:.0e} | " + ("none" if found is None else found["model"]) in table


def test_a_model_of_which_every_run_diverged_lies_at_its_costliest_run() -> None:
    """Not left of models that are cheaper: it costs more than that."""
    scene = precision_charts.stored_results(precision_charts.STORED)["scenes"]["six-link"]
    axis = Figure().subplots()
    precision_charts.draw_models(axis, scene)
    (lost,) = [line for line in axis.get_lines() if line.get_marker() == "x"]
    cpu = [p["cpu"] for p in scene["points"] if p["model"] == "3 modes, linear"]
    assert list(lost.get_xdata()) == [max(cpu)]
    assert lost.get_label() == "every run diverged"


def test_the_committed_page_is_that_of_the_stored_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    committed, file = precision_charts.STORED, tmp_path / precision_charts.STORED.name
    file.write_bytes(committed.read_bytes())
    monkeypatch.setattr(work_precision, "draw", lambda results, folder: None)
    arguments = ["", "--charts", "--out", str(file), "--images", str(tmp_path)]
    monkeypatch.setattr("sys.argv", arguments)
    work_precision.main()
    pages = [x.with_name("work_precision.md").read_text() for x in (file, committed)]
    assert pages[0] == pages[1]


def test_scenes_that_are_not_measured_stay_as_they_are_stored(
    results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, file = results["scenes"]["S1"], tmp_path / "stored.json.bz2"
    before = {"batch": 1, "scenes": {"S1": scene | {"floor": 1.0}, "S3": scene}}
    work_precision.store(work_precision.plain(before), file)
    monkeypatch.setattr(work_precision, "run", lambda chosen, jobs: results)
    arguments = ["", "--only", "S1", "--out", str(file), "--images", str(tmp_path)]
    monkeypatch.setattr("sys.argv", arguments)
    work_precision.main()
    found = precision_charts.stored_results(file)["scenes"]
    assert list(found) == ["S1", "S3"]
    assert found["S1"]["floor"] == pytest.approx(scene["floor"])
    assert found["S3"]["points"] == found["S1"]["points"]


def test_a_truth_at_other_times_is_refused() -> None:
    other = replace(SETTINGS["S1"], period=0.02)
    with pytest.raises(ValueError, match="does not have the output times"):
        _ = other.truth


@pytest.mark.parametrize("changes", [{}, {"foreshortening": True}], ids=["linear", "foreshortened"])
def test_operations_grow_linearly_with_segments_and_links(changes: dict[str, bool]) -> None:
    """Each inner part has the same cost, so second differences vanish."""

    def count(links: int, segments: int) -> int:
        arm = cost.chain(links, 2, segments=segments, **changes)
        return sum(operations(compile_arm(arm).graph).values())

    by_segments = [count(1, k) for k in (3, 5, 7)]
    assert np.diff(by_segments, 2) == pytest.approx(0.0, abs=0.01 * by_segments[0])
    by_links = [count(k, 1) for k in (3, 5, 7)]
    assert np.diff(by_links, 2) == pytest.approx(0.0, abs=0.01 * by_links[0])


def test_the_exponent_is_that_of_the_added_cost() -> None:
    x = [1, 2, 3, 4, 6, 10]
    assert cost.exponent(x, [1.0, *(9.0 + 3.0 * (k - 2) ** 1.5 for k in x[1:])]) == pytest.approx(
        1.5
    )
