"""The truth of the peers' scenes: exact beams against other discretisations and energy."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg

from benchmarks.output import REFERENCE
from benchmarks.peers.beam import Beam, beam, equations, tips
from benchmarks.peers.models import Shapes, compiled, our_run
from benchmarks.peers.scenes import SCENES, SWUNG
from benchmarks.peers.truth import motion
from dynamics import Arm, load_arm
from dynamics.accuracy.scene import JointMotion
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from dynamics.types import Array
from flexarm_env.certify.certificate import Certifier
from flexarm_env.certify.episodes import Trace
from flexarm_env.registration import SCENES as ENVIRONMENTS
from tests.dynamics.beam_elements import beam_frequencies

ONE_LINK = ENVIRONMENTS["OneLink"]  # preset, control step [s], control steps
KINDS = ("white", "held", "bang-bang", "sines")  # of episodes that start at rest


def apart(a: Array, b: Array, scene: str) -> float:
    """Largest distance of two tips over the reach [-]."""
    return float(np.linalg.norm(a - b, axis=1).max()) / SCENES[scene].arm.reach


def test_frequencies_of_the_straight_beam_are_those_of_finite_elements() -> None:
    arm = SCENES["S1"].arm
    link = arm.links[0]
    b = beam(arm, 10)
    rest = np.zeros(len(b.stiffness))
    M, _ = equations(rest, rest, 0.0, b)
    found = np.sqrt(np.abs(scipy.linalg.eigh(b.stiffness, M, eigvals_only=True)[1:5]))
    expected = beam_frequencies(
        link.length, link.rho_A, link.EIz or 0.0, hinged=True,
        hub=link.joint.rotor_inertia, tip_mass=link.tip_mass,
    )  # fmt: skip
    np.testing.assert_allclose(found, expected[:4], rtol=1e-5)


def energy(q: Array, v: Array, b: Beam, arm: Arm) -> float:
    """Kinetic, elastic and gravitational energy [J], heights by a quadrature of its own."""
    M, _ = equations(q, v, 0.0, b)
    weight, y, count = 0.0, 0.0, b.angles.shape[1]
    x, weights = np.polynomial.legendre.leggauss(60)
    for link, part in zip(arm.links, np.split(q, len(arm.links)), strict=True):
        rise = np.eye(count)
        rise[0, 1:] = -((-1.0) ** np.arange(1, count))
        for s, w in zip(x, weights, strict=True):
            inner = 0.5 * (s + 1.0) * (x + 1.0) - 1.0  # from the root to s
            theta = np.polynomial.legendre.legval(inner, rise @ part[:count])
            e = np.polynomial.legendre.legval(inner, part[count:])
            height = y + 0.25 * link.length * (s + 1.0) * weights @ ((1.0 + e) * np.sin(theta))
            weight += 0.5 * link.length * w * link.rho_A * 9.81 * height
        theta = np.polynomial.legendre.legval(x, rise @ part[:count])
        e = np.polynomial.legendre.legval(x, part[count:])
        y += 0.5 * link.length * float(weights @ ((1.0 + e) * np.sin(theta)))
    return float(0.5 * v @ M @ v + 0.5 * q @ b.stiffness @ q + weight)


def test_power_of_all_forces_is_the_change_of_energy() -> None:
    """Two soft, stretching links in a random state, bent by some tenths of a radian: dE/dt = 0."""
    soft = replace(SWUNG, links=tuple(replace(k, EIz=20.0) for k in SWUNG.links))
    b = beam(soft, 4, 3, axial=2e3)
    rng = np.random.default_rng(0)
    q, v = rng.standard_normal((2, len(b.stiffness))) * [[0.1], [1.0]]
    a = np.linalg.solve(*equations(q, v, 0.0, b))

    def power(h: float) -> float:
        later, before = (energy(q + s * v + 0.5 * s * s * a, v + s * a, b, soft) for s in (h, -h))
        return (later - before) / (2.0 * h)

    assert abs(4.0 * power(5e-6) - power(1e-5)) / 3.0 < 1e-6 * abs(v @ b.stiffness @ q)


@pytest.mark.parametrize(("name", "accuracy"), [("S1", 7e-6), ("S3", 1e-5), ("korayem", 1e-6)])
def test_older_truths_confirm_the_exact_beams(name: str, accuracy: float) -> None:
    """Two nonlinear beams of others and hinges extrapolated, within the accuracy stated of each."""
    path = REFERENCE / f"{name}_nonlinear_beam.csv"
    older = np.loadtxt(path, delimiter=",", comments=("#", "t"))[:, 1:3]
    assert apart(SCENES[name].truth[:, 1:], older, name) < accuracy


def test_the_error_falls_by_a_fixed_factor_per_degree_to_the_stored_truth() -> None:
    """A factor of five at least: degrees 5, 7 and 9 of the angle on S1."""
    scene = SCENES["S1"]
    errors = [apart(motion(scene, n, 0)[:, 1:], scene.truth[:, 1:], "S1") for n in (5, 7, 9)]
    assert errors[0] > 5.0 * errors[1] > 25.0 * errors[2]


def test_half_the_step_moves_a_truth_by_less_than_its_accuracy() -> None:
    scene = SCENES["S1"]
    b, load = beam(scene.arm, 9), scene.motion
    coarse, fine = (tips(b, load, scene.interval, careful) for careful in (1.5, 0.75))
    assert apart(coarse[:, 1:], fine[:, 1:], "S1") < scene.finest


def error(name: str, shapes: Shapes, method: str, rate: int) -> float:
    """Of one of our runs [-]."""
    scene, steps = SCENES[name], Fraction(rate)
    return scene.error(our_run(scene, compiled(shapes.arm(scene)), method, steps, True)[0], steps)


@pytest.mark.parametrize(
    ("name", "shapes", "method", "rate"),
    [
        ("S1", Shapes(("poly",), (3,), True, 8), "exponential-4", 48),
        ("S3", Shapes(("poly",), (2,), True, 12, axial=1), "midpoint", 32),
        ("korayem", Shapes(("poly", "poly"), (3, 3), True, 8), "midpoint", 384),
    ],
)
def test_segments_and_the_exact_beam_agree_to_1e_6(
    name: str, shapes: Shapes, method: str, rate: int
) -> None:
    """Cut links of assumed modes share nothing with the truth but the scene."""
    assert error(name, shapes, method, rate) < 1e-6


def test_the_error_without_axial_modes_is_the_stretch_by_the_spin() -> None:
    """rho_A w^2 L^2 / 3 EA of the reach; with them, the error falls with the third power of h."""
    link, w = SCENES["S3"].arm.links[0], 6.0
    missing = link.rho_A * (w * link.length) ** 2 / (3.0 * SCENES["S3"].axial)
    stiff = error("S3", Shapes(("poly",), (2,), True, 8), "midpoint", 32)
    four, eight = (
        error("S3", Shapes(("poly",), (2,), True, k, axial=1), "midpoint", 32) for k in (4, 8)
    )
    assert stiff == pytest.approx(missing, rel=0.05)
    assert np.log2(four / eight) > 2.5


@pytest.mark.slow
def test_the_reference_of_certificates_follows_the_exact_beam_in_whole_episodes() -> None:
    """One link without damping, at full torque, and the default's error from either."""
    name, dt, steps = ONE_LINK
    arm = load_arm(name)
    arm = replace(arm, links=(replace(arm.links[0], damping_ratio=0.0),))
    certifier = Certifier(arm, {"control_dt": dt}, steps, kinds=KINDS, count=1)
    core, episodes = certifier.default(), certifier.episodes
    own, reference = certifier.trace(core.integrator, core.substeps), certifier.reference
    exact, times = beam(arm, 7), tuple((dt * np.arange(steps)).tolist())
    for row, kind in enumerate(episodes.kinds):
        torques = episodes.actions[:, row, 0].astype(np.float32) * core.torque_limit[0]
        signal = PiecewiseConstant(times=times, values=tuple(torques.tolist()))
        load = JointMotion(
            joint_angles=tuple(episodes.q[row, :1].tolist()),
            joint_rates=(0.0,),
            t_end=dt * steps,
            torque=Torque(signals=(signal,)),
        )
        truth, valid = tips(exact, load, dt)[1:, 1:], reference.valid[:, row]

        def error(trace: Trace, other: Array, row: int = row, valid: Array = valid) -> float:
            gaps = np.linalg.norm(trace.tips[:, row, :2] - other, axis=1)
            return float(gaps[valid].max()) / arm.reach

        assert error(reference, truth) < 5e-4, kind
        assert error(own, truth) == pytest.approx(error(own, reference.tips[:, row, :2]), rel=0.15)
