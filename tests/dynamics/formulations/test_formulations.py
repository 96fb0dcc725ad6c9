"""Every formulation against brute force, energy and the other formulations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ARMS, Arm, compile_arm, simulate
from dynamics.formulations import articulated_body
from dynamics.formulations.articulated_body import Implicit
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.table import FORMULATIONS
from dynamics.types import Array
from tests.dynamics import brute_force
from tests.dynamics.agreement import gibbs_residual
from tests.dynamics.random_arms import (
    compiled,
    floats,
    random_arm,
    random_state,
    random_torque,
    torque_matrix,
    two_link_spatial,
    undamped,
)

CASES = [
    (0, 1, 1), (1, 1, 3), (33, 2, 2), (3, 2, 3), (4, 3, 3), (5, 4, 2), (6, 6, 1), (9, 3, 0),
    (15, 4, 3), (2, 3, 2),
]  # fmt: skip
SIBLINGS = [name for name in FORMULATIONS if name != "gibbs_appell"]

every = pytest.mark.parametrize("name", FORMULATIONS)
sibling = pytest.mark.parametrize("name", SIBLINGS)
some_arm = pytest.mark.parametrize("case", CASES, ids=str)


@dataclass(frozen=True)
class Formed:
    """A formulation of one arm, evaluated with floats."""

    name: str
    chain: Chain

    @classmethod
    def of(cls, name: str, arm: Arm) -> "Formed":
        return cls(name, compiled(arm).chain)

    def M(self, q: Array) -> Array:
        return np.array(FORMULATIONS[self.name].equations.mass_matrix(self.chain, floats(q)))

    def h(self, q: Array, v: Array) -> Array:
        forces = FORMULATIONS[self.name].equations.bias(self.chain, floats(q), floats(v))
        return np.array(forces)

    def a(self, q: Array, v: Array, tau: Array, implicit: Implicit | None = None) -> Array:
        solve = FORMULATIONS[self.name].accelerations
        return np.array(solve(self.chain, floats(q), floats(v), floats(tau), implicit))

    def energies(self, q: Sequence[Any], v: Sequence[Any]) -> tuple[Any, Any, Any]:
        return FORMULATIONS[self.name].energies(self.chain, q, v)


def scaled(arm: Arm, factor: float, seed: int = 0) -> tuple[Array, Array]:
    """A random state with deflections and their rates scaled by `factor`."""
    q, v = random_state(arm, seed)
    rigid = np.isin(np.arange(arm.n), arm.joint_index)
    return np.where(rigid, q, factor * q), np.where(rigid, v, factor * v)


def apart(x: Array, y: Array, M: Array) -> float:
    """Relative difference of forces, in the norm of kinetic energy [-]."""
    d, s = np.linalg.solve(M, np.array([x - y, y]).T).T
    return float(np.sqrt((d @ M @ d) / (s @ M @ s)))


# ---- against brute force; of the recursion in test_gibbs_appell.py -------------------------------


@sibling
@some_arm
def test_mass_matrix_is_the_metric_of_kinetic_energy(name: str, case: tuple[int, int, int]) -> None:
    arm = random_arm(*case)
    q, _ = random_state(arm)

    M = Formed.of(name, arm).M(q)

    size = np.sqrt(np.diag(M))
    assert np.abs((M - brute_mass_matrix(arm)) / np.outer(size, size)).max() < 1e-10
    assert np.array_equal(M, M.T)


@cache
def brute_mass_matrix(arm: Arm) -> Array:
    """M by brute force at the state of `random_state`; slow."""
    return brute_force.mass_matrix(arm, random_state(arm)[0])


def residual(name: str, arm: Arm) -> float:
    """`gibbs_residual` of a formulation."""
    (q, v), formed = random_state(arm), Formed.of(name, arm)
    return gibbs_residual(arm, formed.M(q), formed.h(q, v), formed.a(q, v, random_torque(arm)))


@sibling
@some_arm
def test_equations_are_the_gradient_of_the_energy_of_acceleration(
    name: str, case: tuple[int, int, int]
) -> None:
    assert residual(name, random_arm(*case)) < 1e-10


def twisting_arm(n_link: int, n_mode: int) -> Arm:
    """A random arm of this size with torsion in a link, which also bends if it has more modes."""
    for seed in count():
        arm = random_arm(seed, n_link, n_mode)
        twists = [link for link in arm.links if link.in_direction("x")]
        if n_mode == 0 or any(len(link.modes) > 1 for link in twists) or (twists and n_mode == 1):
            return arm
    raise AssertionError


@pytest.mark.parametrize("n_mode", range(4))
@pytest.mark.parametrize("n_link", range(1, 7))
def test_the_recursion_holds_for_one_to_six_links_with_up_to_three_modes(
    n_link: int, n_mode: int
) -> None:
    """Gibbs-Appell against the energy of acceleration, torsion included."""
    arm = twisting_arm(n_link, n_mode)

    assert arm.n_joint == n_link
    assert len(arm.links[0].modes) == n_mode
    assert any(link.in_direction("x") for link in arm.links) == (n_mode > 0)
    assert residual("gibbs_appell", arm) < 1e-10


# ---- against its own equations -------------------------------------------------------------------


@every
@some_arm
@pytest.mark.parametrize("rotation", ["exp", "linear"])
def test_accelerations_solve_the_formulations_own_equations(
    name: str, case: tuple[int, int, int], rotation: str
) -> None:
    """M a + h = B tau, also if E is not a rotation; with implicit forces (M + W) a."""
    arm = replace(random_arm(*case), rotation=rotation)
    (q, v), tau = random_state(arm), random_torque(arm)
    formed = Formed.of(name, arm)
    M, h = formed.M(q), formed.h(q, v)
    drive = torque_matrix(arm) @ tau - h

    a = formed.a(q, v, tau)

    assert apart(M @ a, drive, M) < 1e-10
    guess = np.linspace(-1.0, 2.0, arm.n)
    implicit = formed.a(q, v, tau, Implicit([1e-5] * arm.n, [1e-3] * arm.n, floats(guess)))
    W = augmentation(arm, 1e-5, 1e-3)
    assert apart((M + W) @ implicit, drive + W @ guess, M + W) < 1e-10


@pytest.mark.parametrize("case", [*CASES, "ralf-like", "free-flyer", "stanford"], ids=str)
def test_the_recursion_states_the_equations_that_it_solves(case: str | tuple[int, ...]) -> None:
    """Forces in excess: (M + W) a without accelerations, none with them; x answers forces alone."""
    arm = ARMS[case] if isinstance(case, str) else random_arm(*case)
    chain, n = compiled(arm).chain, arm.n
    (q, v), tau = map(floats, random_state(arm)), floats(random_torque(arm))
    M = np.array(FORMULATIONS["gibbs_appell"].equations.mass_matrix(chain, q))
    cases: list[tuple[Implicit | None, Array]] = [(None, np.zeros((n, n)))]
    if not isinstance(case, str):
        guess = floats(np.linspace(-1.0, 2.0, n))
        W = augmentation(arm, 1e-5, 1e-3)
        cases.append((Implicit([1e-5] * n, [1e-3] * n, guess), W))
    for weights, W in cases:
        a = articulated_body.accelerations(chain, q, v, tau, weights)
        excess = articulated_body.imbalance(chain, q, v, tau, [0.0] * n, weights)
        rest = articulated_body.imbalance(chain, q, v, tau, a, weights)
        x = articulated_body.response(chain, q, excess, weights)
        force = np.array(excess)
        assert apart((M + W) @ np.array(a), force, M + W) < 1e-10
        assert apart(force + np.array(rest), force, M + W) < 1e-10
        assert apart((M + W) @ np.array(x), force, M + W) < 1e-10


def augmentation(arm: Arm, s: float, d: float) -> Array:
    """s K + d C from brute-force forces, without Coulomb friction."""
    smooth = [replace(link, joint=replace(link.joint, coulomb=0.0)) for link in arm.links]
    plain = replace(arm, links=tuple(smooth))
    zero = np.zeros(arm.n)
    K = [brute_force.resisting_forces(plain, e, zero) for e in np.eye(arm.n)]
    C = [brute_force.resisting_forces(plain, zero, e, dampers=False) for e in np.eye(arm.n)]
    return s * np.array(K).T + d * np.array(C).T


@every
@some_arm
@pytest.mark.parametrize("rotation", ["exp", "linear"])
def test_kinetic_energy_is_the_quadratic_form_of_the_mass_matrix(
    name: str, case: tuple[int, int, int], rotation: str
) -> None:
    """T is computed from velocities, in the formulation's own convention."""
    arm = replace(random_arm(*case), rotation=rotation)
    q, v = random_state(arm)
    formed = Formed.of(name, arm)

    kinetic, _, _ = formed.energies(floats(q), floats(v))

    assert kinetic == pytest.approx(0.5 * v @ formed.M(q) @ v, rel=1e-12)


