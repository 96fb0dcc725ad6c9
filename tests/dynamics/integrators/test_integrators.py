"""Order, stability limits and divergence reports of the integration methods."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Arm, Diverged, Joint, Link, Mode, Stepper, simulate
from dynamics.formulations.linearized import (
    frozen_modes,
    inertia,
    linear_arm,
    stiffness,
)
from dynamics.integrators.exponential import FrozenModes
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.simulation.step_limits import amplification, fastest, largest_step
from dynamics.types import Array
from tests.dynamics.random_arms import compiled

METHODS = sorted(INTEGRATORS)
LIMITED = sorted(name for name in METHODS if np.isfinite(INTEGRATORS[name].limit))
UNLIMITED = sorted(set(METHODS) - set(LIMITED))
FROZEN = sorted(name for name in METHODS if INTEGRATORS[name].aid == "modes")
START = np.array([0.4, 0.01, 0.0, -0.7, 0.005, 0.0])  # [rad, m] of TWO_LINK
TORQUE = np.array([0.3, -0.1])  # [N m]


def planar(n_link: int, count: int = 2, **changes: object) -> Arm:
    """Light planar flexible links without damping."""
    modes = tuple(Mode(kind="clamped-free", index=k, direction="y") for k in range(1, count + 1))
    joint = Joint(rotor_inertia=0.05)
    values = {"length": 0.5, "rho_A": 0.4, "EIz": 2.0, "tip_mass": 0.2, "modes": modes}
    link = Link(**{**values, "joint": joint, **changes})
    return Arm(links=(link,) * n_link, gravity=(0.0, -9.81, 0.0), name="planar")


TWO_LINK = planar(2)
DAMPED = planar(2, damping_beta=2e-3, joint=Joint(rotor_inertia=0.05, viscous=0.3))
FASTEST = float(compiled(TWO_LINK).frequencies(joints="free").max())  # [rad/s]
# order if every step is a new start, where it differs; of an exponential step at least
ANEW = {"numerov": 3, **dict.fromkeys(FROZEN, 1)}
COARSE = {1: 1e-3 / FASTEST, 2: 0.1 / FASTEST, 4: 0.1 / FASTEST}  # [s] small enough, by order


def final(arm: Arm, integrator: str, torque: object, end: float, **options: float) -> Array:
    """State at the end of a motion from START."""
    motion = simulate(
        compiled(arm), START, np.zeros(6), torque, [0.0, end], integrator=integrator, **options
    )
    return np.concatenate([motion.q[-1], motion.v[-1]])


def assert_order(errors: list[float], integrator: str, order: int, within: float) -> None:
    """The start of an exponential step has the lowest order of its errors, others may hide it."""
    if integrator in FROZEN:
        assert np.all(orders(errors) > order - within)
    else:
        assert_allclose(orders(errors), order, atol=within)


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
    """Also with implicit stiffness and damping of modes and joints."""
    order = INTEGRATORS[integrator].order
    errors = halvings(arm, integrator, TORQUE, end=0.1, coarse=COARSE[order])

    assert_order(errors, integrator, order, 0.3)


@pytest.mark.parametrize("integrator", METHODS)
def test_free_motion_keeps_the_order_too(integrator: str) -> None:
    order = INTEGRATORS[integrator].order
    errors = halvings(TWO_LINK, integrator, None, end=0.1, coarse=COARSE[order])

    assert_order(errors, integrator, order, 0.15)


def test_an_extrapolated_guess_leaves_linear_motion_as_it_is_and_others_closer() -> None:
    """The guess reaches forces of second order in the motion alone: those of rates and posture."""
    arm, rest = compiled(replace(DAMPED, gravity=(0.0, 0.0, 0.0))), np.zeros(6)

    def ends(size: float, dt: float) -> list[Array]:
        """Coordinates after a torque of this size: by the last accelerations, by their change."""
        names, torque = ("midpoint", "extrapolated-midpoint"), size * TORQUE
        return [
            simulate(arm, rest, rest, torque, [0.0, 0.5], integrator=name, dt=dt).q[-1]
            for name in names
        ]

    last, change = ends(1e-6, 2e-3)
    assert np.abs(change / last - 1.0).max() < 1e-11
    exact = simulate(arm, rest, rest, 30.0 * TORQUE, [0.0, 0.5], integrator="dop853", rtol=1e-11)
    errors = [np.abs(q - exact.q[-1]).max() for q in ends(30.0, 2e-3)]
    assert errors[1] < 0.1 * errors[0]


class Jump:
    """A torque that reverses at `time`, which is on no grid of equal steps."""

    time = 0.1 * np.sqrt(0.4)  # [s]

    def __init__(self, told: bool) -> None:
        if told:
            self.breakpoints = [self.time, self.time]  # as of two joints

    def __call__(self, t: float) -> Array:
        return TORQUE if t < self.time else -TORQUE


@pytest.mark.parametrize("integrator", METHODS)
def test_a_jump_in_torque_keeps_the_order_if_announced(integrator: str) -> None:
    """Steps end at breakpoints; without them one step averages across the jump.

    With a torque function every step is a new start, which costs some methods one order.
    """
    coarse = COARSE[INTEGRATORS[integrator].order]
    exact = final(TWO_LINK, "dop853", Jump(told=True), 0.1, rtol=1e-12)

    def error(told: bool, dt: float) -> float:
        return float(np.abs(final(TWO_LINK, integrator, Jump(told), 0.1, dt=dt) - exact).max())

    errors = [error(True, coarse / 2**k) for k in range(3)]

    assert_order(errors, integrator, ANEW.get(integrator, INTEGRATORS[integrator].order), 0.3)
    if INTEGRATORS[integrator].order > 2:
        assert error(False, coarse / 4) > 10.0 * errors[-1]


def swell(t: float) -> Array:
    """A torque that varies smoothly."""
    return TORQUE * (1.0 + 20.0 * t)


@pytest.mark.parametrize("integrator", METHODS)
def test_a_smooth_torque_is_held_at_its_value_in_mid_step(integrator: str) -> None:
    """A fixed-step method then has order 2 in the torque, with a small error constant."""
    order = min(2, INTEGRATORS[integrator].order)
    errors = halvings(TWO_LINK, integrator, swell, end=0.1, coarse=0.5 * COARSE[order])

    if integrator in FROZEN:
        assert np.all(orders(errors) > ANEW[integrator] - 0.3)
    elif integrator in ANEW:
        assert np.all(orders(errors) > order - 0.15)
    else:
        assert_allclose(orders(errors), order, atol=0.15)


def test_the_reference_method_steps_onto_breakpoints() -> None:
    """Equals two motions, one before and one after the jump."""
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
    coarse = 0.0125 if integrator == "extrapolated-midpoint" else 0.05  # errors cancel above it
    drifts = [drift(integrator, coarse / FASTEST / 2**k) for k in range(3)]

    assert np.all(orders(drifts) > INTEGRATORS[integrator].order - 0.3)


def test_lanes_of_a_rosenbrock_batch_do_not_mix() -> None:
    """Each environment of a batch moves as it does alone, including the LU factorisation."""
    batch = Stepper(compiled(TWO_LINK), 20, dt=1e-3, substeps=10, integrator="rosenbrock")
    alone = Stepper(compiled(TWO_LINK), 1, dt=1e-3, substeps=10, integrator="rosenbrock")
    batch.q[:] = np.linspace(-1.0, 1.0, 20)[:, None] * START
    batch.torque[:] = TORQUE
    alone.q[0], alone.torque[0] = batch.q[13], TORQUE

    batch.advance()
    alone.advance()

    assert_allclose(batch.q[13], alone.q[0], rtol=1e-11, atol=1e-13)
    assert np.abs(np.diff(batch.q, axis=0)).min() > 0.0


STIFF = planar(1, 1, EIz=2e6)
HEAVILY_DAMPED = replace(
    planar(1, 1, damping_beta=1.0, joint=Joint(rotor_inertia=0.05, viscous=20.0), EIz=50.0),
    gravity=(0.0, 0.0, 0.0),
)
STIFFEST = float(compiled(STIFF).frequencies(joints="free").max())  # [rad/s]


def shaken(integrator: str, step: float, substeps: int) -> Stepper:
    """A stiff undamped arm released from a deflection; `step` is omega dt."""
    stepper = Stepper(
        compiled(STIFF), 1, dt=step / STIFFEST, substeps=substeps, integrator=integrator
    )
    stepper.q[0] = [0.3, 1e-6]
    stepper.advance()
    return stepper


@pytest.mark.parametrize("integrator", UNLIMITED)
def test_unlimited_methods_hold_far_beyond_the_limit_where_rk4_diverges(integrator: str) -> None:
    """omega dt = 20 on an undamped mode, 4000 steps."""
    stepper = shaken(integrator, 20.0, 4000)

    assert shaken("rk4", 20.0, 4000).status[0] > 1
    assert stepper.status[0] == 0
    assert abs(stepper.q[0, 1]) < 1e-4  # [m] 100 times where it started


@pytest.mark.parametrize("share", [0.98, 1.02])
@pytest.mark.parametrize("integrator", LIMITED)
def test_methods_are_stable_up_to_their_stated_limits(integrator: str, share: float) -> None:
    """The table, the eigenvalues of a step and many steps agree on both sides of the limit."""
    step = share * INTEGRATORS[integrator].limit
    arm = linear_arm(compiled(STIFF).chain, np.zeros(2))

    stepper = shaken(integrator, step, 20_000)

    assert (amplification(arm, integrator, step / STIFFEST) < 1.0 + 1e-6) == (share < 1.0)
    held = stepper.status[0] == 0 and abs(stepper.q[0, 1]) < 1e-5  # [m] 10 times where it started
    assert held == (share < 1.0)


@pytest.mark.parametrize("decays", [0.5, 1.5, 4.0, 8.0, 50.0])
@pytest.mark.parametrize("integrator", METHODS)
def test_damping_breaks_a_method_exactly_where_its_eigenvalues_say(
    integrator: str, decays: float
) -> None:
    """A mode that decays by e^-decays in a step, and a joint with viscous friction."""
    model = compiled(HEAVILY_DAMPED)
    dt = decays / fastest(model, np.zeros(2))
    stepper = Stepper(model, 1, dt=dt, substeps=20_000, integrator=integrator)
    stepper.q[0], stepper.v[0] = [0.0, 1e-6], [1e-6, 1e-6]

    stepper.advance()

    calm = stepper.status[0] == 0 and bool(np.all(np.abs(stepper.v[0]) < 1e-5))
    radius = amplification(linear_arm(model.chain, np.zeros(2)), integrator, dt)
    assert calm == (radius < 1.0 + 1e-6)
    assert calm or integrator in [*LIMITED, *FROZEN]
    assert not (calm and integrator in LIMITED and decays > 4.0)


def test_frozen_modes_are_all_of_the_straight_arm() -> None:
    """K S = M S Omega^2 with L = S^-1; rigid motions of free joints have no frequency or decay."""
    model = compiled(planar(2, 2, damping_ratio=0.02, joint=Joint(rotor_inertia=0.05)))
    n, modes = model.n, frozen_modes(model.chain)
    squares, decays, L, S, drive = modes
    assert_allclose(drive, S.T[:, list(model.arm.joint_index)], atol=1e-14)
    K, M = stiffness(model.chain), inertia(model.chain, np.zeros(n))
    assert_allclose(L @ S, np.eye(n), atol=1e-12)
    assert_allclose(K @ S, M @ S * squares, atol=1e-9 * np.abs(K @ S).max())
    free = squares == 0.0
    assert free.sum() == 2
    assert np.all(decays[free] == 0.0)
    assert np.all(decays[~free] > 0.0)
    assert np.all(L[~free][:, list(model.arm.joint_index)] == 0.0)  # they balance free joints
    assert np.all(S[1:3, free] == 0.0)  # and free joints bend nothing


@pytest.mark.parametrize("integrator", FROZEN)
def test_an_exponential_step_of_any_length_is_exact_for_small_motions(integrator: str) -> None:
    """Damped or not; another method of order 2 fails at omega dt = 3."""
    arm = planar(1, 3, damping_ratio=0.02, joint=Joint(rotor_inertia=0.05))
    arm = replace(arm, gravity=(0.0, 0.0, 0.0))
    model = compiled(arm)
    q, v = 1e-6 * np.array([1.0, 0.3, -0.2, 0.1]), np.zeros(4)
    dt = 3.0 / float(model.frequencies(joints="free").max())
    ends = {
        name: simulate(model, q, v, [1e-6], [0.0, 20.0 * dt], integrator=name, **options).q[-1]
        for name, options in (("dop853", {"rtol": 1e-12}), (integrator, {"dt": dt}))
    }
    error = np.abs(ends[integrator] - ends["dop853"]).max()
    assert error < 1e-3 * np.abs(ends["dop853"]).max()


def test_compiled_functions_have_names_of_their_own() -> None:
    """Two processes may compile two of one name; who loads the code of both gets one of them."""
    functions = {method.prepare for method in INTEGRATORS.values()}
    assert len({(f.__module__, f.__qualname__) for f in functions}) == len(functions) > 3


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_method_evaluates_as_often_as_it_says(name: str) -> None:
    """Counted on a workspace of one coordinate with zero accelerations."""
    method, calls = INTEGRATORS[name], []
    modes = FrozenModes(np.ones(1), np.ones(1), np.eye(1), np.eye(1), np.eye(1))
    steps = np.array([np.inf])
    aids = {"none": None, "modes": modes, "explicit steps": steps, "jacobian": lambda w: None}
    aid = aids[method.aid]
    at = Slots(n=1, q=0, v=1, a=2, implicit=3, s=8, tau=6)
    w = np.zeros(64)
    w[:2] = 1.0
    method.prepare(w, 0.1, at, aid)
    method.start(w, 0.1, calls.append, at, aid)
    for _ in range(3):
        method.step(w, 0.1, calls.append, at, aid)

    assert len(calls) == method.evaluations(3)


def test_a_step_beyond_the_stability_limit_is_refused_with_the_limit() -> None:
    limit = INTEGRATORS["rk4"].limit / STIFFEST

    with pytest.raises(ValueError, match=r"at most .* s.*rk4.*got") as caught:
        simulate(compiled(STIFF), [0, 0], [0, 0], None, [0, 1], integrator="rk4", dt=2 * limit)
    assert str(caught.value).count("\n") == 0
    stated = float(str(caught.value).split()[5])  # [s] three digits
    assert stated == pytest.approx(limit, rel=5e-3)

    simulate(compiled(STIFF), [0, 0], [0, 0], None, [0, 1e-3], integrator="midpoint", dt=2 * limit)


@pytest.mark.parametrize("integrator", LIMITED)
def test_strong_damping_is_refused_like_a_high_frequency(integrator: str) -> None:
    """Frequencies alone would allow a step several times larger."""
    model = compiled(HEAVILY_DAMPED)
    omega = float(model.frequencies(joints="free").max())
    rest, allowed = np.zeros(2), INTEGRATORS[integrator].limit / omega

    with pytest.raises(ValueError, match=f"at most .* s, or {integrator} diverges"):
        simulate(model, rest, rest, None, [0, 1], integrator=integrator, dt=0.5 * allowed)
    limit = largest_step(model, rest, integrator, 0.5 * allowed)
    simulate(model, rest, rest, None, [0, 1], integrator=integrator, dt=0.99 * limit)
    assert limit < 0.2 * allowed


def test_automatic_choice_takes_the_implicit_method_where_damping_is_stiff() -> None:
    """It has the same accuracy with a fraction of DOP853's evaluations."""
    model = compiled(planar(2, EIz=2e4, damping_beta=1e-3))
    motions = {
        name: simulate(model, 0.5 * START * (1, 0, 0, 1, 0, 0), np.zeros(6), TORQUE, [0.0, 0.3],
                       integrator=name)
        for name in ("auto", "radau", "dop853")
    }  # fmt: skip

    assert np.array_equal(motions["auto"].q, motions["radau"].q)
    assert not np.array_equal(motions["auto"].q, motions["dop853"].q)
    assert_allclose(motions["auto"].q, motions["dop853"].q, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("name", ["radau", "bdf"])
def test_methods_with_error_control_agree(name: str) -> None:
    """Within the tolerance of BDF accumulated over ten thousand steps."""
    exact = final(DAMPED, "dop853", Jump(told=True), 0.2, rtol=1e-12)

    error = np.abs(final(DAMPED, name, Jump(told=True), 0.2) - exact).max()

    assert error < 1e-8
    assert not np.array_equal(final(DAMPED, "auto", TORQUE, 0.1), final(DAMPED, name, TORQUE, 0.1))


def explosion(t: float) -> Array:
    return np.array([0.0, 0.0 if t < 0.02 else 1e200])


@pytest.mark.parametrize("integrator", [*METHODS, "dop853", "radau", "bdf"])
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
