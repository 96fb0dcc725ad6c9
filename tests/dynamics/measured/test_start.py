"""Logs that do not start at rest: free decays, held joints, joints in motion."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from benchmarks.accuracy.measured_data import GAUGE, PRESET, STIFFER, clean_log, rig, truth
from benchmarks.output import RESULTS
from dynamics import Arm, Mode, Model, compile_arm, load_arm, simulate
from dynamics.description.mode_shapes import shape
from dynamics.formulations import linearized
from dynamics.measured.fit import Fit, Gauge, fit
from dynamics.measured.log_file import Columns, Log, read_log
from dynamics.measured.motion import LoggedMotion
from dynamics.measured.unknowns import locked_modes
from dynamics.types import Array

HELD = {0: None}
BENDING = np.array([1.8751040687, 4.6940911330])  # of a cantilever: cos x cosh x = -1
NARROW = {"stiffness": (0.8, 1.8), "damping": (0.5, 5.0)}
N_DECAY = 40


def log_of(t: Array, gauge: Array, encoder: Array | None = None) -> Log:
    """A log without torque, of (N, c) signals."""
    none = np.zeros((t.size, 0))
    return Log(t, none, none if encoder is None else encoder, gauge)


def decay(
    seed: int | None, stiffness: float = STIFFER, duration: float = 2.0, ratio: float = 0.02
) -> Log:
    """Strain of a clamped ruler after a pluck by formula: two damped cosines, noise, an offset."""
    link = load_arm(PRESET).links[0]
    omega = (BENDING / link.length) ** 2 * np.sqrt(stiffness * (link.EIz or 0.0) / link.rho_A)
    t: Array = np.arange(0.0, duration, 0.01)
    strain: Array = 1e-4 + np.zeros(t.size)
    for size, w, phase in zip((3e-4, 5e-5), omega, (0.3, 1.0), strict=True):
        strain += size * np.exp(-ratio * w * t) * np.cos(w * np.sqrt(1.0 - ratio**2) * t + phase)
    if seed is not None:
        strain += 1e-5 * np.random.default_rng(seed).standard_normal(t.size)
    return log_of(t, strain[:, None])


def deviations(found: Fit, true: Array) -> Array:
    """Errors of the estimates over the deviations that the fit states."""
    return (found.values - true) / np.sqrt(np.diag(found.covariance))


def with_noise(log: Log, seed: int = 0) -> Log:
    """1 mrad and 3 % of the gauges."""
    rng = np.random.default_rng(seed)
    gauge = 0.03 * log.gauge.std(axis=0) * rng.standard_normal(log.gauge.shape)
    encoder = 1e-3 * rng.standard_normal(log.encoder.shape)
    return replace(log, gauge=log.gauge + gauge, encoder=log.encoder + encoder)


def test_intervals_of_a_held_decay_hold_the_truth() -> None:
    """About 95 of 100, though the start is fitted too; estimates scatter as covariances say."""
    fits = [fit(PRESET, decay(seed), [GAUGE], NARROW, held=HELD) for seed in range(N_DECAY)]
    low, high = np.stack([one.intervals for one in fits]).T
    held = np.sum((truth() >= low.T) & (truth() <= high.T))
    assert held >= 69  # of 80; fewer come once in 1000 times
    scatter = np.sqrt(np.mean([deviations(one, truth()) ** 2 for one in fits]))
    assert 0.75 < scatter < 1.25  # 3 deviations of 80 normal numbers
    assert all(np.abs(one.correlation).max() < 0.3 for one in fits)


def test_a_decay_without_noise_gives_the_locked_frequency_and_its_ratio() -> None:
    found = fit(PRESET, decay(None), [GAUGE], held=HELD)
    assert_allclose(found.values, truth(), rtol=1e-7)
    assert found.signals == ("gauge 1",)


@pytest.mark.parametrize("stiffness", [1.184, 3.817])
def test_a_decay_of_many_cycles_is_found_from_afar(stiffness: float) -> None:
    """A hundred cycles and more: a valley is a hundredth of the stiffness wide, one is lowest."""
    arm = load_arm(PRESET)
    arm = replace(arm, links=(replace(arm.links[0], damping_ratio=0.001),))
    log = decay(0, stiffness, duration=40.0, ratio=0.001 / np.sqrt(stiffness))
    found = fit(arm, log, [GAUGE], {"stiffness": (0.2, 5.0), "damping": (0.5, 2.0)}, held=HELD)
    assert np.abs(deviations(found, np.array([stiffness, 1.0]))).max() < 3.5


def test_the_steps_are_as_fine_as_little_noise_needs() -> None:
    """A hundred-thousandth of noise: twice as long steps would be five deviations wrong."""
    arm = load_arm(PRESET)
    arm = replace(arm, links=(replace(arm.links[0], damping_ratio=0.001),))
    log = decay(None, STIFFER, duration=8.0, ratio=0.001 / np.sqrt(STIFFER))
    noise = 3e-9 * np.random.default_rng(0).standard_normal(log.gauge.shape)
    log = replace(log, gauge=log.gauge + noise)
    found = fit(arm, log, [GAUGE], {"stiffness": (1.1, 1.3)}, held=HELD)
    assert np.abs(deviations(found, np.array([STIFFER]))).max() < 3.5


def moved(arm: Arm, q: Array, v: Array, gauges: list[Gauge], t: Array) -> Log:
    """The log, without noise, of a free motion by SciPy's integrator."""
    model = compile_arm(arm)
    motion = simulate(model, q, v, None, t)
    strain = [[g.distance * model.strain(x, g.link, g.x)[2] for g in gauges] for x in motion.q]
    return log_of(t, np.array(strain), motion.q[:, list(arm.joint_index)])


