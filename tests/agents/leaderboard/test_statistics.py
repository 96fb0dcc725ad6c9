"""Statistics of episodes whose values are known by hand, or by a second path."""

import itertools
import math
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from agents.leaderboard.statistics import (
    Entry,
    Spectrum,
    compared,
    decisions,
    figures,
    improvements,
    interquartile_mean,
    interval,
    moves,
    profile,
    quartiles,
    rounded,
    spectrum,
    wins,
)
from agents.metrics import METRICS, Best, Recording
from dynamics.types import AnyArray

DT, STEPS = 0.02, 150
TIME = DT * np.arange(STEPS + 1)


def recording(curvature: AnyArray, reached: float, failed: bool = False) -> Recording:
    """One episode of 3 s with root curvatures (T, n), whose tip is on the target from a time on."""
    flat = np.zeros((TIME.size, 1))
    return Recording(
        time=TIME,
        tip_error=np.where(reached - 1e-9 > TIME, 1.0, 0.0)[:, None],
        tip_deflection=flat,
        root_curvature=curvature[:, None],
        torque=flat[:, None],
        action=flat[:, None],
        failed=np.array([failed]),
        reach=1.0,
        duration=DT * STEPS,
        moving=False,
    )


def test_interquartile_mean_is_that_of_all_runs_together() -> None:
    values = np.array([[0.0, 1.0, 2.0, 3.0], [4.0, 5.0, 6.0, 100.0]])
    assert interquartile_mean(values) == pytest.approx((2.0 + 3.0 + 4.0 + 5.0) / 4.0)


def test_interval_has_the_width_of_the_normal_distribution() -> None:
    """The interquartile mean of n normal values has the standard error 1.08 sigma / sqrt n."""
    low, high = interval(np.random.default_rng(0).normal(3.0, 1.0, (1, 400)))
    assert low < 3.0 < high
    assert high - low == pytest.approx(2 * 1.96 * 1.08 / math.sqrt(400), rel=0.25)
    assert interval(np.full((2, 5), 0.25)) == [0.25, 0.25]


def test_runs_on_equal_episodes_are_drawn_together() -> None:
    """A policy's second run that repeats the first adds no certainty."""
    run = np.random.default_rng(0).normal(size=(1, 48))
    assert interval(np.repeat(run, 2, axis=0)) == pytest.approx(interval(run))


def test_runs_that_differ_widen_the_interval_as_all_their_draws_do() -> None:
    """Of four runs that are the same in all episodes there are 256 draws, all equally likely."""
    runs = (0.0, 0.2, 0.7, 0.9)
    found = interval(np.repeat(np.array(runs)[:, None], 10, axis=1))
    exact = [sum(sorted(drawn)[1:3]) / 2.0 for drawn in itertools.product(runs, repeat=4)]
    assert found == pytest.approx(np.percentile(exact, [2.5, 97.5]))


def test_intervals_are_repeatable() -> None:
    """By a second path: 2000 draws of runs and of whole episodes from the streams of two seeds."""
    values = np.random.default_rng(5).normal(size=(2, 12))
    episodes = np.random.default_rng(0).integers(0, 12, (2000, 12))
    runs = np.random.default_rng(1).integers(0, 2, (2000, 2))
    drawn = [values[np.ix_(i, k)] for i, k in zip(runs, episodes, strict=True)]
    middle = [interquartile_mean(x) for x in drawn]
    assert interval(values) == pytest.approx(np.percentile(middle, [2.5, 97.5]), rel=1e-12)


def test_wins_are_counted_within_episodes_and_over_all_pairs_of_runs() -> None:
    values = np.array([[1.0, 2.0, 9.0], [3.0, 2.0, 0.0]])
    others = np.array([[2.0, 2.0, 1.0], [0.0, 1.0, 1.0]])
    pairs = [[(a > b) + 0.5 * (a == b) for b in others] for a in values]
    assert wins(values, others).tolist() == np.array(pairs).tolist()