def power_imbalance(name: str, arm: Arm) -> float:
    """d(T+V)/dt - tau . slip of an undamped arm, relative to the power of inertia [-]."""
    arm = undamped(arm)
    (q, v), tau = random_state(arm), random_torque(arm)
    formed = Formed.of(name, arm)
    a, M = formed.a(q, v, tau), formed.M(q)
    t = ca.SX.sym("t")
    moved = [x + t * y for x, y in zip(floats(q), floats(v), strict=True)]
    rates = [x + t * y for x, y in zip(floats(v), floats(a), strict=True)]
    total = sum(formed.energies(moved, rates))
    gained = float(ca.Function("rate", [t], [ca.jacobian(total, t)])(0.0))
    drive = float(tau @ (torque_matrix(arm).T @ v))
    return abs(gained - drive) / float(np.sqrt((v @ M @ v) * (a @ M @ a)))


@every
@some_arm
def test_energy_changes_by_the_work_of_torques(name: str, case: tuple[int, int, int]) -> None:
    assert power_imbalance(name, random_arm(*case)) < 1e-11


@some_arm
def test_book_conserves_energy_even_where_E_is_no_rotation(case: tuple[int, int, int]) -> None:
    """Positions, velocities and equations of motion derive from one E."""
    assert power_imbalance("book", replace(random_arm(*case), rotation="linear")) < 1e-11