def bent(model: Model, joints: list[float], force: float) -> Array:
    """(n,) joints at angles, and links bent by equal modal forces [N]."""
    q = np.zeros(model.n)
    index = list(model.arm.joint_index)
    q[index] = joints
    flexible = np.delete(np.arange(model.n), index)
    K = model.stiffness[np.ix_(flexible, flexible)]
    q[flexible] = np.linalg.solve(K, np.full(flexible.size, force))
    return q


def stiffer(arm: Arm) -> Arm:
    return replace(arm, links=tuple(replace(x, EIz=STIFFER * (x.EIz or 0.0)) for x in arm.links))


def test_two_plucked_links_with_free_joints() -> None:
    arm, gauges = load_arm("two-link"), [Gauge(link=k, x=0.05) for k in range(2)]
    t = np.arange(0.0, 2.0, 0.01)
    q = bent(compile_arm(stiffer(arm)), [0.3, 0.8], 0.05)
    log = moved(stiffer(arm), q, 0.0 * q, gauges, t)
    true = np.array([STIFFER, np.sqrt(STIFFER)])
    bounds = {"stiffness": (0.5, 2.0), "damping": (0.0, 5.0)}
    assert_allclose(fit(arm, log, gauges, bounds).values, true, rtol=1e-4)
    found = fit(arm, with_noise(log), gauges, bounds)
    assert np.abs(deviations(found, true)).max() < 3.5
    starts = [found.start[name][0] for name in ("q1", "q2", "d1_1", "d2_1")]
    assert_allclose(starts, q[[0, 3, 1, 4]], rtol=0.1)


def test_a_log_that_starts_in_motion() -> None:
    """A joint that turns and a link that swings; from rest no arm would move like that."""
    model = compile_arm(rig())
    t: Array = np.arange(0.0, 2.0, 0.01)
    log = moved(rig(), bent(model, [0.5], 0.1), np.array([2.0, 0.2, 0.0]), [GAUGE], t)
    log = with_noise(replace(log, command=np.zeros((t.size, 1))))
    found = fit(PRESET, log, [GAUGE])
    assert np.abs(deviations(found, truth())).max() < 3.5
    assert found.start["q1"] == pytest.approx((0.5, 2.0), abs=0.05)
    assert found.start["d1_1"][1] == pytest.approx(0.2, abs=0.02)
    pushed = replace(log, command=np.full((t.size, 1), 1e-9))
    with pytest.raises(ValueError, match=r"resembles encoder 1, gauge 1; .*start be estimated"):
        fit(PRESET, pushed, [GAUGE], start="rest")