def test_improvement_is_the_share_of_wins_with_a_binomial_interval() -> None:
    """With one run each, the mean of a resample is binomial."""
    own, other = np.where(np.arange(200) < 140, 1.0, 0.0)[None], np.full((1, 200), 0.5)
    found = improvements({"a": own, "b": other})
    assert found["a"]["b"]["p"] == pytest.approx(0.7)
    assert found["b"]["a"]["p"] == pytest.approx(0.3)
    exact = stats.binom(200, 0.7).ppf([0.025, 0.975]) / 200
    assert found["a"]["b"]["ci"] == pytest.approx(exact, abs=0.0051)
    assert found["b"]["a"]["ci"] == pytest.approx(1.0 - exact[::-1], abs=0.0051)
    assert set(found["a"]) == {"b"}


def test_gain_is_of_the_same_episodes() -> None:
    """Whatever the episodes' spread, a constant gain has an interval of no width."""
    hard = np.random.default_rng(3).uniform(0.0, 0.8, 40)
    found = improvements({"a": hard[None] + 0.125, "b": np.stack([hard, hard])})
    assert found["a"]["b"]["gain"] == pytest.approx(0.125, abs=5e-5)
    assert found["a"]["b"]["gain_ci"] == pytest.approx([0.125, 0.125], abs=5e-5)
    assert found["b"]["a"]["gain"] == pytest.approx(-0.125, abs=5e-5)
    assert found["b"]["a"]["gain_ci"] == pytest.approx([-0.125, -0.125], abs=5e-5)


def test_interval_of_the_gain_is_that_of_resampled_differences() -> None:
    """With one run each, by SciPy."""
    rng = np.random.default_rng(4)
    own, other = rng.uniform(0.2, 0.9, (1, 30)), rng.uniform(0.1, 0.9, (1, 30))

    def difference(one: Any, two: Any, axis: int) -> Any:
        return stats.trim_mean(one, 0.25, axis=axis) - stats.trim_mean(two, 0.25, axis=axis)

    direct = stats.bootstrap(
        (*own, *other), difference, n_resamples=2000, paired=True, vectorized=True, axis=-1,
        method="percentile", rng=0,
    ).confidence_interval  # fmt: skip
    found = improvements({"b": other, "a": own})["a"]["b"]
    assert found["gain"] == pytest.approx(float(difference(*own, *other, axis=-1)), abs=5e-5)
    assert found["gain_ci"] == pytest.approx(list(direct), abs=5e-5)
    assert found["gain_ci"][0] < found["gain"] < found["gain_ci"][1]
    back = improvements({"b": other, "a": own})["b"]["a"]["gain_ci"]
    assert back == [-x for x in reversed(found["gain_ci"])]


def test_training_seeds_widen_the_gain_and_the_probability() -> None:
    """A policy whose two runs are 0.1 above and below its base in every episode; three draws."""
    base = np.random.default_rng(6).uniform(0.3, 0.7, (1, 24))
    found = improvements({"base": base, "policy": base + np.array([[-0.1], [0.1]])})["policy"][
        "base"
    ]
    assert found["gain_ci"] == pytest.approx([-0.1, 0.1], abs=5e-5)
    assert (found["p"], found["ci"]) == (0.5, [0.0, 1.0])


def test_profile_is_the_share_of_episodes_above_each_level() -> None:
    scores = np.array([[0.0, 0.2, 0.4, 0.6], [0.2, 0.2, 0.2, 1.0]])
    share, low, high = profile(scores, np.array([-0.1, 0.0, 0.2, 0.5, 1.0]))
    assert share.tolist() == [1.0, 7 / 8, 3 / 8, 2 / 8, 0.0]
    assert (low <= share).all()
    assert (share <= high).all()
    assert low[[0, -1]].tolist() == high[[0, -1]].tolist() == [1.0, 0.0]


def test_band_of_a_profile_is_binomial() -> None:
    scores = np.linspace(0.0, 1.0, 100, endpoint=False)[None]
    _, low, high = profile(scores, np.array([0.295]))
    exact = stats.binom(100, 0.7).ppf([0.025, 0.975]) / 100
    assert [low[0], high[0]] == pytest.approx(exact, abs=0.0101)