@pytest.mark.parametrize("name", ["gibbs_appell", "complement"])
def test_a_rate_that_is_not_that_of_E_creates_energy(name: str) -> None:
    """theta_dot is not the angular velocity of 1 + theta~."""
    assert power_imbalance(name, replace(random_arm(4, 3, 3), rotation="linear")) > 1e-5


# ---- against each other --------------------------------------------------------------------------


@sibling
@some_arm
def test_siblings_agree_with_the_recursion(name: str, case: tuple[int, int, int]) -> None:
    """M, h and accelerations to round-off."""
    arm = random_arm(*case)
    (q, v), tau = random_state(arm, 1), random_torque(arm, 1)
    mine, theirs = Formed.of(name, arm), Formed.of("gibbs_appell", arm)
    M = theirs.M(q)

    size = np.sqrt(np.diag(M))
    assert np.abs((mine.M(q) - M) / np.outer(size, size)).max() < 1e-12
    assert apart(mine.h(q, v), theirs.h(q, v), M) < 1e-12
    assert apart(M @ mine.a(q, v, tau), M @ theirs.a(q, v, tau), M) < 1e-10
    energies = [np.array(x.energies(floats(q), floats(v))) for x in (mine, theirs)]
    assert_allclose(energies[0], energies[1], rtol=1e-11, atol=1e-12)