def test_a_held_joint_of_two_is_a_weld() -> None:
    """The elbow held at an angle, the other joint free, by matrices without the elbow's row."""
    arm, gauges, angle = load_arm("two-link"), [Gauge(link=k, x=0.05) for k in range(2)], 0.8
    model = compile_arm(stiffer(arm))
    elbow = arm.joint_index[1]
    q = bent(model, [0.0, angle], 1e-4)
    M, K, C = (
        np.delete(np.delete(X, elbow, 0), elbow, 1)
        for X in (model.mass_matrix(q), model.stiffness, linearized.damping(model.chain))
    )
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    step, x = expm(0.01 * A), np.append(np.delete(q, elbow), np.zeros(n))
    states = []
    for _ in range(300):
        states.append(x[:n])
        x = step @ x
    bends = np.array([[model.strain(u, g.link, g.x)[2] for u in np.eye(model.n)] for g in gauges])
    gauge = np.array(states) @ np.delete(bends, elbow, 1).T
    log = log_of(0.01 * np.arange(300.0), gauge, np.array(states)[:, :1])
    bounds = {"stiffness": (0.5, 2.0)}
    found = fit(arm, log, gauges, bounds, held={1: angle})
    assert found.values[0] == pytest.approx(STIFFER, rel=1e-4)
    assert found.signals == ("encoder 1", "gauge 1", "gauge 2")
    both = replace(log, encoder=np.column_stack([log.encoder, np.full(300, angle)]))
    assert fit(arm, both, gauges, bounds, held={1: None}).values == pytest.approx(found.values)
    stretched = fit(arm, log, gauges, bounds, held={1: 0.0})
    assert stretched.values[0] != pytest.approx(STIFFER, rel=1e-2)


def test_a_held_arm_may_hang_in_gravity() -> None:
    """On an incline a clamp with a huge rotor holds the ruler; it swings about its sag."""
    gravity = (0.0, -2.0, 0.0)
    ruler = rig()
    clamped = replace(ruler.links[0], joint=replace(ruler.links[0].joint, rotor_inertia=1e7))
    true_rig = replace(ruler, links=(clamped,), gravity=gravity)
    q = bent(compile_arm(true_rig), [0.2], 0.05)
    log = moved(true_rig, q, 0.0 * q, [GAUGE], np.arange(0.0, 2.0, 0.01))
    arm = replace(load_arm(PRESET), gravity=gravity)
    found = fit(arm, replace(log, encoder=log.encoder[:, :0]), [GAUGE], held={0: 0.2})
    assert_allclose(found.values, truth(), rtol=1e-4)


def test_modes_faster_than_the_samples_start_at_their_sag() -> None:
    """A ruler is plucked in gravity; its second mode is as fast as the samples, and at rest."""
    ruler = rig()
    clamped = replace(ruler.links[0], joint=replace(ruler.links[0].joint, rotor_inertia=1e7))
    true_rig = replace(ruler, links=(clamped,), gravity=(0.0, -4.0, 0.0))
    q = compile_arm(true_rig).equilibrium([0.2]).q + np.array([0.0, 0.02, 0.0])
    log = moved(true_rig, q, 0.0 * q, [GAUGE], np.arange(0.0, 2.0, 0.05))
    arm = replace(load_arm(PRESET), gravity=true_rig.gravity)
    found = fit(arm, replace(log, encoder=log.encoder[:, :0]), [GAUGE], held={0: 0.2})
    assert_allclose(found.values, truth(), rtol=1e-4)


@pytest.mark.parametrize("angle", [0.2, 1.0])
def test_a_measured_start_at_rest_in_gravity_is_the_equilibrium(angle: float) -> None:
    """Of the arm with the parameters' values, in both modes, from the strain of one gauge."""
    ruler = replace(load_arm(PRESET), gravity=(0.0, -4.0, 0.0))
    link = ruler.links[0]
    heavier = replace(link, EIz=STIFFER * (link.EIz or 0.0), tip_mass=0.02)
    model = compile_arm(replace(ruler, links=(heavier,)))
    q = model.equilibrium([angle]).q
    t = np.arange(0.0, 1.0, 0.01)  # signals are cubics, of which readings are exact
    log = log_of(t, GAUGE.row(model) @ q + 1e-3 * t[:, None] ** 3, angle + t[:, None] ** 2)
    bounds = {"stiffness": (0.5, 2.0), "payload_mass": (0.0, 0.1)}
    motion = LoggedMotion(ruler, log, [GAUGE], bounds, start="measured")
    values = dict(zip(motion.unknowns.names, motion.unknowns.nominal, strict=True))
    values |= {"stiffness": STIFFER, "payload_mass": 0.02}
    found = motion.state(np.array([*values.values()]))
    assert_allclose(found[0], q, rtol=1e-9)
    assert_allclose(motion.state(np.array([[*values.values()]] * 2))[0], [found[0]] * 2)


