"""Fits of what a rig has beyond its arm: late sensors, friction, torque constants, drift."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.signal import lsim

from benchmarks.accuracy.measured_data import GAUGE, PRESET, STIFFER, clean_log, noisy, rig, truth
from dynamics import Arm, Stepper, compile_arm, load_arm
from dynamics.measured.fit import BOUNDS, Fit, Gauge, LinkAngle, TipSlope, fit
from dynamics.measured.log_file import Log
from dynamics.measured.motion import LoggedMotion
from dynamics.measured.readings import Readings, delayed, low_passed
from dynamics.measured.sensors import Sensor
from dynamics.types import Array

LATE = 4  # samples of 5 ms
DELAY = {"delay_gauge_1": (0.0, 0.05)}
FRICTION = {"viscous_1": (0.0, 0.05), "coulomb_1": (0.0, 0.01), "torque_1": (0.5, 2.0)}


@pytest.fixture(scope="module")
def clean() -> Log:
    return clean_log(rig())


def late(log: Log) -> Log:
    """The log of a gauge that is 20 ms late."""
    return replace(log, gauge=np.vstack([log.gauge[:1].repeat(LATE, axis=0), log.gauge[:-LATE]]))


def misses(found: Fit, true: Array) -> Array:
    """Errors of the first parameters over the deviations that the fit states."""
    return (found.values - true)[: true.size] / np.sqrt(np.diag(found.covariance))[: true.size]


def test_a_late_gauge_gives_a_false_damping_unless_its_delay_is_fitted(clean: Log) -> None:
    log = late(noisy(clean, 0))
    false = fit(PRESET, log, [GAUGE])
    assert false.values[1] > 1.2 * truth()[1]
    found = fit(PRESET, log, [GAUGE], BOUNDS | DELAY)
    assert np.abs(misses(found, np.array([*truth(), LATE * 0.005]))).max() < 3.5
    assert found.explained(found.fitted)[1] > false.explained(false.fitted)[1]


def test_the_gain_of_a_gauge_is_fitted(clean: Log) -> None:
    log = noisy(clean, 0)
    found = fit(PRESET, replace(log, gauge=0.8 * log.gauge), [GAUGE],
                BOUNDS | {"gain_gauge_1": (0.5, 2.0)})  # fmt: skip
    assert np.abs(misses(found, np.array([*truth(), 0.8]))).max() < 3.5


def rubbing(viscous: float = 0.004, coulomb: float = 0.002) -> Arm:
    arm = rig()
    joint = replace(arm.links[0].joint, viscous=viscous, coulomb=coulomb)
    return replace(arm, links=(replace(arm.links[0], joint=joint),))


def test_friction_and_torque_constant_of_a_joint_are_fitted() -> None:
    """In SI units, whatever friction the arm is described with."""
    log = noisy(clean_log(rubbing()), 0)
    found = fit(PRESET, replace(log, command=log.command / 1.25), [GAUGE], FRICTION | BOUNDS)
    assert list(found.bounds)[:3] == ["viscous_1", "coulomb_1", "torque_1"]
    assert np.abs(misses(found, np.array([0.004, 0.002, 1.25, *truth()]))).max() < 3.5
    assert np.abs(found.correlation).max() < 0.2


def test_a_free_friction_is_that_of_the_arm() -> None:
    """Steps with friction in the arm and with friction as parameters agree to round-off."""
    described = compile_arm(rubbing())
    free = compile_arm(rubbing(0.0, 0.0), free_parameters=["viscous_1", "coulomb_1"])
    steppers = [Stepper(model, 2, dt=1e-3, substeps=50) for model in (described, free)]
    steppers[1].parameters[:] = 0.004, 0.002
    for stepper in steppers:
        stepper.torque[:] = 0.05
        stepper.advance()
    assert_allclose(steppers[0].q, steppers[1].q, rtol=1e-12)
    assert np.abs(steppers[0].q).max() > 0.01
    with pytest.raises(ValueError, match=r"viscous_2 is of no joint: this arm has 1 joints"):
        compile_arm(rig(), free_parameters=["viscous_2"]).accelerations(*3 * [np.zeros(3)])


def test_a_slower_encoder_is_compared_at_its_readings(clean: Log) -> None:
    log = noisy(clean, 0)
    encoder = log.encoder.copy()
    encoder[1::3] = encoder[2::3] = np.nan
    found = fit(PRESET, replace(clean, encoder=np.where(np.isnan(encoder), np.nan, clean.encoder)),
                [GAUGE])  # fmt: skip
    assert_allclose(found.values, truth(), rtol=1e-5)
    found = fit(PRESET, replace(log, encoder=encoder), [GAUGE])
    assert np.abs(misses(found, truth())).max() < 3.5
    assert np.isnan(found.measured[1, 0])
    assert np.isfinite(found.fitted).all()


def test_a_late_first_reading_tells_the_start_within_what_the_joint_may_have_turned(
    clean: Log,
) -> None:
    """As a reading does not, whose noise is all that parts it from the angle at its own time."""
    weights, found = np.array([1e6, 1.0]), []
    for first in (0, 60):
        encoder = clean.encoder.copy()
        encoder[:first] = np.nan
        table = LoggedMotion(PRESET, replace(clean, encoder=encoder), [GAUGE], BOUNDS).unknowns
        found.append(table.precision(weights)[table.names.index("q1")])
    turned = abs(clean.encoder[60, 0] - clean.encoder[0, 0])
    assert found[0] == 1e6
    assert 0.01 < turned * found[1] < 1.0


@pytest.mark.parametrize(("name", "times"), [("delay", 1.0), ("lag", 2.0)])
def test_a_late_encoder_tells_the_start_within_what_the_joint_may_have_turned(
    clean: Log, name: str, times: float
) -> None:
    log, most = clean.since(1.0), 0.05  # [s]
    table = LoggedMotion(PRESET, log, [GAUGE], {f"{name}_encoder_1": (0.0, most)}).unknowns
    known = table.precision(np.array([1e6, 1.0]))[table.names.index("q1")]
    rate = np.abs(np.diff(log.encoder[:, 0]) / np.diff(log.time)).max()
    assert 1.0 / known == pytest.approx(times * most * rate)


def test_a_measured_start_is_the_state_of_the_rig(clean: Log) -> None:
    """Readings and their rates at all points of the log without noise, by their neighbours."""
    motion = LoggedMotion(PRESET, clean, [GAUGE], BOUNDS, start="measured", shooting=0.5)
    assert motion.restarts == {100, 200, 300, 400, 500}
    signals = np.hstack([clean.encoder, clean.gauge])
    rates = np.gradient(signals, clean.time, axis=0)
    for k in motion.restarts:
        q, v = motion.state(motion.unknowns.nominal, k)
        assert np.all(np.abs(motion.rows @ q - signals[k]) < 0.02 * signals.std(axis=0))
        assert np.all(np.abs(motion.rows @ v - rates[k]) < 0.2 * rates.std(axis=0))


def test_shooting_keeps_a_drift_from_the_parameters() -> None:
    """A constant torque that nobody logged turns the joint away; segments of half a second
    follow."""
    log = noisy(clean_log(rig()), 0)
    t = log.time[:, None]
    drifting = replace(log, encoder=log.encoder + 0.1 * t**2)
    whole = fit(PRESET, drifting, [GAUGE], start="measured")
    pieces = fit(PRESET, drifting, [GAUGE], start="measured", shooting=0.5)
    errors = [abs(found.values[0] / STIFFER - 1.0) for found in (whole, pieces)]
    assert errors[1] < 0.02
    assert pieces.explained(pieces.fitted)[0] > 0.99 > whole.explained(whole.fitted)[0]


@pytest.mark.parametrize("segments", [1, 3])
def test_angles_of_a_bent_link_are_integrals_of_its_curvature(segments: int) -> None:
    arm = load_arm("two-link")
    second = replace(arm.links[1], segments=segments)
    if segments > 1:
        modes = tuple(replace(mode, kind="hierarchical") for mode in second.modes)
        second = replace(second, modes=modes)
    model = compile_arm(replace(arm, links=(arm.links[0], second)))
    q = 0.01 * np.random.default_rng(0).standard_normal(model.n)
    length = second.length
    points = [length * k / segments for k in range(1, segments)] or None

    def integral(weight: Array) -> float:
        def curvature(x: float) -> float:
            return float(model.strain(q, 1, x)[2] * np.polyval(weight, x))

        return quad(curvature, 0.0, length, points=points, epsabs=1e-9)[0]

    assert TipSlope(link=1).row(model) @ q == pytest.approx(integral(np.array([1.0])), rel=1e-6)
    angle = integral(np.array([-1.0, length])) / length
    assert LinkAngle(link=1).row(model) @ q == pytest.approx(angle, rel=1e-6)


def test_link_angles_and_slopes_are_signals(clean: Log) -> None:
    """All proportional to the gauge's reading where a link bends in one mode."""
    one = load_arm(PRESET)
    one = replace(one, links=(replace(one.links[0], modes=one.links[0].modes[:1]),))
    model = compile_arm(one)
    sensors: list[Sensor] = [LinkAngle(link=0), TipSlope(link=0), GAUGE]
    rows = np.stack([sensor.row(model) for sensor in sensors])
    factors = rows[:, 1] / rows[2, 1]
    log = noisy(clean, 0)
    found = fit(one, replace(log, gauge=log.gauge * factors), sensors)
    assert found.signals == ("encoder 1", "link angle 1", "tip slope 1", "gauge 1")
    change = found.values - fit(one, log, [GAUGE]).values
    assert np.all(np.abs(change) < np.sqrt(np.diag(found.covariance)))


