"""Fits of logs that this package makes: known parameters come back within their intervals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.accuracy.measured_data import (
    GAUGE,
    PRESET,
    STIFFER,
    Held,
    clean_log,
    holds,
    noisy,
    rig,
    truth,
)
from dynamics import Arm, compile_arm, load_arm, simulate
from dynamics.measured.fit import Gauge, fit
from dynamics.measured.log_file import Log
from dynamics.measured.motion import LoggedMotion
from dynamics.progress import Progress
from dynamics.simulation.sampled_motion import SampledMotion

N_LOG = 12


@pytest.fixture(scope="module")
def clean() -> Log:
    return clean_log(rig())


def test_known_parameters_come_back_within_their_intervals(clean: Log) -> None:
    """About 95 of 100 intervals hold the truth, and estimates scatter as their covariances say."""
    fits = [fit(PRESET, noisy(clean, seed), [GAUGE]) for seed in range(N_LOG)]
    held = np.array([holds(one) for one in fits])
    assert held.sum() >= 20  # of 24; fewer come once in 500 times
    scatter = [(one.values - truth()) / np.sqrt(np.diag(one.covariance)) for one in fits]
    assert 0.6 < np.sqrt(np.mean(np.square(scatter))) < 1.45  # 3 deviations of 24 normal numbers
    assert all(np.abs(one.correlation).max() < 0.2 for one in fits)


def test_without_noise_the_parameters_are_exact(clean: Log) -> None:
    """Of an arm that another integrator moved; to the accuracy of the fit's own steps."""
    found = fit(PRESET, clean, [GAUGE])
    assert_allclose(found.values, truth(), rtol=1e-6)
    assert np.all(found.rms(found.fitted) < 1e-3 * found.rms(found.nominal))


def test_constant_offsets_of_sensors_do_not_matter(clean: Log) -> None:
    log = noisy(clean, 0)
    shifted = replace(log, encoder=log.encoder + 3.0, gauge=log.gauge - 1e-3)
    one, other = (fit(PRESET, x, [GAUGE]) for x in (log, shifted))
    assert_allclose(one.values, other.values, rtol=1e-6)
    assert_allclose(one.intervals, other.intervals, rtol=1e-6)


def test_a_truth_outside_the_bounds_ends_at_a_bound(clean: Log) -> None:
    found = fit(PRESET, clean, [GAUGE], {"stiffness": (0.5, 1.1)})
    assert found.at_bound == ["stiffness"]
    assert found.values[0] == pytest.approx(1.1)
    assert fit(PRESET, clean, [GAUGE], {"stiffness": (0.5, 2.0)}).at_bound == []


def test_dry_friction_that_the_arm_lacks_colours_the_residual() -> None:
    found = fit(PRESET, noisy(clean_log(rig(2e-3)), 0), [GAUGE])
    assert np.abs(found.correlation).max() > 0.2
    assert not holds(found).all()


def test_two_links_with_two_commands_and_two_gauges() -> None:
    arm = load_arm("two-link")
    stiffer = replace(arm, links=tuple(replace(x, EIz=STIFFER * (x.EIz or 0.0)) for x in arm.links))
    t = 0.01 * np.arange(150.0)
    torque = 0.02 * np.sign(np.sin(8.0 * t))
    model = compile_arm(stiffer)
    command = Held(t, torque)

    def both(s: float) -> np.ndarray:
        return np.repeat(command(s), 2) * [1.0, 0.3]

    both.breakpoints = t  # type: ignore[attr-defined]
    motion = simulate(model, np.zeros(model.n), np.zeros(model.n), both, t)
    gauges = [Gauge(link=k, x=0.05) for k in range(2)]
    strain = [[model.strain(q, g.link, g.x)[2] for g in gauges] for q in motion.q]
    joints = motion.q[:, list(arm.joint_index)]
    log = Log(t, torque[:, None] * [1.0, 0.3], joints, np.array(strain))
    found = fit(arm, log, gauges, {"stiffness": (0.5, 2.0)})
    assert found.values[0] == pytest.approx(STIFFER, rel=2e-4)
    assert found.signals == ("encoder 1", "encoder 2", "gauge 1", "gauge 2")


def stiff_without_damping() -> Arm:
    arm = load_arm(PRESET)
    return replace(arm, links=(replace(arm.links[0], damping_ratio=0.0),))


@pytest.mark.parametrize(
    ("arm", "bounds", "sentence"),
    [
        (PRESET, {"stifness": (0.5, 2.0)}, "stifness"),
        (PRESET, {}, "needs at least one"),
        (PRESET, {"stiffness": (2.0, 0.5)}, "0 <= low < high"),
        (PRESET, {"stiffness": (0.5, float("nan"))}, "bounds of stiffness"),
        (stiff_without_damping(), {"damping": (0.0, 2.0)}, "damping has no effect"),
        (
            PRESET,
            dict.fromkeys(("friction", "viscous_1"), (0.0, 2.0)),
            r"friction \(.*\) beside viscous_1",
        ),
        ("two-link", None, "The arm needs 2 commands, got 1"),
        ("free-flyer", None, "needs a fixed base"),
    ],
)
def test_what_cannot_be_fitted_is_refused(
    clean: Log, arm: str | Arm, bounds: dict[str, tuple[float, float]], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        fit(arm, clean, [GAUGE], bounds)


def test_an_arm_that_gravity_bends_does_not_start_straight(clean: Log) -> None:
    arm = replace(load_arm(PRESET), gravity=(0.0, -9.81, 0.0))
    with pytest.raises(ValueError, match="Gravity bends this arm"):
        fit(arm, clean, [GAUGE], {"stiffness": (0.5, 2.0)}, start="rest")


def test_the_steps_are_halved_until_the_signals_converge(clean: Log) -> None:
    bounds = {"stiffness": (0.2, 5.0), "damping": (0.0, 20.0)}
    motion = LoggedMotion(PRESET, clean, [GAUGE], bounds, start="rest")
    corner = np.array([[5.0, 20.0]])
    motion.refine(corner)
    coarse = motion.signals(corner)
    motion.substeps *= 4
    change = np.abs(motion.signals(corner) - coarse).max(axis=(0, 1)) / motion.deviation
    assert np.all(change < 1e-3)
    assert np.isfinite(coarse).all()


def test_a_fit_tells_its_stage_and_its_motions_if_asked(
    clean: Log, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as are simulated before the two that it returns; one that is not asked is silent."""
    simulated = [0]
    follow = SampledMotion.__call__

    def counted(self: SampledMotion, *given: Any) -> Any:
        simulated[0] += given[-1].shape[-1]
        return follow(self, *given)

    monkeypatch.setattr(SampledMotion, "__call__", counted)
    shown, bounds = Progress(True), {"stiffness": (0.5, 2.0)}
    monkeypatch.setattr("dynamics.measured.fit.Progress", lambda asked: shown)
    fit(PRESET, clean, [GAUGE], bounds, start="rest", progress=True)
    assert f"solution: {simulated[0] - 2} motions" in str(shown._bar)
    assert "search: " in capsys.readouterr().err
    monkeypatch.undo()
    fit(PRESET, clean, [GAUGE], bounds, start="rest")
    assert capsys.readouterr().err == ""