def test_quartiles_are_values_and_may_be_infinite() -> None:
    assert quartiles(np.array([4.0, 1.0, 3.0, 2.0])) == [1.0, 3.0]
    assert quartiles(np.array([[1.0, 2.0], [np.inf, np.inf]])) == [1.0, np.inf]


def test_metrics_are_stored_with_four_digits() -> None:
    values = np.array([[0.12345678, 123.45678], [np.inf, 0.0]])
    assert rounded(values).tolist() == [[0.1235, 123.5], [np.inf, 0.0]]


def test_spectrum_holds_the_power_of_a_vibration_at_its_frequency() -> None:
    """A sine of amplitude a has the power a^2 / 2; links' roots add up."""
    sine = 0.3 * np.sin(2.0 * np.pi * 8.0 * TIME)
    still = np.zeros_like(sine)
    frequency, density, share = spectrum([recording(np.column_stack([sine, still]), 0.0)])
    assert share == 1.0
    assert frequency[1] == pytest.approx(0.25)  # a quarter of what a segment of 1 s resolves
    assert frequency[0] == 0.0
    assert frequency[-1] == pytest.approx(25.0)
    assert frequency[density.argmax()] == pytest.approx(8.0, abs=frequency[1])
    assert density.sum() * frequency[1] == pytest.approx(0.3**2 / 2.0, rel=1e-3)
    twice = spectrum([recording(np.column_stack([sine, sine]), 0.0)]).density
    np.testing.assert_allclose(twice, 2.0 * density, rtol=1e-12, atol=1e-15)


def test_spectrum_begins_where_the_target_was_reached() -> None:
    quiet_later = np.where(TIME < 1.5, np.sin(2.0 * np.pi * 8.0 * TIME), 0.0)[:, None]
    assert spectrum([recording(quiet_later, 1.5)]).density.max() < 1e-20
    assert spectrum([recording(quiet_later, 1.0)]).density.max() > 1e-3


def test_the_target_is_as_wide_as_two_percent_of_the_reach() -> None:
    sine = recording(np.sin(2.0 * np.pi * 8.0 * TIME)[:, None], 0.0)
    near = np.full_like(sine.tip_error, 0.039)
    assert spectrum([replace(sine, tip_error=near, reach=2.0)]).share == 1.0
    assert spectrum([replace(sine, tip_error=near)]).share == 0.0


def test_spectrum_does_not_depend_on_the_start_of_the_clock() -> None:
    sine = recording(np.sin(2.0 * np.pi * 8.0 * TIME)[:, None], 0.5)
    found, later = spectrum([sine]), spectrum([replace(sine, time=TIME + 0.005)])
    np.testing.assert_allclose(later.frequency, found.frequency, rtol=1e-12)
    np.testing.assert_allclose(later.density, found.density, rtol=1e-9, atol=1e-15)


def test_spectrum_is_that_of_the_episodes_that_reach_the_target_in_time() -> None:
    """The median of three; the others fail, arrive too late for a segment of 1 s, or never."""
    sine = np.sin(2.0 * np.pi * 8.0 * TIME)[:, None]
    left_out = [recording(9.0 * sine, 0.0, failed=True)]
    left_out += [recording(9.0 * sine, 2.04), recording(9.0 * sine, 9.0)]
    kept = [recording(a * sine, 2.02) for a in (1.0, 2.0, 5.0)]
    found, middle = spectrum([*left_out, *kept]), spectrum([kept[1]])
    assert found.share == 0.5
    np.testing.assert_allclose(found.density, middle.density)
    edge = recording(sine, 0.0)
    left_out.append(replace(edge, tip_error=np.full_like(edge.tip_error, 0.02)))
    nothing = spectrum(left_out)
    assert nothing.share == 0.0
    assert nothing.frequency.tolist() == found.frequency.tolist()
    assert np.isnan(nothing.density).all()


