"""Three independent engines agree on the tip; lines and comparisons of the peers' benchmark."""

import subprocess
import sys
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from benchmarks.peers.lines import (
    BATCHED,
    ENGINES,
    OURS,
    Family,
    Point,
    ahead,
    best,
    front,
    levels,
    page,
    speeds,
    statement,
    steady,
    summary,
)
from benchmarks.peers.models import Shapes, compiled, our_run
from benchmarks.peers.scenes import SCENES
from dynamics.extras import installation
from dynamics.types import Array
from tests.paths import ROOT


def a_point(error: float, cost: float) -> Point:
    family = Family("ours", "a model", "a method", lambda rate, record: (np.zeros((0, 2)), 0.0))
    return Point(family, Fraction(1), error, cost)


def test_a_line_has_the_runs_that_no_other_beats_in_error_and_cost() -> None:
    good = [a_point(1e-4, 3.0), a_point(1e-3, 1.0)]
    worse = [a_point(2e-4, 3.1), a_point(1e-2, 1.0), a_point(np.inf, 0.1)]
    assert front([*worse, *good]) == good
    assert front([*worse, *good], near=1.1) == [good[0], worse[0], good[1], worse[1]]
    assert best([*worse, *good], 5e-4) == good[0]
    assert best([*worse, *good], 1e-5) is None


def test_a_run_whose_finer_steps_err_more_is_not_steady() -> None:
    """An error of 1e-4 between 3e-3 and 2e-3 is cancellation; a single step is not steady."""
    first = a_point(3e-3, 1.0)
    lucky = Point(first.family, Fraction(2), 1e-4, 2.0)
    finer = [Point(first.family, Fraction(k), 2e-3, float(k)) for k in (3, 4)]
    runs = [first, lucky, *finer, a_point(1e-4, 1.0)]
    assert best(runs[:-1], 1e-3) == lucky
    assert steady(runs, 1e-3) == []
    assert steady(runs, 2.5e-3) == [lucky, finer[0]]


def test_a_run_below_and_left_of_our_line_is_ahead() -> None:
    """Cheaper at its error, or more accurate than any of ours; but not below the truth's own."""
    scene = SCENES["S1"]
    ours = [a_point(1e-3, 1.0), a_point(1e-5, 10.0), a_point(0.5 * scene.finest, 100.0)]
    behind = [a_point(1e-3, 1.1), a_point(2e-5, 10.0), a_point(0.1 * scene.finest, 200.0)]
    left, below = a_point(1e-3, 0.9), a_point(9e-6, 11.0)
    none: dict[str, list[Point]] = {engine: [] for engine in (*ENGINES, BATCHED)}
    points = none | {OURS: ours, "MuJoCo": behind}
    assert ahead(scene, points) == []
    assert "No peer's run lies below and left" in statement(summary(scene, points))
    points["MuJoCo"] = [*behind, left, below]
    assert ahead(scene, points) == [below, left]
    assert "2 runs of peers lie below and left" in statement(summary(scene, points))


def test_the_table_has_our_speed_and_the_best_peers_down_to_the_truth() -> None:
    scene = SCENES["S1"]
    assert levels(scene) == pytest.approx([10.0**-k for k in range(2, 8)])
    assert scene.finest <= levels(scene)[-1]
    points = {engine: [a_point(1e-3, 4.0)] for engine in (*ENGINES, BATCHED)}
    points |= {OURS: [a_point(1e-3, 1.0), a_point(1e-4, 2.0)], "MuJoCo": [a_point(5e-3, 3.0)]}
    rows = [(row["ours"], row["peer"]) for row in speeds(scene, points)]
    costs = [tuple(p and p["cpu_seconds_per_second"] for p in row) for row in rows]
    assert costs == [(1.0, 3.0), (1.0, 4.0), (2.0, None), *3 * [(None, None)]]
    results = {"machine": {"processor": ""}, "versions": {}, "command": "", "comparisons": []}
    text = page(results | {"scenes": {"S1": summary(scene, points)}})
    assert "| 0.001 | 1 | 0.25 | 4 |" in text
    assert "| 0.0001 | 0.5 | - | - | - |" in text


