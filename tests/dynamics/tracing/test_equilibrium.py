"""Arms at rest under gravity: linear sag, the elastica, and torques that hold."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from dynamics import (
    ARMS,
    Arm,
    Base,
    Joint,
    Link,
    Mode,
    Model,
    Payload,
    Stepper,
    ValidityWarning,
    simulate,
)
from dynamics.tracing.equilibrium import settled
from dynamics.types import Array
from tests.dynamics.agreement import accelerations
from tests.dynamics.random_arms import random_arm, random_state

G = 9.81
SHAPES = tuple(Mode(kind="hierarchical", index=k, direction="y") for k in range(1, 5))
BEAM: dict[str, Any] = {"length": 0.8, "rho_A": 0.12, "tip_mass": 0.15, "modes": SHAPES}


def horizontal(**changes: Any) -> Arm:
    """One link of the x-y plane, in which gravity points along -y."""
    link = Link(**{**BEAM, "EIz": 6.0, "joint": Joint(rotor_inertia=0.02), **changes})
    return Arm(links=(link,), gravity=(0.0, -G, 0.0))


def elastica(EI: float, root: float = 0.0) -> tuple[float, float]:
    """(2,) [m] tip of a heavy rod with a tip mass, by its boundary value problem in the angle.

    EI theta'' = (rho_A (L - s) + m) g cos theta, theta(0) = root, theta'(L) = 0.
    """
    L, rho, m = BEAM["length"], BEAM["rho_A"], BEAM["tip_mass"]

    def rates(s: Array, y: Array) -> Array:
        load = (rho * (L - s) + m) * G
        return np.stack([y[1], load * np.cos(y[0]) / EI, np.cos(y[0]), np.sin(y[0])])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0] - root, b[1], a[2], a[3]])

    s = np.linspace(0.0, L, 41)
    guess = np.stack([root - (1.0 + root) * s / L, s - 1.0, s, -s * s])
    found = solve_bvp(rates, ends, s, guess, tol=1e-9)
    assert found.success
    return float(found.y[2, -1]), float(found.y[3, -1])


def test_a_stiff_beam_sags_as_the_textbook_says() -> None:
    """Tip: rho_A g L^4 / 8 EI + m g L^3 / 3 EI; torque: that of the straight beam."""
    EI, L = 6e4, BEAM["length"]
    model = Model(horizontal(EIz=EI))

    rest = model.equilibrium(np.zeros(1))

    sag = BEAM["rho_A"] * G * L**4 / (8.0 * EI) + BEAM["tip_mass"] * G * L**3 / (3.0 * EI)
    torque = BEAM["rho_A"] * G * L**2 / 2.0 + BEAM["tip_mass"] * G * L
    assert model.tip(rest.q)[1] == pytest.approx(-sag, rel=1e-6)
    assert_allclose(rest.torque, [torque], rtol=1e-6)


@pytest.mark.parametrize("EI", [6.0, 1.0, 0.4])
def test_a_soft_beam_in_segments_is_the_elastica(EI: float) -> None:
    """Sixteen segments; the softest tip falls by 60 % of the length."""
    arm = horizontal(EIz=EI, segments=16, modes=SHAPES[:2])
    model = Model(replace(arm, foreshortening="fourth-order"))
    x, y = elastica(EI)

    rest = model.equilibrium(np.zeros(1))

    assert_allclose(model.tip(rest.q)[:2], (x, y), atol=1e-4 * BEAM["length"])
    weight = BEAM["tip_mass"] * G * x
    assert 0.0 < rest.torque[0] - weight < 0.5 * BEAM["rho_A"] * G * BEAM["length"] ** 2


@pytest.mark.parametrize(("EI", "lean"), [(0.36, 0.1), (0.36, 0.003), (0.3, 0.01)])
def test_a_rod_too_heavy_to_stand_falls_to_the_side_on_which_it_leans(
    EI: float, lean: float
) -> None:
    """With 0.46 N m^2 it would stand upright."""
    arm = horizontal(EIz=EI, segments=8, modes=SHAPES[:2])
    model = Model(replace(arm, foreshortening="fourth-order"))
    upright = 0.5 * np.pi

    rest = model.equilibrium(np.array([upright - lean]))

    found = elastica(EI, upright - lean)
    assert_allclose(model.tip(rest.q)[:2], found, atol=0.01 * BEAM["length"])
    with pytest.raises(ValueError, match=r"beyond \d+% of its gravity: it buckles"):
        model.equilibrium(np.array([upright]))


@pytest.mark.parametrize("seed", range(4))
def test_the_torques_hold_the_arm_at_rest(seed: int) -> None:
    """Accelerations by the O(n) elimination are zero there."""
    arm = replace(random_arm(seed, 3, 2), gravity=(1.0, -2.0, 3.0))
    joints = list(arm.joint_index)
    angles = random_state(arm, seed)[0][joints]
    model = Model(arm)

    rest = model.equilibrium(angles)

    assert_allclose(rest.q[joints], angles, rtol=0.0, atol=0.0)
    a = accelerations(arm, rest.q, np.zeros(arm.n), rest.torque)
    straight = np.zeros(arm.n)
    straight[joints] = angles
    fallen = accelerations(arm, straight, np.zeros(arm.n), rest.torque)
    assert np.abs(a).max() < 1e-8 * np.abs(fallen).max()


def test_gravity_that_makes_the_guess_singular_is_added_in_shares() -> None:
    """A short soft link carries heavy ones; all of gravity at once throws Newton's method off."""
    upright = [Mode(kind="poly", index=k, direction="z") for k in (1, 2, 3)]
    first = Link(length=0.34, rho_A=1.7, EIz=4.3, EIy=1.4, modes=(*upright, SHAPES[0]))
    places = [(-0.7, -2.1, 0.7), (0.97, 0.019, 2.9), (2.5, -0.9, 0.5)]
    links = [first, Link(length=1.1, rho_A=6.5), Link(length=5.5, rho_A=0.63)]
    turned = [Joint(rotation=Rotation.from_euler("xyz", place).as_matrix()) for place in places]
    arm = Arm(
        links=tuple(replace(link, joint=joint) for link, joint in zip(links, turned, strict=True)),
        gravity=(0.18, -19.0, -5.9),
        payload=Payload(mass=0.3),
    )
    model = Model(arm)

    with pytest.warns(ValidityWarning):
        rest = model.equilibrium(np.array([0.5, -1.2, 1.0]))

    forces = model.inverse_dynamics(rest.q, np.zeros(arm.n), np.zeros(arm.n))
    assert_allclose(forces, model.encoders.T @ rest.torque, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 2.5])
