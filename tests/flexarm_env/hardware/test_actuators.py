"""Actuators: their own laws, arms behind them, refusals, and the page."""

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import gymnasium as gym
import numpy as np
import pytest
from scipy import signal
from scipy.linalg import expm

import flexarm_env  # noqa: F401  (registers the ids)
from dynamics import Arm, Joint, Link, Mode, load_arm
from dynamics.model import Model
from flexarm_env.compiled.actuation import Actuation
from flexarm_env.hardware.actuators import ACTUATORS, PRESETS, load_actuators, mounted
from flexarm_env.task.scales import scales
from tests.paths import ROOT

ENV = "FlexArm/OneLink-Reach-v0"
INERTIA = 0.05  # [kg m^2]
RIGID = Arm(links=(Link(length=1.0, rho_A=3.0 * INERTIA),), name="rod")
SERVO: dict[str, Any] = {
    "type": "dc-motor", "resistance": 2.6, "torque_constant": 7.67e-3, "back_emf": 8e-3,
    "gear": 70.0, "efficiency": 0.6, "voltage_limit": 10.0,
}  # fmt: skip
PISTON: dict[str, Any] = {
    "type": "hydraulic", "natural_frequency": 60.0, "damping": 0.7, "velocity_gain": 0.02,
    "voltage_limit": 10.0, "stiffness": 1000.0, "lever_arm": 0.1,
}  # fmt: skip
STALL = 0.6 * 70.0 * 7.67e-3 * 10.0 / 2.6  # [N m]
NO_LOAD = 10.0 / (8e-3 * 70.0)  # [rad/s]
DT = 0.02  # [s] control step


def rod(actuator: Any, **keywords: Any) -> Any:
    """One rigid rod on a joint without friction, at rest at angle zero."""
    env = gym.make(ENV, arm=RIGID, actuator=actuator, max_episode_steps=1000, **keywords)
    env.reset(seed=0, options={"state": {"q": [0.0], "v": [0.0]}, "target": [0.5]})
    return env


def follow(env: Any, actions: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, rate and torque after each action."""
    rows = []
    for action in actions:
        info = env.step(np.array([action], np.float32))[-1]
        (q,), (v,) = env.unwrapped.joint_state()
        rows.append((q, v, info["torque"][0]))
    q, v, torque = np.array(rows).T
    return q, v, torque


def linear_motion(A: np.ndarray, B: np.ndarray, u: float, steps: int) -> np.ndarray:
    """(steps, n) x' = A x + B u from zero, at the ends of control steps."""
    n = len(B)
    flow = np.zeros((n + 1, n + 1))
    flow[:n, :n], flow[:n, n] = A, B * u
    return np.array([expm(flow * DT * (k + 1))[:n, n] for k in range(steps)])


# ---- each actuator's own law ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "printed", "hertz", "ratio"),
    [
        ("ralf-1", ([5.217e3], [1.0, 3.836e2, 7.509e4, 0.0]), 43.61, 0.700),  # (7.1a)
        ("ralf-2", ([3.374e3], [1.0, 4.838e2, 9.869e4, 0.0]), 50.00, 0.770),  # (7.1b)
    ],
)
def test_pistons_follow_the_printed_transfer_functions(
    name: str, printed: Any, hertz: float, ratio: float
) -> None:
    """Poles, and the step response of the compiled recursion's matrices against SciPy's."""
    actuator: Any = PRESETS[name]
    law = actuator.law(1.0)
    poles = np.linalg.eigvals(np.array(law.A))
    oscillating = poles[np.abs(poles) > 1.0]
    assert np.abs(oscillating) / (2.0 * math.pi) == pytest.approx(hertz, abs=0.005)
    assert -oscillating.real / np.abs(oscillating) == pytest.approx(ratio, abs=5e-4)

    times = 1e-3 * np.arange(200)
    _, expected = signal.step(signal.TransferFunction(*printed), T=times)  # [in] for 1 V
    values = Actuation((actuator,), RIGID, (1.0,)).constants(1e-3)
    step, by_action = values[:9].reshape(3, 3), values[9:12]
    x, positions = np.zeros(3), []
    for _ in times:
        positions.append(x[0] * actuator.lever_arm / 0.0254)  # [in]
        x = step @ x + by_action / actuator.voltage_limit
    np.testing.assert_allclose(positions, expected, rtol=2e-3, atol=1e-9)  # gains: three digits