def test_the_explained_variance_is_one_less_that_of_the_residual(clean: Log) -> None:
    found = fit(PRESET, noisy(clean, 0), [GAUGE])
    residual = (found.fitted - found.measured).var(axis=0)
    assert_allclose(found.explained(found.fitted), 1.0 - residual / found.measured.var(axis=0))
    signals = found.to_dict()["signals"]
    assert signals["gauge 1"]["explained"] == pytest.approx(found.explained(found.fitted)[1])


def test_readings_follow_cubics_through_gaps() -> None:
    t = np.linspace(0.0, 2.0, 101) ** 1.2
    cubic, rate = np.poly1d([1.0, -2.0, 0.5, 3.0]), np.poly1d([3.0, -4.0, 0.5])
    measured = np.stack([cubic(t), np.where(np.arange(101) % 3, np.nan, cubic(t))], axis=1)
    at = np.array([[0.31, 1.7], [2.0, 0.01]])
    values, rates = Readings(t, measured, 0.2).at(at)
    assert_allclose(values, cubic(at), rtol=1e-9)
    assert_allclose(rates, rate(at), rtol=1e-8, atol=1e-9)


def test_a_delay_reads_the_motion_before() -> None:
    """Exact for cubics, also behind a new start."""
    t = np.linspace(0.0, 1.0, 11) ** 1.1
    cubic = np.poly1d([1.0, -2.0, 0.5, 3.0])
    signals = np.stack([cubic(t), cubic.deriv()(t)])[:, :, None, None].repeat(2, axis=2)
    delay = np.array([[0.013], [0.25]])
    read = delayed(t, signals, signals, delay)
    there = t[:, None] - delay[:, 0] >= 0.0
    assert_allclose(read[..., 0][there], cubic(t[:, None] - delay[:, 0])[there], rtol=1e-12)
    jump = (
        signals + 5.0 * (np.arange(11) >= 4)[:, None, None] * np.array([1, 0])[:, None, None, None]
    )
    before = jump.copy()
    before[0, 4] -= 5.0
    late = delayed(t, jump, before, np.full((2, 1), 1e-9))
    assert_allclose(late[4, 0, 0], cubic(t[4]), atol=1e-6)
    assert_allclose(late[5, 0, 0], cubic(t[5]) + 5.0, atol=1e-6)