def test_figures_of_known_metrics() -> None:
    metrics = {name: np.linspace(0.0, 0.7, 8).reshape(2, 4) for name in METRICS}
    metrics["success"] = np.array([[1.0, 1.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    metrics["settling_time"] = np.array([[1.0, 1.2, np.inf, 1.4], [1.0, 1.6, 1.5, 1.3]])
    metrics["tip_error_rms"] = 2.0 * metrics["score"]
    metrics["residual_vibration"] = 3.0 * metrics["score"]
    best = Best("settling_time", np.array([1.0, 1.0, 1.0, 0.5]))
    found = figures(metrics, best, learned=True)
    regret = [0.0, 0.2, 4.0, 1.8, 0.0, 0.6, 0.5, 1.6]
    middle = sorted(regret)[2:-2]
    intervals = {"score_ci": "score_iqm", "regret_ci": "regret_iqm"}
    for key, centre in intervals.items():
        low, high = found.pop(key)
        assert low < found[centre] < high
    assert found == {
        "privileged": False,
        "training_seeds": 2,
        "episodes": 4,
        "excess_iqm": None,
        "excess_ci": None,
        "success_rate": 7 / 8,
        "score_mean": pytest.approx(0.35),
        "score_mean_moves": pytest.approx(math.sqrt(0.05 / 3.0 * 2.0 / 4.0)),
        "score_iqm": pytest.approx(0.35),
        "regret_iqm": pytest.approx(sum(middle) / 4),
        "regret_episodes": 4,
        "settling_median": pytest.approx(1.35),
        "settling_quartiles": [1.0, 1.5],
        "tip_error_rms_median": pytest.approx(0.7),
        "residual_vibration_median": pytest.approx(1.05),
        "residual_vibration_quartiles": pytest.approx([0.3, 1.5]),
    }


def test_a_mean_moves_as_much_as_those_of_many_pairs_of_sets() -> None:
    """Two training seeds have one episode's difficulty in common."""
    rng = np.random.default_rng(1)
    sets = rng.normal(size=(400, 2, 1, 200)) + 0.5 * rng.normal(size=(400, 2, 2, 200))
    apart = np.std(sets[:, 0].mean(axis=(1, 2)) - sets[:, 1].mean(axis=(1, 2)))
    assert np.mean([moves(x) for x in sets[:, 0]]) == pytest.approx(apart, rel=0.1)


def test_decisions_have_their_median_and_tail_beside_the_control_step() -> None:
    """The first one starts the controller, and counts by itself."""
    assert decisions(np.array([90.0, 1.0, 30.0, 2.0]), 0.02) == {
        "ms_first_action": 90.0,
        "ms_per_action": 2.0,
        "ms_per_action_p99": pytest.approx(2.0 + 0.98 * 28.0),
        "ms_control_step": pytest.approx(20.0),
        "late_share": pytest.approx(1 / 3),
    }


def test_a_decision_that_takes_the_control_step_is_in_time() -> None:
    times = np.array([90.0, 19.99, 20.0, 20.01])
    assert decisions(times, 0.02)["late_share"] == pytest.approx(1 / 3)


def test_improvements_have_four_decimals_and_no_negative_zero() -> None:
    rng = np.random.default_rng(3)
    scores = {name: rng.uniform(size=(3, 40)) for name in "ab"} | {"c": np.full((1, 40), 0.5)}
    for others in improvements(scores | {"d": scores["c"]}).values():
        for x in others.values():
            values = np.array([x["p"], *x["ci"], x["gain"], *x["gain_ci"]])
            np.testing.assert_array_equal(values, np.round(values, 4))
            assert not np.signbit(values[values == 0.0]).any()


def test_runs_are_not_drawn_as_episodes_are() -> None:
    """With equal draws of both, a run that wins its own episode alone would never lose all."""
    won = np.eye(4)
    found = improvements({"one": won, "none": np.zeros((1, 4))})["one"]["none"]
    assert found["ci"][0] < 0.5 + 0.5 / 4
    _, low, _ = profile(won, np.array([0.5]))
    assert low[0] < 1 / 4


def test_entries_are_compared_by_their_scores() -> None:
    scores = {"a": np.array([[0.5, 0.5]]), "b": np.array([[0.25, 0.75]])}
    nothing = Spectrum(np.zeros(1), np.zeros(1), 0.0)
    entries = {
        name: Entry({"privileged": False}, {"score": s}, nothing, [7, 8])
        for name, s in scores.items()
    }
    told = Entry({"privileged": True}, {"score": np.array([[0.9]])}, nothing, [8])
    found = compared(entries | {"told": told})
    assert found.pop("told").figures == {"privileged": True, "improvement": {}}
    assert {name: entry.figures for name, entry in found.items()} == {
        name: {"privileged": False, "improvement": x} for name, x in improvements(scores).items()
    }
    assert found["a"].spectrum is nothing
    assert found["b"].metrics["score"] is scores["b"]
    with pytest.raises(FrozenInstanceError):
        found["a"].figures = {}  # type: ignore[misc]


def test_what_a_controller_is_has_to_be_named() -> None:
    metrics = {key: np.ones((1, 4)) for key in METRICS}
    with pytest.raises(TypeError):
        figures(metrics, None, True)  # type: ignore[misc]


def test_figures_without_a_bound_have_no_regret() -> None:
    metrics = {name: np.linspace(0.0, 1.0, 8)[None] for name in METRICS}
    found = figures(metrics, None)
    assert found["training_seeds"] == 0  # not a learned one
    assert found["regret_iqm"] is None
    assert found["regret_ci"] is None
    assert found["regret_episodes"] == 0


def test_regret_of_a_path_is_that_of_its_rms_where_a_best_is_known() -> None:
    metrics = {name: np.array([[1.0, 3.0, 9.0, 5.0]]) for name in METRICS}
    metrics["tip_error_rms"] = np.array([[2.0, 4.0, 9.0, 6.0]])
    best = Best("tip_error_rms", np.array([1.0, 2.0, np.nan, 4.0]))
    found = figures(metrics, best)
    assert found["regret_iqm"] == pytest.approx((1.0 + 1.0 + 0.5) / 3.0)
    assert found["regret_episodes"] == 3


def test_excess_of_a_path_is_its_rms_less_the_smallest_known() -> None:
    """The middle half of 1, 2, 2, 50; in other tasks there is none."""
    metrics = {name: np.array([[1.0, 3.0, 9.0, 5.0, 7.0]]) for name in METRICS}
    metrics["tip_error_rms"] = np.array([[2.0, 4.0, 9.0, 6.0, 52.0]])
    best = Best("tip_error_rms", np.array([1.0, 2.0, np.nan, 4.0, 2.0]))
    found = figures(metrics, best)
    assert found["excess_iqm"] == pytest.approx(2.0)
    low, high = found["excess_ci"]
    assert 1.0 <= low < 2.0 < high <= 50.0
    resting = figures(metrics, replace(best, metric="settling_time"))
    assert resting["excess_iqm"] is resting["excess_ci"] is None


@pytest.mark.parametrize(
    ("failed", "middle", "ends"),
    [(1, 1.0, [1.0, np.inf]), (4, np.inf, [1.0, np.inf]), (7, np.inf, [np.inf, np.inf])],
)
def test_excess_is_infinite_where_a_quarter_of_the_episodes_failed(
    failed: int, middle: float, ends: list[float]
) -> None:
    """Of 8 episodes the middle half leaves out two on either side."""
    rms = np.full((1, 8), 1.5)
    rms[0, :failed] = np.inf
    best = Best("tip_error_rms", np.full(8, 0.5))
    metrics = dict.fromkeys(METRICS, rms) | {"score": np.isfinite(rms).astype(float)}
    found = figures(metrics, best)
    assert found["excess_iqm"] == middle
    assert found["excess_ci"] == ends