def test_current_rises_with_the_electrical_time_constant() -> None:
    """A locked joint: i = V / R (1 - exp(-R t / L))."""
    motor = load_actuators({**SERVO, "inductance": 0.026}, 1)  # 10 ms
    values = Actuation(motor, RIGID, (1.0,)).constants(1e-3)
    decay, rise = values[0], values[1]
    current, expected = 0.0, 10.0 / 2.6 * (1.0 - np.exp(-1e-3 * np.arange(1, 51) / 0.01))
    for i in expected:
        current = decay * current + rise
        assert current == pytest.approx(i, rel=1e-12)


@pytest.mark.parametrize("name", ["slim", "two-link"])
def test_rates_of_actuators_are_those_of_roots_against_their_hubs(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the encoders read them, from all coordinates; a torque for each joint."""
    kept: dict[str, Any] = {}
    monkeypatch.setattr(
        "flexarm_env.compiled.actuation.traced", lambda name, f, *_: kept.setdefault(name, f)
    )
    arm = load_arm(name)
    actuation = Actuation(load_actuators(PISTON, arm.n_joint), arm, (1.0,) * arm.n_joint)
    slots = dict.fromkeys(("ACTION", "ACTUATOR", "Q", "V", "RATE_BEFORE", "TAU"), 0)
    actuation.functions(slots, 0)
    v = np.random.default_rng(0).uniform(-1.0, 1.0, arm.n)
    rates = kept["mark"](0.0, 0.0, 0.0, v, 0.0, 0.0).full().ravel()
    np.testing.assert_allclose(rates, Model(arm).encoders @ v, rtol=1e-12)
    assert kept["drive"].numel_out() == arm.n_joint
    assert kept["follow"].numel_out() == 3 * arm.n_joint


# ---- an arm behind it ----------------------------------------------------------------------------


@pytest.mark.compiles
def test_motor_reaches_stall_torque_at_rest_and_no_load_speed_in_the_end() -> None:
    """J w' = T_stall (u - w / w_0): an exponential, exact to the integrator's order."""
    env = rod(SERVO, substeps=8)
    assert env.unwrapped.torque_limit == pytest.approx([STALL], rel=1e-12)
    constant = INERTIA * NO_LOAD / STALL  # [s]
    times = DT * np.arange(1, 201)
    q, v, torque = follow(env, [1.0] * 200)
    rise = 1.0 - np.exp(-times / constant)
    np.testing.assert_allclose(v, NO_LOAD * rise, rtol=1e-8)
    np.testing.assert_allclose(q, NO_LOAD * (times - constant * rise), rtol=1e-8)
    np.testing.assert_allclose(torque, STALL * np.exp(-times / constant), rtol=1e-7, atol=1e-9)
    assert v[-1] == pytest.approx(NO_LOAD, rel=0.05)
    _, info = env.reset(options={"state": {"q": [0.0], "v": [NO_LOAD]}, "target": [0.5]})
    assert info["torque"] == pytest.approx([-STALL], rel=1e-12)  # braked by its own voltage
    _, _, _, _, info = env.step(np.array([0.5], np.float32))
    assert info["command"] == pytest.approx([5.0])  # V


def test_torque_limit_of_a_motor_is_obeyed() -> None:
    """The torque is constant until the motor gives less than the limit."""
    limit = 0.25 * STALL
    env = rod({**SERVO, "torque_limit": limit}, substeps=8)
    assert env.unwrapped.torque_limit == pytest.approx([limit])
    _, v, torque = follow(env, [1.0] * 200)
    free = v < 0.74 * NO_LOAD
    assert 10 < free.sum() < 190
    times = DT * np.arange(1, 201)
    np.testing.assert_allclose(v[free], limit / INERTIA * times[free], rtol=1e-10)
    np.testing.assert_allclose(torque, np.minimum(limit, STALL * (1.0 - v / NO_LOAD)), rtol=1e-10)


def errors_by_substep(actuator: Any, expected: np.ndarray, steps: int) -> np.ndarray:
    """Largest error of the angle for 8, 16 and 32 substeps; one compiled module."""
    found = (follow(rod(actuator, substeps=count), [0.5] * steps)[0] for count in (8, 16, 32))
    return np.array([np.abs(q - expected).max() for q in found])


def motor_with_inductance(constant: float) -> tuple[dict[str, Any], np.ndarray]:
    """A motor with this electrical time constant [s], and the rod's angle at half voltage."""
    inductance = 2.6 * constant
    A = np.array([
        [-1.0 / constant, 0.0, -8e-3 * 70.0 / inductance],
        [0.0, 0.0, 1.0],
        [0.6 * 70.0 * 7.67e-3 / INERTIA, 0.0, 0.0],
    ])  # fmt: skip
    x = linear_motion(A, np.array([10.0 / inductance, 0.0, 0.0]), 0.5, 20)
    return {**SERVO, "inductance": inductance}, x[:, 1]


def test_motor_with_inductance_and_arm_are_coupled_in_second_order() -> None:
    """Against the matrix exponential."""
    actuator, q = motor_with_inductance(0.02)
    errors = errors_by_substep(actuator, q, 20)
    assert errors[0] < 1e-3 * q[-1]
    assert (errors[:-1] > 3.0 * errors[1:]).all()


def test_an_electrical_time_constant_far_below_the_substep_is_stable() -> None:
    """The remaining error is the first rise of the current: at most a T h / 2."""
    constant, steps = 2e-5, DT / np.array([8, 16, 32])
    actuator, q = motor_with_inductance(constant)
    errors = errors_by_substep(actuator, q, 20)
    assert (errors < 1.01 * 0.5 * STALL / INERTIA * constant * steps / 2.0).all()


def test_piston_and_arm_are_coupled_in_second_order() -> None:
    """Valve, piston and rod on the oil's spring, against the matrix exponential."""
    w, spring = 60.0, 1000.0 * 0.1**2
    A = np.zeros((5, 5))
    A[0, 1] = A[1, 2] = A[3, 4] = 1.0
    A[2, 1:3] = -w * w, -2.0 * 0.7 * w
    A[4, 0], A[4, 3] = spring / INERTIA, -spring / INERTIA
    B = np.array([0.0, 0.0, w * w * 0.02 * 10.0 / 0.1, 0.0, 0.0])
    x = linear_motion(A, B, 0.5, 30)
    errors = errors_by_substep(PISTON, x[:, 3], 30)
    assert errors[0] < 1e-3 * x[-1, 3]
    assert (errors[:-1] > 3.0 * errors[1:]).all()
    env = rod(PISTON)
    _, info = env.reset(seed=1)  # somewhere else, without torque
    assert abs(env.unwrapped.joint_state()[0][0]) > 0.01
    assert info["torque"] == pytest.approx([0.0], abs=1e-12)
    assert np.abs(follow(env, [0.0] * 50)[1]).max() < 1e-12


@pytest.mark.compiles
@pytest.mark.parametrize("kind", ["pinned-free", "hierarchical"])
def test_the_spring_of_a_piston_starts_relaxed_on_a_link_that_gravity_bends(kind: str) -> None:
    """Pinned-free shapes turn the root, on which the piston acts."""
    link = Link(
        length=0.6, rho_A=0.3, EIz=8.0, tip_mass=0.2, damping_ratio=0.02,
        modes=(Mode(kind=kind, index=1, direction="y"),), joint=Joint(rotor_inertia=0.05),
    )  # fmt: skip
    env = gym.make(ENV, arm=Arm(links=(link,), gravity=(0.0, -9.81, 0.0)), actuator="ralf-1")
    _, info = env.reset(seed=1)
    assert abs(env.unwrapped.core.q[0, 1]) > 1e-3
    assert info["torque"] == pytest.approx([0.0], abs=1e-9)


@pytest.mark.compiles
def test_torque_changes_no_faster_than_its_rate_limit() -> None:
    """A torque of straight pieces; the joint's rate is its exact impulse."""
    rate, limit = 7.0, 0.5
    env = rod({"type": "limited", "torque_limit": limit, "rate_limit": rate})
    actions = [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 0.25, 0.3, 0.3, 0.0, -0.9]
    fine = DT / 20000
    now, impulse, expected = 0.0, 0.0, []
    for action in np.float32(actions).astype(float):
        for _ in range(20000):
            before, now = now, now + min(max(limit * action - now, -rate * fine), rate * fine)
            impulse += 0.5 * fine * (before + now)
        expected.append((impulse / INERTIA, now))
    _, v, torque = follow(env, actions)
    np.testing.assert_allclose(torque, [t for _, t in expected], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(v, [w for w, _ in expected], rtol=1e-7, atol=1e-9)
    assert np.abs(np.diff(torque, prepend=0.0)).max() == pytest.approx(rate * DT)


def test_a_source_without_limits_is_the_ideal_one() -> None:
    """The compiled step with an actuator gives the motion of the step without one."""
    same: Any = {"integrator": "rk4", "substeps": 3}
    actions = np.sin(np.arange(40)).tolist()
    ideal = follow(rod(None, **same), actions)
    limited = follow(rod({"type": "limited"}, **same), actions)
    for a, b in zip(ideal, limited, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


@pytest.mark.parametrize("integrator", ["rk4", "midpoint"])
def test_steps_follow_a_stiff_spring(integrator: str) -> None:
    """As many substeps as the stiffer arm needs, and the motion stays bounded."""
    stiff = {**PISTON, "stiffness": 1e6}  # 447 rad/s on the rod
    env = rod(stiff, integrator=integrator)
    assert env.unwrapped.core.substeps >= math.sqrt(1e6 * 0.01 / INERTIA) * DT / 2.83
    q, _, _ = follow(env, [0.1] * 100)
    assert q[-1] == pytest.approx(0.1 * 10.0 * 0.02 / 0.1 * 2.0, abs=0.01)  # piston: x_p / r


# ---- what it adds to the arm and the environment -------------------------------------------------


def test_a_motors_inertia_and_friction_are_added_to_the_joint() -> None:
    """Once: the rotor inertia times the gear ratio squared, the friction unchanged."""
    joint = Joint(rotor_inertia=0.01, viscous=0.1, coulomb=0.2)
    arm = replace(RIGID, links=(replace(RIGID.links[0], joint=joint),))
    own = {"rotor_inertia": 1e-6, "viscous": 0.05, "coulomb": 0.03}
    found = mounted(arm, load_actuators({**SERVO, **own}, 1)).links[0].joint
    assert found.rotor_inertia == pytest.approx(0.01 + 70.0**2 * 1e-6)
    assert (found.viscous, found.coulomb) == (pytest.approx(0.15), pytest.approx(0.23))
    rig = load_arm("quanser-rotary-flexible-link")  # holds its servo's own inertia and friction
    assert mounted(rig, load_actuators("quanser-servo", 1)) == rig
    env = rod({**SERVO, **own})
    assert env.unwrapped.arm.links[0].joint.rotor_inertia == pytest.approx(70.0**2 * 1e-6)
    assert env.unwrapped.certificate is None
    assert "errors of this arm" in env.unwrapped.uncertified


def test_torques_are_observed_in_units_of_the_limit() -> None:
    env = rod(SERVO)
    obs, *_, info = env.step(np.array([0.7], np.float32))
    place = env.unwrapped.observation_slices["joint_torque"]
    assert obs[place] == pytest.approx(info["torque"] / STALL, rel=1e-6)
    assert scales(RIGID).torque_limit[0] < STALL  # so that tasks are no harder than without motor
    ideal = gym.make(ENV, arm=RIGID).unwrapped
    assert env.unwrapped.core.rate_scale == ideal.core.rate_scale
    assert "joint_torque" not in ideal.observation_slices
    assert "command" not in ideal.reset(seed=0)[1]


@pytest.mark.parametrize("spring", [None, 100.0])
def test_the_angle_of_an_actuator_is_power_conjugate_to_its_torque(spring: float | None) -> None:
    """`slip`, against the generalised forces of unit torques."""
    modes = tuple(Mode(kind="pinned-free", index=index, direction="y") for index in (1, 2))
    joint = Joint(rotor_inertia=0.01, stiffness=spring)
    link = Link(length=1.0, rho_A=0.3, EIz=10.0, modes=modes, joint=joint)
    arm = Arm(links=(replace(link, joint=Joint(rotor_inertia=0.01)), link))
    model = Model(arm)
    q, rest = 0.02 * np.arange(model.n), np.zeros(model.n)
    idle = model.accelerations(q, rest, np.zeros(2))
    forces = [model.mass_matrix(q) @ (model.accelerations(q, rest, u) - idle) for u in np.eye(2)]
    found = Actuation(load_actuators({"type": "limited"}, 2), arm, (1.0, 1.0))
    np.testing.assert_allclose(found.slip, forces, atol=1e-10)


def test_every_joint_may_have_its_own_actuator() -> None:
    """Torques of a motor with a current and of a slewing piston, from one stack of numbers."""
    arm = Arm(links=RIGID.links * 2)
    actuators = [{**SERVO, "inductance": 0.026}, {**PISTON, "rate_limit": 5.0}]
    actuation = Actuation(load_actuators(actuators, 2), arm, (1.0, 3.0))
    assert actuation.torque_limit == pytest.approx([STALL, 3.0])
    assert actuation.states == 1 + 4
    sizes = {"action": 2, "actuator": 5, "q": 2, "v": 2, "actuators": actuation.n_constant}
    symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    torque = ca.Function("torque", list(symbols.values()), [actuation.torque(symbols)])
    current, passed = 1.5, 0.8  # [A], [N m]
    states = [current, 0.1, 0.2, 0.3, passed]
    found = torque([1.0, 1.0], states, [0.2, 0.3], [0.4, 0.5], actuation.constants(1e-3))
    assert found.full().ravel() == pytest.approx([0.6 * 70.0 * 7.67e-3 * current, passed])
    np.testing.assert_allclose(
        actuation.at_rest(np.array([[0.2, 0.3]])), [[0.0], [0.3], [0.0], [0.0], [0.0]]
    )


# ---- refusals and the page -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"actuator": "servo"}, r"Unknown actuator 'servo'. Known: \['quanser-servo', 'ralf-1'"),
        ({"actuator": {"type": "motor"}}, r'actuator\["type"\] must be one of \[\'dc-motor\''),
        ({"actuator": {"voltage_limit": 1.0}}, r'actuator\["type"\] must be one of .* got None'),
        ({"actuator": {**SERVO, "volts": 1.0}}, "Unknown key 'volts' in actuator dc-motor"),
        ({"actuator": {"type": "dc-motor"}}, r"actuator dc-motor needs \['resistance', "),
        ({"actuator": {**SERVO, "resistance": 0.0}}, "actuator dc-motor.resistance must be posit"),
        ({"actuator": {**SERVO, "viscous": -1.0}}, "actuator dc-motor.viscous must not be negat"),
        ({"actuator": {**SERVO, "efficiency": 1.5}}, "efficiency must be at most 1, got 1.5"),
        (
            {"actuator": {**PISTON, "damping": "0.7"}},
            "hydraulic.damping .* the text '0.7'",
        ),
        ({"actuator": ["quanser-servo"] * 2}, r"a list of 1 \(one per joint\)"),
        ({"actuator": 5}, r"a list of 1 \(one per joint\), got 5"),
        ({"actuator": [5]}, "An actuator must be a name or a dict, got 5"),
        ({"actuator": SERVO, "torque_limit": 1.0}, r"torque_limit \(1.0\) is for ideal torque"),
        ({"actuator": SERVO, "tolerance": 1e-3}, r"tolerance \(0.001\) is for ideal torque"),
        ({"actuator": SERVO, "integrator": "rosenbrock"}, "needs the slopes of the forces"),
    ],
)
def test_bad_actuators_get_a_sentence(keywords: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        gym.make(ENV, **keywords)


def test_the_page_has_every_actuator_and_the_numbers_of_the_presets() -> None:
    text = (ROOT / "docs/actuators.md").read_text(encoding="utf-8")
    for name, kind in ACTUATORS.items():
        assert f"`{name}`" in text
        for key in kind.__dataclass_fields__:
            assert f"`{key}`" in text, (name, key)
    servo, first, second = (PRESETS[name] for name in ("quanser-servo", "ralf-1", "ralf-2"))
    assert isinstance(servo, ACTUATORS["dc-motor"])
    law = servo.law(1.0)
    assert f"{law.stall:.2f} N m" in text
    assert f"{servo.no_load_speed:.1f} rad/s" in text
    for piston in (first, second):
        assert isinstance(piston, ACTUATORS["hydraulic"])
        assert f"{piston.natural_frequency / (2.0 * math.pi):.2f} Hz" in text
        assert f"{piston.damping:.3f}" in text
        assert f"{1e3 * piston.velocity_gain * piston.voltage_limit:.1f} mm/s" in text
        assert f"{1e-3 * piston.law(1.0).stiffness:.1f} kN m/rad" in text