@pytest.mark.parametrize("shooting", [None, 0.5])
def test_gravity_leaves_a_measured_start_its_fit(shooting: float | None) -> None:
    """The clamped ruler is linear: gravity adds a sag, and to the strain a constant."""
    ruler = rig()
    clamped = replace(ruler.links[0], joint=replace(ruler.links[0].joint, rotor_inertia=1e7))
    fits = []
    for gravity in ((0.0, 0.0, 0.0), (0.0, -4.0, 0.0)):
        true_rig = replace(ruler, links=(clamped,), gravity=gravity)
        model = compile_arm(true_rig)
        q = model.equilibrium([0.2]).q + np.array([0.0, 0.02, 0.0])
        log = moved(true_rig, q, 0.0 * q, [GAUGE], np.arange(0.0, 2.0, 0.005))
        arm = replace(load_arm(PRESET), gravity=gravity)
        log = replace(log, encoder=log.encoder[:, :0])
        how = {"held": {0: 0.2}, "start": "measured", "shooting": shooting}
        fits.append(fit(arm, log, [GAUGE], **how).values)  # type: ignore[arg-type]
    assert_allclose(fits[1], fits[0], rtol=1e-5)
    assert_allclose(fits[1], truth(), rtol=2e-3)


def test_a_log_from_rest_keeps_its_fit() -> None:
    """Values from before the start was fitted, with start "rest"; within their intervals else."""
    units = {"time": "ms", "command": "mN m", "encoder": "deg", "gauge": "microstrain"}
    columns = Columns(
        time="t", command=("torque",), encoder=("angle",), gauge=("strain",), units=units
    )
    log = read_log(RESULTS / "measured_data.csv", columns)
    before = fit(PRESET, log, [GAUGE], start="rest")
    assert_allclose(before.values, [1.199298634203758, 2.225832743297812], rtol=1e-5)
    widths = np.ptp(before.intervals, axis=1)
    assert_allclose(widths, [0.0032697256593, 0.1198222785079], rtol=1e-3)
    now = fit(PRESET, log, [GAUGE])
    assert np.all((before.intervals[:, 0] < now.values) & (now.values < before.intervals[:, 1]))
    assert np.all(np.ptp(now.intervals, axis=1) >= widths)  # honest: the start is not known
    assert np.all(np.ptp(now.intervals, axis=1) < 1.1 * widths)
    assert_allclose(list(now.start.values()), 0.0, atol=0.02)  # of motions of a radian, in rad/s


def test_the_start_is_a_sum_of_the_locked_modes_that_samples_can_show() -> None:
    model = compile_arm("two-link")
    q = bent(model, [0.0, 0.8], 0.0)
    shapes, rates = locked_modes(model, q, np.eye(model.n)[list(model.arm.joint_index)])
    assert_allclose(rates, model.frequencies(q), rtol=1e-6)
    assert np.abs(shapes[:, list(model.arm.joint_index)]).max() < 1e-6
    for period, count in ((0.01, 3), (1.0 / 2.5 / 2.0, 2)):  # the third mode has 2.7 Hz
        t = period * np.arange(100.0)
        gauge = np.sin(t)[:, None]
        motion = LoggedMotion("two-link", log_of(t, gauge), [Gauge(link=0, x=0.0)], NARROW,
                              held={0: None, 1: 0.8})  # fmt: skip
        assert sum(name.startswith("mode") for name in motion.unknowns.names) == 2 * count


def test_an_encoder_reads_the_root_of_a_link_that_turns_there() -> None:
    """Pinned-free modes turn the rotor by their slope at the root."""
    arm = load_arm("sapienza-forearm")
    t = 0.01 * np.arange(20.0)
    log = log_of(t, np.zeros((20, 0)), np.sin(t)[:, None] * np.ones(arm.n_joint))
    motion = LoggedMotion(arm, log, [], NARROW)
    k = next(k for k, link in enumerate(arm.links) if link.modes)
    link, index = arm.links[k], arm.joint_index[k]
    slopes = [float(shape(mode, link.beam).slope(0.0)) for mode in link.modes]
    assert_allclose(motion.rows[k, index : index + 1 + len(slopes)], [1.0, *slopes])


def with_modes(count: int) -> Arm:
    arm = load_arm(PRESET)
    modes = tuple(replace(arm.links[0].modes[0], index=k + 1) for k in range(count))
    return replace(arm, links=(replace(arm.links[0], modes=modes),))


def sideways() -> Arm:
    """The ruler bends across the plane of its motion only."""
    arm = load_arm(PRESET)
    mode = Mode(kind="clamped-free", index=1, direction="z")
    return replace(arm, links=(replace(arm.links[0], EIy=0.1, modes=(mode,)),))


def noise(columns: int) -> Array:
    return np.random.default_rng(0).standard_normal((200, columns))


def first(log: Log, *, encoder: int = 200, gauge: int = 200) -> Log:
    """The log with the first readings of its signals alone."""
    at, none = np.arange(log.time.size)[:, None], np.nan
    return replace(log, encoder=np.where(at < encoder, log.encoder, none),
                   gauge=np.where(at < gauge, log.gauge, none))  # fmt: skip