def test_a_few_steps_find_the_equilibrium_of_many_postures_at_once(angle: float) -> None:
    """The link hangs to either side of its axis."""
    model = Model(horizontal(modes=SHAPES[:1]))
    straight = np.zeros((2, model.n))
    straight[:, 0] = angle, 0.3
    expected = [model.equilibrium(q[:1]).q for q in straight]
    assert_allclose(settled(model.traced, straight), expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("shapes", [SHAPES, SHAPES[:1]], ids=len)
def test_a_clamped_beam_without_a_joint_has_its_equilibrium(shapes: tuple[Mode, ...]) -> None:
    held = Model(horizontal(modes=shapes)).equilibrium(np.zeros(1))

    clamped = Model(horizontal(modes=shapes, joint=Joint(type="fixed"))).equilibrium(np.zeros(0))

    assert_allclose(clamped.q, held.q[1:], rtol=1e-10)
    assert clamped.torque.shape == (0,)


def test_a_rigid_link_is_held_by_the_moment_of_its_weight() -> None:
    rest = Model(horizontal(modes=())).equilibrium(np.zeros(1))

    assert_allclose(rest.q, [0.0], atol=0.0)
    weight = 0.5 * BEAM["rho_A"] * BEAM["length"] + BEAM["tip_mass"]
    assert_allclose(rest.torque, [weight * BEAM["length"] * G], rtol=1e-12)


def test_an_arm_that_starts_at_rest_stays_there() -> None:
    model = Model(horizontal())
    rest = model.equilibrium(np.array([0.3]))
    path = simulate(
        model, rest.q, np.zeros(model.n), lambda t: rest.torque, [0.0, 0.5], integrator="dop853"
    )
    assert_allclose(path.q[-1], rest.q, atol=1e-7)


def test_pinned_shapes_and_joint_springs_are_held_too() -> None:
    """Of shapes whose root turns, the torque bends the link as well as it holds the joint."""
    pinned = (Mode(kind="pinned-free", index=1, direction="y"),)
    joint = Joint(rotor_inertia=0.02, stiffness=90.0)
    for changes in ({"modes": pinned, "tip_mass": 0.0}, {"joint": joint}):
        arm = horizontal(**changes)
        rest = Model(arm).equilibrium(np.zeros(1))
        a = accelerations(arm, rest.q, np.zeros(arm.n), rest.torque)
        assert np.abs(a).max() < 1e-8
    assert rest.q[1] == pytest.approx(-rest.torque[0] / 90.0, rel=1e-6)


def test_without_gravity_the_arm_is_straight() -> None:
    rest = Model(ARMS["slim"]).equilibrium([0.7])
    assert_allclose(rest.q, [0.7, *np.zeros(ARMS["slim"].n - 1)], atol=0.0)
    assert_allclose(rest.torque, 0.0, atol=0.0)


def test_what_has_no_equilibrium_is_refused() -> None:
    flying = replace(horizontal(), base=Base(type="free", mass=1.0, inertia=np.eye(3)))
    with pytest.raises(ValueError, match=r"needs a fixed base, got Base\.type 'free'"):
        Model(flying).equilibrium(np.zeros(1))
    with pytest.raises(ValueError, match=r"joint_angles must have shape \(1,\), got \(2,\)"):
        Model(horizontal()).equilibrium(np.zeros(2))


def test_a_rest_beyond_small_deflections_is_told_with_the_link() -> None:
    """One segment errs by 2.7 % of the length against the elastica, four by 0.15 %."""
    tip = np.array(elastica(1.8))

    def error(segments: int) -> float:
        model = Model(horizontal(EIz=1.8, segments=segments))
        found = Stepper(model, 1, dt=1.0, substeps=1)
        out = np.zeros((1, model.n_measure))
        q = model.equilibrium(np.zeros(1)).q[None]
        found.measure(q, np.zeros_like(q), out)
        return float(np.linalg.norm(out[0, model.measurements["tip"]][:2] - tip)) / 0.8

    with pytest.warns(ValidityWarning, match="Link 1 bends by up to 22% of the link's length"):
        assert error(1) > 0.02
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert error(4) < 0.002