@pytest.mark.parametrize("missing", ["exudyn", "mujoco"])
def test_without_the_extra_a_message_names_the_package_to_install(missing: str) -> None:
    code = f"""
import sys
from unittest.mock import MagicMock
for name in ("exudyn", "exudyn.itemInterface", "exudyn.symbolic", "mujoco", "mujoco.rollout"):
    sys.modules[name] = MagicMock()
sys.modules[{missing!r}] = None
import benchmarks.peers.engines
"""
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 1
    sentence = f"needs {missing}, which is not installed; {installation('peers')}"
    assert sentence in result.stderr


def test_steps_end_where_the_torque_jumps() -> None:
    """A pulse of 0.25 s is 25 rows of S1's truth, which is an odd number."""
    scene = SCENES["S1"]
    assert scene.allows(Fraction(1, 5))
    assert not scene.allows(Fraction(1, 2))
    torques = scene.torques(Fraction(2))
    assert torques.size * scene.step(Fraction(2)) == pytest.approx(2.0)
    assert np.flatnonzero(np.diff(torques)).tolist() == [49, 99]


@pytest.fixture(scope="module")
def peers() -> Any:
    pytest.importorskip("exudyn")
    pytest.importorskip("mujoco")
    from benchmarks.peers import sweep

    return sweep


@pytest.fixture(scope="module")
def tips(peers: Any) -> dict[str, Array]:
    """S1's tip by cable elements, chains of hinges and assumed modes, with small steps."""
    engines, scene, fine = peers.engines, SCENES["S1"], Fraction(24)
    cable = engines.cable(scene, 6, scene.axial, explicit=False)
    model = compiled(Shapes(("clamped-tip-mass",), (4,), True).arm(scene))
    result = {
        "cable": engines.follow(cable, scene, engines.Method("GeneralizedAlpha"), fine)[0],
        "ours": our_run(scene, model, "rk4", fine, True)[0],
    }
    for hinges, rate in ((8, 20), (16, 80), (32, 256)):
        result[f"{hinges} hinges"] = engines.mujoco_chain(scene, hinges, "RK4", Fraction(rate))[0]
    return result


def apart(a: Array, b: Array) -> float:
    """Largest distance of two tips over the reach [-]."""
    return float(np.linalg.norm(a - b, axis=1).max()) / SCENES["S1"].arm.reach


def test_cable_elements_and_foreshortened_modes_agree(tips: dict[str, Array]) -> None:
    """To the smallest error compared on S1, also with the stored beam, a third method."""
    assert apart(tips["ours"], tips["cable"]) < 1e-4
    assert SCENES["S1"].error(tips["ours"], Fraction(1)) < 1e-4
    assert SCENES["S1"].error(tips["cable"], Fraction(1)) < 1e-4


def test_a_chain_of_hinges_converges_to_the_truth_quadratically(tips: dict[str, Array]) -> None:
    errors = [SCENES["S1"].error(tips[f"{n} hinges"], Fraction(1)) for n in (8, 16, 32)]
    assert errors[0] > 2.0 * errors[1]
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.3)


def test_cable_elements_confirm_the_truth_of_two_links(peers: Any) -> None:
    """To the elements' own error: four per link are not converged."""
    engines, scene, fine = peers.engines, SCENES["korayem"], Fraction(32)
    cable = engines.cable(scene, 4, scene.axial, explicit=False)
    tips, _ = engines.follow(cable, scene, engines.EXUDYN_METHODS["trapezoidal"], fine)
    assert scene.error(tips, fine) < 1e-5


def test_hinges_extrapolated_confirm_the_truth_of_two_links(peers: Any) -> None:
    """MuJoCo's chains of 16 and 32 hinges, whose distance from each other is 4e-7."""
    scene = SCENES["korayem"]
    coarse, fine = (
        peers.engines.mujoco_chain(scene, hinges, "RK4", Fraction(rate))[0]
        for hinges, rate in ((16, 160), (32, 640))
    )
    assert scene.error(fine + (fine - coarse) / 3.0, Fraction(1)) < 2e-7


def test_every_engine_has_a_line_and_ours_is_the_cheapest(peers: Any) -> None:
    """Quick form of the benchmark. The measured factor is above 50, the required one 5."""
    scene = SCENES["S1"]
    points = peers.time_again(scene, peers.explore(scene, quick=True))
    costs = {engine: best(runs, 4e-3) for engine, runs in points.items()}
    assert set(costs) == {*ENGINES, BATCHED}
    assert all(costs[e].cost > 5.0 * costs[OURS].cost for e in ENGINES[1:])