T = 0.01 * np.arange(200.0)
NOTHING = log_of(T, 1e-5 * noise(1))
CLAMPED = replace(decay(0), encoder=1e-3 * noise(1))
STILL = replace(decay(0), encoder=np.full((200, 1), 0.3))
PUSHED = replace(log_of(T, 1e-5 * noise(1), 1e-3 * noise(1)), command=np.full((200, 1), 1e-9))
STIFFNESS = {"stiffness": (0.5, 2.0)}
MASS = {"stiffness": (0.5, 2.0), "damping": (0.0, 5.0), "payload_mass": (0.0, 0.1)}
SHORT = log_of(0.1 * T[:10], 1e-5 * noise(1)[:10])
MOVING = first(replace(decay(0), encoder=np.sin(T)[:, None]), encoder=100)


@pytest.mark.parametrize(
    ("log", "arm", "how", "sentence"),
    [
        (decay(0), PRESET, {"start": "rest"}, "the torque is zero throughout, and the arm starts"),
        (decay(0), PRESET, {"start": "resting"}, "start must be one of"),
        (NOTHING, PRESET, {}, "Nothing moves in this log: the torque is zero"),
        (CLAMPED, PRESET, {"held": {}}, "resembles gauge 1; .*hold joints that were clamped"),
        (STILL, PRESET, {"held": {}}, "encoder 1 never changes, it reads 0.3 .*hold its joint"),
        (decay(0), PRESET, {"held": {}}, "needs 1 encoders, got 0; .*hold the joints"),
        (PUSHED, PRESET, {"held": {}}, "The torque moves these signals less than their noise"),
        (decay(0), PRESET, {"bounds": {"stiffness": (3.0, 5.0)}}, "No motion .* widen the bounds"),
        (decay(0), PRESET, {"bounds": {"friction": (0.0, 5.0)}}, "all joints are held"),
        (decay(0), PRESET, {"bounds": {"coulomb_1": (0.0, 1.0)}}, "coulomb_1 .*joint 1 is held"),
        (decay(0), PRESET, {"bounds": {"torque_1": (0.5, 2.0)}}, "torque_1 .*joint 1 is held"),
        (decay(0), PRESET, {"held": {1: None}}, "held joint .*must be between 0 and 0, got 1"),
        (decay(0), PRESET, {"held": {0: float("nan")}}, "angle of a held joint"),
        (decay(0), PRESET, {"gauges": []}, "got 1 columns and 0 places"),
        (decay(0), sideways(), {}, "gauge 1 reads bending along y, which link 1 lacks"),
        (log_of(T, noise(0)), PRESET, {"gauges": []}, "needs a gauge, or an encoder"),
        (decay(0), PRESET, {"gauges": [Gauge(link=0, x=0.02, distance=1e-6)]}, "1 up; .*spikes"),
        (decay(0), with_modes(1), {"bounds": MASS}, "do not tell .* apart"),
        (MOVING.since(1.0), PRESET, {"held": {}}, "encoder 1 holds 0 readings, and a fit needs 10"),
        (first(decay(0), gauge=9), PRESET, {}, "gauge 1 holds 9 readings, and a fit needs 10"),
        (first(decay(0), gauge=12), PRESET, {"bounds": {"delay_gauge_1": (0.0, 0.1)}},
         r"gauge 1 holds 2 readings after the first 0\.1 s, in which it may be late, and a fit"),
        (first(CLAMPED, encoder=0), PRESET, {}, "encoder of a held joint holds no readings; give"),
        (SHORT, with_modes(4), {}, "10 samples of 1 signals are too few"),
    ],
)  # fmt: skip
def test_a_fit_that_cannot_be_says_why(
    log: Log, arm: str | Arm, how: dict[str, object], sentence: str
) -> None:
    given: dict[str, object] = {"gauges": [GAUGE], "bounds": NARROW, "held": HELD} | how
    with pytest.raises(ValueError, match=sentence):
        fit(arm, log, **given)  # type: ignore[arg-type]


def test_an_encoder_that_no_bending_reaches_cannot_tell_a_stiffness() -> None:
    log, sentence = clean_log(rig()), "stiffness has no effect on these signals: they do not read"
    with pytest.raises(ValueError, match=sentence):
        fit(sideways(), replace(log, gauge=log.gauge[:, :0]), bounds=STIFFNESS, held={})


def test_a_gauge_on_the_neutral_axis_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Gauge\.distance must not be 0"):
        Gauge(link=0, x=0.02, distance=0.0)
