"""Metrics of trajectories whose values are known by hand."""

import json
import math
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.metrics import (
    METRICS,
    Best,
    Recording,
    episode_metrics,
    evaluated,
    make_batch,
    never_empty,
    print_table,
    progress,
    record,
    regrets,
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


@pytest.mark.parametrize(("rms", "score"), [(0.0, 1.0), (0.04, 0.5), (0.12, 0.25)])
def test_score_of_a_moving_target_is_the_closeness_of_the_rms_error(
    rms: float, score: float
) -> None:
    r = recording(np.full(TIME.size, rms), moving=True, reach=2.0)
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


class Batch:
    """Two episodes by hand: one ends by failure at step 2, the other by the clock at step 3.

    The tip error counts steps, and everything else follows the action.
    """

    num_envs = 2
    action_space, control_dt, reach = SimpleNamespace(shape=(2, 2)), 0.1, 1.5
    core = SimpleNamespace(task=SimpleNamespace(moving=False), max_steps=3)

    def __init__(self) -> None:
        self.unwrapped, self.actions, self.seeds = self, [], None

    def info(self, action: Any) -> dict[str, Any]:
        return {
            "tip_error": np.full(2, float(len(self.actions))),
            "tip_deflection": 10.0 * action[:, 0],
            "root_curvature": 100.0 * action,
            "torque": -action,
        }

    def reset(self, seed: list[int]) -> Any:
        self.seeds = seed
        return np.zeros((2, 1)), self.info(np.zeros((2, 2)))

    def step(self, action: Any) -> Any:
        self.actions.append(action)
        k = len(self.actions)
        ended = np.array([k == 2, False]), np.array([False, k == 3])
        return np.full((2, 1), k), np.zeros(2), *ended, self.info(action)


class Ramp:
    """Actions 0.5, 1.0, 1.5 and their negatives; it keeps what it was given."""

    def __init__(self) -> None:
        self.given: list[Any] = []

    def predict(self, observation: Any, state: Any, start: Any) -> Any:
        self.given.append((observation[0, 0], state, start.tolist()))
        size = 0.5 * len(self.given)
        return [[size, -size]] * 2, len(self.given)


def test_recordings_hold_what_the_environments_say() -> None:
    envs, controller = Batch(), Ramp()
    r = record(controller, envs, (4, 5))
    assert envs.seeds == [4, 5]
    assert controller.given == [
        (0.0, None, [True, True]), (1.0, 1, [False, False]), (2.0, 2, [True, False])
    ]  # fmt: skip
    assert all(action.dtype == np.float32 for action in envs.actions)
    nan = np.nan
    np.testing.assert_array_equal(r.time, 0.1 * np.arange(4))
    np.testing.assert_array_equal(r.tip_error.T, [[0, 1, 2, nan], [0, 1, 2, 3]])
    np.testing.assert_array_equal(r.action[:, 1], [[0, 0], [0.5, -0.5], [1, -1], [1, -1]])
    np.testing.assert_array_equal(r.action[3, 0], [nan, nan])
    np.testing.assert_array_equal(r.torque[:, 1], -r.action[:, 1])
    np.testing.assert_array_equal(r.tip_deflection[:, 1], 10.0 * r.action[:, 1, 0])
    np.testing.assert_array_equal(r.root_curvature[:, 1], 100.0 * r.action[:, 1])
    assert r.failed.tolist() == [True, False]
    assert (r.reach, r.duration, r.moving) == (1.5, pytest.approx(0.3), False)


def test_metrics_of_episodes_side_by_side_are_those_of_each() -> None:
    """Two joints and two gauges; the second episode is shorter, and settles.

    Torques and actions count from the first step on.
    """
    rng = np.random.default_rng(0)
    n = TIME.size
    error, bent = rng.uniform(0.1, 0.5, (n, 2)), rng.normal(size=(n, 2))
    curved, torque, action = rng.normal(size=(3, n, 2, 2))
    error[300:, 1] = 0.039  # in the band of 2 % of 2 m
    for x in (error, bent, curved, torque, action):
        x[350:, 1] = np.nan
    given = {"failed": np.array([False, False]), "reach": 2.0, "duration": 4.0, "moving": False}
    m = episode_metrics(
        Recording(time=TIME, tip_error=error, tip_deflection=bent, root_curvature=curved,
                  torque=torque, action=action, **given)  # type: ignore[arg-type]
    )  # fmt: skip
    for k, end in ((0, n), (1, 350)):
        last = slice(end - 100, end)
        a = action[1:end, k]
        expected = {
            "success": float(k),
            "score": 0.25 * k,
            "settling_time": [math.inf, 3.0][k],
            "tip_error_final": error[end - 1, k],
            "tip_error_rms": math.sqrt(np.mean(error[:end, k] ** 2)),
            "tip_error_max": error[:end, k].max(),
            "residual_vibration": math.sqrt(np.mean(bent[last, k] ** 2)),
            "peak_root_curvature": np.abs(curved[:end, k]).max(),
            "effort": 0.01 * np.sum(torque[1:end, k] ** 2),
            "command_variation": np.abs(a[1:] - a[:-1]).sum(),
            "saturated": np.mean([max(abs(x[0]), abs(x[1])) >= 0.999 for x in a]),
        }
        found = {name: values[k] for name, values in m.items()}
        assert found == pytest.approx(expected, rel=1e-12)


def test_saturation_begins_at_999_thousandths_of_the_limit() -> None:
    action = np.array([1.0, 0.999, 0.9989, -0.999, 0.0])[:, None, None]
    zero = np.zeros((5, 1, 1))
    r = Recording(
        time=TIME[:5], tip_error=zero[:, 0], tip_deflection=zero[:, 0], root_curvature=zero,
        torque=zero, action=action, failed=np.array([False]), reach=1.0, duration=0.04,
        moving=False,
    )  # fmt: skip
    assert episode_metrics(r)["saturated"][0] == 0.5


def test_effort_does_not_depend_on_the_start_of_the_clock() -> None:
    r = recording(np.zeros(TIME.size), torque=np.ones((TIME.size, 1, 1)))
    assert episode_metrics(replace(r, time=TIME + 0.5))["effort"] == pytest.approx([4.0])


def test_recordings_are_fixed_and_their_columns_named() -> None:
    r = recording(np.zeros(TIME.size))
    with pytest.raises(FrozenInstanceError):
        r.reach = 2.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        Recording(*vars(r).values())  # type: ignore[misc]


def test_an_error_at_the_edge_of_the_band_is_outside() -> None:
    assert settling_time(TIME, np.full_like(TIME, 0.02), 0.02) == math.inf
    assert settling_time(TIME, np.full_like(TIME, 0.02), 0.0201) == 0.0
    later = TIME + 1.0
    assert settling_time(later, np.zeros_like(TIME), 0.02) == 1.0
    gone = np.where(TIME < 2.0, 0.0, np.nan)
    assert settling_time(TIME, gone, 0.02) == 0.0


def test_regrets_are_at_most_four() -> None:
    values = np.array([1.0, 3.0, 5.0, 5.1, math.inf])
    found = regrets({"settling_time": values}, Best("settling_time", np.ones(5)))
    assert found.tolist() == [0.0, 2.0, 4.0, 4.0, 4.0]


def test_regrets_are_of_episodes_with_a_best_above_zero() -> None:
    """Of the metric that the best is of; episodes are the last axis."""
    metrics = {"tip_error_rms": np.array([[3.0, 1.0, 4.0, 2.0], [6.0, 1.0, 4.0, 8.0]])}
    metrics["settling_time"] = np.ones((2, 4))
    best = Best("tip_error_rms", np.array([2.0, 0.0, math.nan, 4.0]))
    assert regrets(metrics, best).tolist() == [[0.5, -0.5], [2.0, 1.0]]
    with pytest.raises(FrozenInstanceError):
        best.metric = ""  # type: ignore[misc]


def test_episodes_are_evaluated_from_a_seed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    envs = SimpleNamespace(close=lambda: asked.append("closed"))
    monkeypatch.setattr("agents.metrics.make_batch", lambda *given: asked.append(given) or envs)
    monkeypatch.setattr("agents.metrics.record", lambda *given: given)
    monkeypatch.setattr("agents.metrics.episode_metrics", lambda recording: recording)
    run: Any = evaluated
    assert run("pd", "id", obs="sensors") == ("pd", envs, range(10_000, 10_100))
    assert run("pd", "id", episodes=3, seed=7) == ("pd", envs, range(7, 10))
    assert asked == [("id", 100, {"obs": "sensors"}), "closed", ("id", 3, {}), "closed"]
    with pytest.raises(TypeError):
        run("pd", "id", 3)


def test_a_rigid_arm_has_a_column_of_zero_curvature() -> None:
    assert never_empty(np.ones((2, 3, 0))).tolist() == [3 * [[0.0]], 3 * [[0.0]]]
    bent = np.ones((2, 3, 2))
    assert never_empty(bent) is bent


def test_a_bar_without_a_label_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.metrics.tqdm", dict)
    assert progress("film", 5) == {"total": 5, "desc": "film", "disable": None, "leave": False}
    assert progress(None, 5)["disable"] is True


def test_environments_of_others_are_refused() -> None:
    with pytest.raises(ValueError, match="CartPole-v1 is not an environment of flexarm"):
        make_batch("CartPole-v1", 2)


def test_result_files_hold_every_episode_of_every_controller(tmp_path: Path) -> None:
    pair = {
        name: {key: np.array([x, x + 1.0]) for key in METRICS}
        for name, x in (("a", 1.0), ("b", 5.0))
    }
    write_results(tmp_path, pair, range(7, 9), {"env": "toy"})
    text = (tmp_path / "evaluation.json").read_text()
    assert text.startswith('{\n "note": ')
    data = json.loads(text)
    assert (data["env"], data["seeds"], list(data["controllers"])) == ("toy", [7, 8], ["a", "b"])
    assert data["controllers"]["b"]["summary"]["score"] == 5.5
    lines = (tmp_path / "evaluation.csv").read_text().splitlines()
    assert lines[0].split(",") == ["controller", "seed", *METRICS]
    assert [line.split(",")[:3] for line in lines[1:]] == [
        ["a", "7", "1.0"], ["a", "8", "2.0"], ["b", "7", "5.0"], ["b", "8", "6.0"],
    ]  # fmt: skip


def test_the_table_is_in_the_units_of_its_header(capsys: pytest.CaptureFixture[str]) -> None:
    metrics = {key: np.full(4, 0.00125) for key in METRICS}
    metrics |= {"success": np.array([1.0, 1.0, 1.0, 0.0]), "score": np.full(4, 0.5)}
    metrics |= {"settling_time": np.array([1.0, 2.0, 3.0, math.inf]), "effort": np.full(4, 12.34)}
    metrics |= {"residual_vibration": np.full(4, 0.0012505), "tip_error_final": np.full(4, 0.1)}
    lost = metrics | {"settling_time": np.full(4, math.inf)}
    lost |= {"residual_vibration": np.full(4, 0.0012495)}
    best = Best("settling_time", np.array([1.0, 1.0, 2.0, 2.0]))
    print_table({"pd": metrics, "lost": lost})
    plain = capsys.readouterr().out
    rows = {line.split()[1]: line for line in plain.splitlines() if "│" in line}
    cells = [cell.strip() for cell in rows["pd"].strip("│").split("│")]
    assert cells == ["pd", "75 %", "0.500", "2.50", "100.00", "1.3", "12.3"]
    assert rows["pd"].startswith("│ pd   │    75 % │")
    assert "never" in rows["lost"]
    assert rows["lost"].split("│")[6].strip() == "1.2"
    assert all(f" {name} " in plain for name in ("success", "score", "settling [s]"))
    assert "regret" not in plain.lower()
    print_table({"pd": metrics}, best)
    bounded = capsys.readouterr().out
    (row,) = [line for line in bounded.splitlines() if "│ pd" in line]
    assert row.split("│")[-2].strip() == "75 %"  # of 0, 1, 0.5, 4
    assert "Regret: settling time over the best" in (text := " ".join(bounded.split()))
    assert "(median 1.5 s)" in text
    print_table({"pd": metrics}, Best("tip_error_rms", np.array([0.00025, math.nan, 0.001, 0.0])))
    text = " ".join(capsys.readouterr().out.split())
    assert "Excess: RMS tip error less the smallest" in text
    assert "excess [mm]" in text
    assert " 0.625 │" in text  # of 1 and 0.25
    assert "(median 0.25 mm)" in text
    print_table({"pd": metrics}, Best("tip_error_rms", np.full(4, 0.000999)))
    assert "(median 0.999 mm)" in " ".join(capsys.readouterr().out.split())
