"""The methods keep their order, their stability and their word about divergence."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Arm, Diverged, Joint, Link, Mode, Stepper, simulate
from dynamics.integrators import INTEGRATORS
from tests.dynamics.random_arms import Array, compiled

METHODS = sorted(INTEGRATORS)
START = np.array([0.4, 0.01, 0.0, -0.7, 0.005, 0.0])  # [rad, m] of TWO_LINK
TORQUE = np.array([0.3, -0.1])  # [N m]


def planar(n_link: int, count: int = 2, **changes: object) -> Arm:
    """Light flexible links with undamped bending in a plane."""
    modes = tuple(Mode(kind="clamped-free", index=k, direction="y") for k in range(1, count + 1))
    joint = Joint(rotor_inertia=0.05)
    values = {"length": 0.5, "rho_A": 0.4, "EIz": 2.0, "tip_mass": 0.2, "modes": modes}
    link = Link(**{**values, "joint": joint, **changes})
    return Arm(links=(link,) * n_link, gravity=(0.0, -9.81, 0.0), name="planar")


TWO_LINK = planar(2)
DAMPED = planar(2, damping_beta=2e-3, joint=Joint(rotor_inertia=0.05, viscous=0.3))
FASTEST = float(compiled(TWO_LINK).frequencies(joints="free").max())  # [rad/s]


def final(arm: Arm, integrator: str, torque: object, end: float, **options: float) -> Array:
    """State at the end of a motion from START."""
    motion = simulate(
        compiled(arm), START, np.zeros(6), torque, [0.0, end], integrator=integrator, **options
    )
    return np.concatenate([motion.q[-1], motion.v[-1]])


def orders(errors: list[float]) -> Array:
    """Observed orders between halvings of the step."""
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


def halvings(arm: Arm, integrator: str, torque: object, end: float, coarse: float) -> list[float]:
    """Error at the end for steps coarse, coarse/2, coarse/4, against DOP853."""
    exact = final(arm, "dop853", torque, end, rtol=1e-12)
    return [
        float(np.abs(final(arm, integrator, torque, end, dt=coarse / 2**k) - exact).max())
        for k in range(3)
    ]


@pytest.mark.parametrize("arm", [TWO_LINK, DAMPED], ids=["undamped", "damped"])
@pytest.mark.parametrize("integrator", METHODS)
def test_error_falls_at_the_order_of_the_method(integrator: str, arm: Arm) -> None:
    """Also where stiffness and damping of modes and joints are taken implicitly."""
    errors = halvings(arm, integrator, TORQUE, end=0.1, coarse=0.1 / FASTEST)

    assert_allclose(orders(errors), INTEGRATORS[integrator].order, atol=0.15)


class Jump:
    """A torque that reverses at `time`, off every grid of equal steps."""

    time = 0.1 * np.sqrt(0.4)  # [s]

    def __init__(self, told: bool) -> None:
        if told:
            self.breakpoints = [self.time]

    def __call__(self, t: float) -> Array:
        return TORQUE if t < self.time else -TORQUE


@pytest.mark.parametrize("integrator", METHODS)
def test_a_jump_in_torque_keeps_the_order_if_announced(integrator: str) -> None:
    """Steps end at breakpoints; without them one step averages across the jump."""
    coarse = 0.1 / FASTEST
    exact = final(TWO_LINK, "dop853", Jump(told=True), 0.1, rtol=1e-12)

    def error(told: bool, dt: float) -> float:
        return float(np.abs(final(TWO_LINK, integrator, Jump(told), 0.1, dt=dt) - exact).max())

    errors = [error(True, coarse / 2**k) for k in range(3)]

    assert_allclose(orders(errors), INTEGRATORS[integrator].order, atol=0.3)
    if INTEGRATORS[integrator].order > 2:
        assert error(False, coarse / 4) > 100.0 * errors[-1]


def swell(t: float) -> Array:
    """A torque that varies smoothly."""
    return TORQUE * (1.0 + 20.0 * t)


@pytest.mark.parametrize("integrator", METHODS)
def test_a_smooth_torque_is_held_at_its_value_in_mid_step(integrator: str) -> None:
    """So a fixed-step method stays of order 2 in it."""
    errors = halvings(TWO_LINK, integrator, swell, end=0.1, coarse=0.05 / FASTEST)

    assert_allclose(orders(errors), 2.0, atol=0.15)


def test_the_reference_method_steps_onto_breakpoints() -> None:
    """Two motions, before and after the jump, make one."""
    first = simulate(compiled(TWO_LINK), START, np.zeros(6), TORQUE, [0.0, Jump.time])
    second = simulate(compiled(TWO_LINK), first.q[-1], first.v[-1], -TORQUE, [Jump.time, 0.1])

    whole = final(TWO_LINK, "auto", Jump(told=True), 0.1)

    assert_allclose(whole, [*second.q[-1], *second.v[-1]], rtol=0.0, atol=1e-9)


def drift(integrator: str, dt: float) -> float:
    """Largest change of energy in an undamped swing [J]."""
    model = compiled(TWO_LINK)
    motion = simulate(
        model, START, np.zeros(6), None, np.linspace(0.0, 0.5, 11), integrator=integrator, dt=dt
    )
    total = [sum(model.energy(q, v)) for q, v in zip(motion.q, motion.v, strict=True)]
    return float(np.abs(np.array(total) - total[0]).max())


@pytest.mark.parametrize("integrator", METHODS)
def test_energy_drift_of_a_swing_falls_at_the_order_of_the_method(integrator: str) -> None:
    drifts = [drift(integrator, 0.2 / FASTEST / 2**k) for k in range(3)]

    assert np.all(orders(drifts) > INTEGRATORS[integrator].order - 0.3)


STIFF = planar(1, 1, EIz=2e6)
STIFFEST = float(compiled(STIFF).frequencies(joints="free").max())  # [rad/s]


def shaken(integrator: str, step: float, substeps: int) -> Stepper:
    """A stiff undamped arm, bent and let go; `step` is omega dt."""
    stepper = Stepper(
        compiled(STIFF), 1, dt=step / STIFFEST, substeps=substeps, integrator=integrator
    )
    stepper.q[0] = [0.3, 1e-6]
    stepper.advance()
    return stepper


def test_midpoint_is_stable_far_beyond_the_limit_where_rk4_diverges() -> None:
    """omega dt = 20 on an undamped mode, 4000 steps."""
    midpoint, rk4 = shaken("midpoint", 20.0, 4000), shaken("rk4", 20.0, 4000)

    assert rk4.status[0] > 1
    assert midpoint.status[0] == 0
    assert abs(midpoint.q[0, 1]) < 1e-4  # [m] 100 times where it started


@pytest.mark.parametrize("decays", [8.0, 50.0])
def test_midpoint_is_stable_under_damping_that_rk4_cannot_follow(decays: float) -> None:
    """A mode that decays by e^-8 and more in a step: the arm calms down, under rk4 it diverges."""
    joint = Joint(rotor_inertia=0.05, viscous=20.0)
    model = compiled(planar(1, 1, damping_beta=1.0, joint=joint))
    decay = float(model.frequencies(joints="free")[0] ** 2)  # [1/s] omega^2 beta
    stepper = {
        name: Stepper(model, 1, dt=decays / decay, substeps=2000, integrator=name)
        for name in METHODS
    }
    for each in stepper.values():
        each.q[0], each.v[0] = [0.0, 0.01], [1.0, 0.5]
        each.advance()

    assert stepper["rk4"].status[0] > 0
    assert stepper["midpoint"].status[0] == 0
    assert np.all(np.abs(stepper["midpoint"].v) < 0.1)


@pytest.mark.parametrize(("share", "stable"), [(0.98, True), (1.02, False)])
def test_rk4_is_stable_up_to_its_stated_limit(share: float, stable: bool) -> None:
    stepper = shaken("rk4", share * INTEGRATORS["rk4"].limit, 20_000)

    assert (abs(stepper.q[0, 1]) < 1e-5) == stable  # [m] 10 times where it started


def test_a_step_beyond_the_stability_limit_is_refused_with_the_limit() -> None:
    limit = INTEGRATORS["rk4"].limit / STIFFEST

    with pytest.raises(ValueError, match=f"at most {limit:.3g} s.*rk4.*got") as caught:
        simulate(compiled(STIFF), [0, 0], [0, 0], None, [0, 1], integrator="rk4", dt=2 * limit)
    assert str(caught.value).count("\n") == 0

    simulate(compiled(STIFF), [0, 0], [0, 0], None, [0, 1e-3], integrator="midpoint", dt=2 * limit)


def explosion(t: float) -> Array:
    return np.array([0.0, 0.0 if t < 0.02 else 1e200])


@pytest.mark.parametrize("integrator", [*METHODS, "dop853"])
@pytest.mark.parametrize("torque", [explosion, [1e200, 0.0]], ids=["late", "at once"])
def test_divergence_is_reported_with_time_and_remedy(
    integrator: str, torque: Callable[[float], Array] | list[float]
) -> None:
    rest, times = np.zeros(6), [0.0, 0.05]

    with pytest.raises(Diverged, match=r"diverged at t = .* s; take a smaller dt") as caught:
        simulate(compiled(TWO_LINK), rest, rest, torque, times, integrator=integrator)

    time = float(str(caught.value).split("t = ")[1].split(" s")[0])
    start = 0.02 if callable(torque) else 0.0
    assert start <= time <= start + 0.01