@every
def test_no_wrench_and_one_of_zero_are_the_same_in_every_formulation(name: str) -> None:
    """1 + theta~ sets the formulations apart."""
    arm = replace(random_arm(4, 3, 3), rotation="linear")
    model, (q, v) = compile_arm(arm, formulation=name), random_state(arm)

    loaded = model.inverse_dynamics(q, v, v, np.zeros(6))

    assert_allclose(loaded, model.inverse_dynamics(q, v, v), rtol=1e-12)


@some_arm
def test_the_complement_shares_the_convention_of_the_recursion(case: tuple[int, int, int]) -> None:
    """Also with a linear E: both turn vectors by 1 + theta~ and use theta_dot as its rate."""
    arm = replace(random_arm(*case), rotation="linear")
    q, v = random_state(arm)
    mine, theirs = Formed.of("complement", arm), Formed.of("gibbs_appell", arm)
    M = theirs.M(q)

    size = np.sqrt(np.diag(M))
    assert np.abs((mine.M(q) - M) / np.outer(size, size)).max() < 1e-12
    assert apart(mine.h(q, v), theirs.h(q, v), M) < 1e-12


@every
@pytest.mark.parametrize("case", [(4, 3, 3), (5, 4, 2), (3, 2, 3)], ids=str)
def test_a_straight_arm_knows_no_convention(name: str, case: tuple[int, int, int]) -> None:
    """Without tip slope 1 + theta~ is a rotation, and Book's E_dot gives the same M and h."""
    arm = random_arm(*case)
    q = compiled(arm).rigid(random_state(arm)[0])
    linear = Formed.of(name, replace(arm, rotation="linear"))

    M = Formed.of("gibbs_appell", arm).M(q)

    assert_allclose(linear.M(q), M, rtol=0.0, atol=1e-12 * np.abs(M).max())
    v = compiled(arm).rigid(random_state(arm)[1])
    h = Formed.of("gibbs_appell", arm).h(q, v)
    assert_allclose(linear.h(q, v), h, rtol=0.0, atol=1e-12 * np.abs(h).max())


ORDERS = [  # formulation, spatial, order in the amplitude of M's difference to a true rotation
    ("gibbs_appell", False, 2.0),
    ("gibbs_appell", True, 1.0),
    ("book", False, 1.0),
    ("book", True, 1.0),
]


@pytest.mark.parametrize(("name", "spatial", "order"), ORDERS)
def test_conventions_part_with_the_amplitude_of_the_tip_slope(
    name: str, spatial: bool, order: float
) -> None:
    """In the plane theta_dot has a second-order error, E_dot of 1 + theta~ a first-order one."""
    arm = random_arm(4, 3, 3, spatial=spatial) if not spatial else two_link_spatial()
    linear = Formed.of(name, replace(arm, rotation="linear"))
    true = Formed.of(name, arm)

    def difference(factor: float) -> float:
        q, _ = scaled(arm, factor)
        M = true.M(q)
        size = np.sqrt(np.diag(M))
        return float(np.abs((linear.M(q) - M) / np.outer(size, size)).max())

    found = np.log2(difference(2e-3) / difference(1e-3))
    assert found == pytest.approx(order, abs=0.05)


@sibling
def test_siblings_follow_the_same_motion(name: str) -> None:
    """Two spatial links under gravity and a torque for one second, by each formulation."""
    arm = two_link_spatial()
    q, _ = random_state(arm)

    def torque(t: float) -> Array:
        return np.array([4.0 * np.sin(5.0 * t), -2.0])

    times = [0.0, 0.3, 1.0]
    mine, theirs = (
        simulate(compile_arm(arm, formulation=x), q, 0.0 * q, torque, times, rtol=1e-11)
        for x in (name, "gibbs_appell")
    )

    assert np.linalg.norm(theirs.tip[-1] - theirs.tip[0]) > 0.3
    assert_allclose(mine.tip, theirs.tip, rtol=0.0, atol=1e-9)
    assert_allclose(mine.q, theirs.q, rtol=0.0, atol=1e-8)
