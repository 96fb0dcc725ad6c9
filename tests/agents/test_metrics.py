"""Metrics of trajectories whose values are known by hand."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.metrics import (
    METRICS,
    Recording,
    episode_metrics,
    settling_time,
    summarise,
    write_results,
)

TIME = np.arange(0.0, 4.0 + 1e-9, 0.01)


def recording(tip_error: Any, failed: bool = False, **more: Any) -> Recording:
    """One episode with the given tip error [m], on an arm of 1 m reach."""
    n = TIME.size
    columns = {
        "tip_error": np.asarray(tip_error, float)[:, None],
        "tip_deflection": np.zeros((n, 1)),
        "root_curvature": np.zeros((n, 1, 1)),
        "torque": np.zeros((n, 1, 1)),
        "action": np.zeros((n, 1, 1)),
    }
    given = {"failed": np.array([failed]), "reach": 1.0, "duration": 4.0, "moving": False}
    return Recording(time=TIME, **(given | columns | more))  # type: ignore[arg-type]


def test_settling_time_is_the_last_entry_into_the_band() -> None:
    error = np.exp(-TIME)  # below 0.02 from ln 50 = 3.912 on; but 0.25 s of holding are wanted
    assert settling_time(TIME, error, 0.02) == math.inf
    assert settling_time(TIME, error, 0.05) == pytest.approx(3.0, abs=1e-9)  # ln 20 = 2.996


def test_settling_time_restarts_when_the_error_leaves_the_band() -> None:
    error = np.where(TIME < 1.0, 1.0, 0.0)
    error[np.abs(TIME - 2.0) < 0.005] = 0.5
    assert settling_time(TIME, error, 0.02) == pytest.approx(2.01)
    assert settling_time(TIME, np.zeros_like(TIME), 0.02) == 0.0


@pytest.mark.parametrize(("settled", "score"), [(0.0, 1.0), (1.0, 0.75), (3.0, 0.25), (9.0, 0.0)])
def test_score_is_the_share_of_the_episode_after_settling(settled: float, score: float) -> None:
    r = recording(np.where(settled - 1e-9 > TIME, 1.0, 0.0))
    assert episode_metrics(r)["score"] == pytest.approx([score])


@pytest.mark.parametrize(("rms", "score"), [(0.0, 1.0), (0.02, 0.5), (0.06, 0.25)])
def test_score_of_a_moving_target_is_the_closeness_of_the_rms_error(
    rms: float, score: float
) -> None:
    r = recording(np.full(TIME.size, rms), moving=True)
    assert episode_metrics(r)["score"] == pytest.approx([score])


@pytest.mark.parametrize("moving", [False, True])
def test_score_of_a_failure_is_zero(moving: bool) -> None:
    assert episode_metrics(recording(np.zeros(TIME.size), failed=True, moving=moving))["score"] == 0


def test_metrics_of_a_known_motion() -> None:
    """Residual vibration of a sine is amplitude / sqrt 2; effort of 2 N m over 1 s is 4."""
    sine = 0.01 * np.sin(2.0 * np.pi * 5.0 * TIME)[:, None]
    torque = np.where((TIME > 0.0) & (TIME <= 1.0 + 1e-9), 2.0, 0.0)[:, None, None]
    r = recording(
        np.where(TIME < 1.0, 0.5, 0.001),
        tip_deflection=np.abs(sine),
        root_curvature=np.where(TIME < 1.0, -0.7, 0.1)[:, None, None],
        torque=torque,
        action=torque / 2.0,
    )
    m = {name: values[0] for name, values in episode_metrics(r).items()}
    assert list(m) == list(METRICS)
    assert m["success"] == 1.0
    assert m["settling_time"] == pytest.approx(1.0)
    assert m["tip_error_final"] == 0.001
    assert m["tip_error_max"] == 0.5
    assert m["residual_vibration"] == pytest.approx(0.01 / math.sqrt(2.0), rel=1e-12)
    assert m["peak_root_curvature"] == 0.7
    assert m["effort"] == pytest.approx(4.0)
    assert m["command_variation"] == pytest.approx(1.0)  # one step down; the start is free
    assert m["saturated"] == pytest.approx(0.25)


@pytest.mark.parametrize(("begin", "expected"), [(2.995, 0.2), (3.505, 0.2 * math.sqrt(0.5))])
def test_residual_vibration_is_that_of_the_last_second(begin: float, expected: float) -> None:
    """A constant deflection from `begin` on, of an episode of 4 s."""
    bent = np.where(begin < TIME, 0.2, 0.0)[:, None]
    m = episode_metrics(recording(np.zeros(TIME.size), tip_deflection=bent))
    assert m["residual_vibration"][0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("last", "settled"), [(3.745, True), (3.755, False)])
def test_settling_holds_for_a_quarter_of_a_second(last: float, settled: bool) -> None:
    m = episode_metrics(recording(np.where(last < TIME, 0.0, 1.0)))
    assert bool(m["success"][0]) == settled


def test_an_episode_that_ends_early_has_infinite_metrics() -> None:
    error = np.where(TIME < 2.0, 0.001, np.nan)
    m = episode_metrics(recording(error, failed=True))
    assert m["success"][0] == 0.0
    assert m["score"][0] == 0.0
    assert all(m[name][0] == math.inf for name in METRICS if name not in ("success", "score"))


def test_an_episode_that_never_settles_is_not_a_success() -> None:
    m = episode_metrics(recording(np.full_like(TIME, 0.021)))
    assert m["success"][0] == 0.0
    assert m["settling_time"][0] == math.inf
    assert m["tip_error_final"][0] == 0.021


def test_failures_are_infinite_in_the_summary() -> None:
    metrics = {"success": np.array([1.0, 1.0, 0.0]), "settling_time": np.array([0.5, 0.7, np.inf])}
    assert summarise(metrics) == {"success_rate": pytest.approx(2 / 3), "settling_time": 0.7}
    metrics["settling_time"][1] = np.inf
    assert summarise(metrics)["settling_time"] == math.inf


def test_written_json_is_strict(tmp_path: Path) -> None:
    """An infinite settling time is null in JSON, as the note states, and inf in CSV."""
    metrics = episode_metrics(recording(np.ones_like(TIME)))
    write_results(tmp_path, {"pd": metrics}, [7], {"env": "toy"})

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    data = json.loads((tmp_path / "evaluation.json").read_text(), parse_constant=refuse)

    assert data["controllers"]["pd"]["summary"]["settling_time"] is None
    assert data["controllers"]["pd"]["episodes"]["tip_error_max"] == [1.0]
    assert "null" in data["note"]
    header, row = (tmp_path / "evaluation.csv").read_text().splitlines()
    assert dict(zip(header.split(","), row.split(","), strict=True))["settling_time"] == "inf"