def test_a_low_pass_answers_a_sine_as_its_transfer_function() -> None:
    """1 / (1 + i w T), after the transient, and the rate with it."""
    t, omega, lag = np.linspace(0.0, 3.0, 601), 9.0, np.array([[0.05, 0.1, 0.0]])
    wave = np.exp(1j * omega * t)[:, None, None] * np.ones((1, 3))
    signals = np.stack([wave.imag, (1j * omega * wave).imag])
    after, before = low_passed(t, signals, signals, lag)
    through = wave / (1.0 + 1j * omega * lag)
    for found in (after[:, 400:], before[:, 400:]):
        assert_allclose(found[0], through.imag[400:], atol=1e-5)
        assert_allclose(found[1], (1j * omega * through).imag[400:], atol=2e-4)


def test_the_time_constant_of_a_filtered_gauge_is_fitted(clean: Log) -> None:
    """The gauge behind a low pass of scipy's, fast enough to take away a third."""
    through = ([1.0], np.polymul((0.06, 1.0), (0.06, 1.0)))
    filtered = lsim(through, clean.gauge[:, 0], clean.time)[1]
    log = noisy(replace(clean, gauge=filtered[:, None]), 0)
    found = fit(PRESET, log, [GAUGE], BOUNDS | {"lag_gauge_1": (0.0, 0.1)}, start="rest")
    assert np.abs(misses(found, np.array([*truth(), 0.06]))).max() < 3.5


@pytest.mark.parametrize(
    ("gauges", "how", "sentence"),
    [
        ([GAUGE], {"shooting": 0.5}, 'shooting needs start "measured"'),
        ([GAUGE], {"shooting": -1.0, "start": "measured"}, "shooting must be positive"),
        ([GAUGE], {"bounds": {"viscous_2": (0.0, 1.0)}}, "Unknown parameter 'viscous_2'"),
        ([GAUGE], {"bounds": {"delay_gauge_2": (0.0, 1.0)}}, "did you mean 'delay_gauge_1'"),
        ([TipSlope(link=1)], {}, "TipSlope.link must be between 0 and 0, got 1"),
        ([TipSlope(link=0), Gauge(link=0, x=0.02, distance=1e-6)], {}, "^gauge 1 reads a change"),
        ([GAUGE] * 3, {"start": "measured"}, "got 2 modes and 3 gauges"),
    ],
)
def test_what_a_rig_cannot_have_is_refused(
    gauges: list[Sensor], how: dict[str, object], sentence: str, clean: Log
) -> None:
    log = replace(clean, gauge=clean.gauge.repeat(len(gauges), axis=1))
    with pytest.raises(ValueError, match=sentence):
        fit(PRESET, log, gauges, **how)  # type: ignore[arg-type]
