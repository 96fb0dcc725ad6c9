"""Prismatic joints, elastic joints and rigid bodies of any form against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from dynamics import ARMS, Arm, Body, Joint, Link, Model, simulate
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.description.mode_shapes import Mode
from dynamics.formulations import articulated_body
from tests.dynamics import brute_force
from tests.dynamics.agreement import (
    assert_compiled,
    assert_eliminated,
    assert_equations,
    assert_implicit,
    composite,
)
from tests.dynamics.random_arms import (
    compiled,
    random_arm,
    random_state,
)

CASES = [(seed, 1 + seed % 5, seed % 4) for seed in range(12)]  # seed, links, most modes per link
CLAMPED = replace(  # a link whose shapes fit a joint that slides or yields
    ARMS["slim"].links[0],
    modes=tuple(Mode(kind="clamped-tip-mass", index=index, direction="y") for index in (1, 2)),
)
any_arm = pytest.mark.parametrize("case", CASES, ids=str)


def mixed_arm(seed: int, n_link: int, n_mode: int) -> Arm:
    """A random flexible arm with prismatic and elastic joints and with rigid bodies as links."""
    arm = random_arm(seed, n_link, n_mode)
    rng = np.random.default_rng([seed, 3])
    links = []
    for link in arm.links:
        pinned = any(mode.kind == "pinned-free" for mode in link.modes)
        joint = link.joint
        if rng.random() < 0.5 and not pinned:
            joint = replace(joint, type="prismatic")
        if rng.random() < 0.5:
            joint = replace(
                joint, stiffness=rng.uniform(50.0, 500.0), spring_damping=rng.uniform(0.0, 0.5),
                rotor_inertia=0.1,
            )  # fmt: skip
        link = replace(link, joint=joint)
        if not link.modes:
            link = replace(link, segments=1, rho_A=0.0, length=0.0, body=random_body(rng))
        links.append(link)
    return replace(arm, links=tuple(links))


def random_body(rng: np.random.Generator) -> Body:
    turn = Rotation.random(random_state=rng).as_matrix()
    inertia = turn @ np.diag(rng.uniform(0.02, 0.04, 3)) @ turn.T
    com = tuple(rng.normal(0.0, 0.2, 3))
    return Body(mass=rng.uniform(0.5, 2.0), com=com, inertia=tuple(map(tuple, inertia)))


def test_mixed_arms_have_everything() -> None:
    links = [link for case in CASES for link in mixed_arm(*case).links]
    kinds = {(k.joint.type, k.joint.elastic, bool(k.modes), k.body is None) for k in links}
    assert len(kinds) == 8
    assert any(k.joint.elastic and any(m.kind == "pinned-free" for m in k.modes) for k in links)
    assert any(k.segments > 1 and k.joint.elastic and k.modes for k in links)


@any_arm
def test_mass_matrix_and_bias_are_those_of_brute_force(case: tuple[int, int, int]) -> None:
    arm = mixed_arm(*case)
    assert_equations(arm, *random_state(arm))


@any_arm
def test_elimination_solves_the_composite_equations(case: tuple[int, int, int]) -> None:
    arm = mixed_arm(*case)
    assert_eliminated(arm, *random_state(arm))


@any_arm
def test_implicit_elimination_solves_the_augmented_equations(case: tuple[int, int, int]) -> None:
    """(M + W) a = B tau - h + W guess, W = s K + d C; K and C include joint springs."""
    arm = mixed_arm(*case)
    M, h = composite(arm, *random_state(arm))
    guess = np.random.default_rng(case).normal(0.0, 5.0, arm.n)
    assert_implicit(arm, M, h, guess, s=1e-3, d=1e-2)


@any_arm
def test_energy_and_tip_are_those_of_brute_force(case: tuple[int, int, int]) -> None:
    arm = mixed_arm(*case)
    (q, v), model = random_state(arm), Model(arm)
    smooth = replace(arm, links=tuple(_without_friction(link) for link in arm.links))
    forces = brute_force.resisting_forces(smooth, q, 0.0 * v)  # linear in q

    kinetic, elastic, _ = model.energy(q, v)
    tip, velocity = brute_force.tip(arm, q, v)

    assert kinetic == pytest.approx(brute_force.kinetic_energy(arm, q, v), rel=1e-11)
    assert elastic == pytest.approx(0.5 * q @ forces, rel=1e-11)
    assert_allclose(model.tip(q), tip, rtol=0.0, atol=1e-12 * (arm.reach + np.abs(q).sum()))
    assert_allclose(model.tip_velocity(q, v), velocity, rtol=0.0, atol=1e-11 * np.abs(v).max())


def _without_friction(link: Link) -> Link:
    joint = replace(link.joint, viscous=0.0, coulomb=0.0, spring_damping=0.0)
    return replace(link, joint=joint, damping_ratio=0.0, damping_beta=0.0)


@pytest.mark.compiles
@pytest.mark.parametrize("case", [CASES[3], CASES[6]], ids=str)
@pytest.mark.parametrize("lanes", [1, LANES])
def test_compiled_accelerations_are_those_of_floats(case: tuple[int, int, int], lanes: int) -> None:
    assert_compiled(compiled(mixed_arm(*case)), lanes, 1e-11)


@pytest.mark.compiles
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_energy_is_conserved_while_joints_slide_and_springs_twist(kind: str) -> None:
    """Free motion of a flexible arm without friction, by the compiled code."""
    flexible = _without_friction(replace(CLAMPED, tip_mass=0.3))
    across = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    first = replace(
        flexible, joint=Joint(type=kind, rotor_inertia=0.4, stiffness=80.0, rotation=across)
    )
    last = replace(flexible, joint=Joint(stiffness=30.0, rotor_inertia=0.1))
    arm = Arm(links=(first, last), gravity=(0.0, -9.81, 0.0))
    model = compiled(arm)
    q, v = np.zeros(arm.n), np.zeros(arm.n)
    q[:2], v[0], v[arm.names.index("q2")] = (0.4, 0.1), 1.0, 2.0

    path = simulate(model, q, v, None, np.linspace(0.0, 2.0, 21), integrator="dop853", rtol=1e-11)

    energy = np.array([model.energy(*state) for state in zip(path.q, path.v, strict=True)])
    assert_allclose(energy.sum(axis=1), energy[0].sum(), rtol=1e-8)
    assert np.ptp(energy[:, 1]) > 0.1  # it went in and out of springs and links


# ---- the elastic joint ---------------------------------------------------------------------------

INERTIA, ROTOR, STIFFNESS = 0.7, 0.3, 120.0


def two_masses(kind: str, **joint: float) -> Arm:
    """A rotor, a spring, and one rigid link behind it."""
    body = Body(mass=INERTIA, inertia=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, INERTIA)))
    values = {"rotor_inertia": ROTOR, "stiffness": STIFFNESS, **joint}
    return Arm(links=(Link(length=0.0, body=body, joint=Joint(type=kind, **values)),))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_two_masses_on_a_spring_have_their_frequencies(kind: str) -> None:
    """sqrt(k/J) with the rotor locked, sqrt(k (1/J + 1/J_r)) free; also the damper's decay."""
    model = Model(two_masses(kind, spring_damping=0.4))
    c = 0.4 * (1.0 / INERTIA + 1.0 / ROTOR)

    held, free = (model.frequencies(joints=joints) for joints in ("locked", "free"))
    eigenvalues = np.linalg.eigvals(model.linearize(*np.zeros((2, 2)), np.zeros(1))[0])

    assert model.names == ["q1", "s1"]
    assert_allclose(held, [np.sqrt(STIFFNESS / INERTIA)], rtol=1e-12)
    assert_allclose(free, [np.sqrt(STIFFNESS * (1.0 / INERTIA + 1.0 / ROTOR))], rtol=1e-12)
    assert min(eigenvalues.real) == pytest.approx(-c / 2.0, rel=1e-6)


def test_a_stiff_spring_tends_to_the_rigid_joint() -> None:
    """The distance falls with the inverse of the stiffness; rotor and link move together."""
    first, second = random_arm(2, 2, 2).links
    arm = Arm(links=(first, replace(second, joint=replace(second.joint, rotor_inertia=0.2))))
    wanted = Model(arm).frequencies(joints="free")
    gaps = []
    for k in (1e4, 1e6, 1e8):
        stiff = replace(arm.links[1], joint=replace(arm.links[1].joint, stiffness=k))
        found = Model(replace(arm, links=(first, stiff))).frequencies(joints="free")
        assert found.size == wanted.size + 1
        gaps.append(np.abs(found[:-1] / wanted - 1.0).max())
    assert gaps[0] > 1e-5
    assert gaps[1] == pytest.approx(gaps[0] / 100.0, rel=0.1)
    assert gaps[2] == pytest.approx(gaps[1] / 100.0, rel=0.1)


def sprung_slim(stiffness: float, count: int) -> Arm:
    """SLIM with a spring at its root and `count` shapes that include the tip mass."""
    modes = tuple(replace(CLAMPED.modes[0], index=k) for k in range(1, count + 1))
    joint = Joint(stiffness=stiffness, rotor_inertia=1.0)
    return Arm(links=(replace(CLAMPED, modes=modes, joint=joint),))


def exact_frequency(stiffness: float, low: float, high: float) -> float:
    """[Hz] of SLIM's beam between a root spring and a tip mass, without assumed modes.

    w = 0 and EI w_xx = k w_x at the root; at the tip EI w_xx = J omega^2 w_x and
    EI w_xxx = -m omega^2 w.
    """
    (slim,) = ARMS["slim"].links
    EI, L = float(slim.EIz or 0.0), slim.length

    def determinant(hertz: float) -> float:
        squared = (2.0 * np.pi * hertz) ** 2
        b = (slim.rho_A * squared / EI) ** 0.25
        s, c, sh, ch = np.sin(b * L), np.cos(b * L), np.sinh(b * L), np.cosh(b * L)
        root = -stiffness / (2.0 * EI * b)  # of cos - cosh, per slope of sin and sinh
        mass = slim.tip_mass * squared / (EI * b**3)
        spin = slim.tip_inertia[2][2] * squared / (EI * b)  # of w_x/b
        both = np.array([c - ch, -s - sh, -c - ch, s - sh]) * root  # w, w_x/b, w_xx/b^2, w_xxx/b^3
        a, d = np.add(both, (s, c, -s, -c)), np.add(both, (sh, ch, sh, ch))
        moments = [x[2] - spin * x[1] for x in (a, d)]
        forces = [x[3] + mass * x[0] for x in (a, d)]
        return float(moments[0] * forces[1] - moments[1] * forces[0])

    return float(brentq(determinant, low, high))


@pytest.mark.parametrize("stiffness", [1.0, 10.0, 100.0])
def test_slim_on_a_spring_vibrates_between_free_and_held(stiffness: float) -> None:
    """Rotor locked: from 9.66 Hz of the free joint to 2.096 and 13.989 Hz of the clamped one."""
    few, many = (
        Model(sprung_slim(stiffness, count)).frequencies()[:2] / (2.0 * np.pi) for count in (2, 8)
    )
    ranges = ((0.1, 2.096), (9.66, 13.99))
    exact = np.array([exact_frequency(stiffness, *range_) for range_ in ranges])

    assert np.all(many < few)
    assert np.all(many > exact * (1.0 - 1e-9))
    assert_allclose(many, exact, rtol=5e-4)


def test_slim_on_a_soft_and_a_stiff_spring_is_slim_free_and_held() -> None:
    soft, stiff = (Model(sprung_slim(k, 8)).frequencies() / (2.0 * np.pi) for k in (1e-9, 1e9))

    assert soft[0] < 1e-4
    assert_allclose(soft[1], 9.664, rtol=5e-4)
    assert_allclose(stiff[:2], [2.096, 13.989], rtol=1e-4)


def test_randomised_stiffness_damping_and_friction_reach_the_elastic_joint() -> None:
    """They scale the spring, its damper and the friction of the rotor."""
    joint = {"rotor_inertia": 0.3, "stiffness": 90.0, "spring_damping": 0.7, "viscous": 0.2}
    own = {"stiffness": "stiffness", "damping": "spring_damping", "friction": "viscous"}
    model = Model(two_masses("revolute", **joint), tuple(own))
    q, v = [0.3, 0.2], [-0.5, 0.9]
    for k, name in enumerate(own.values()):
        scaled = {**joint, name: 1.7 * joint[name]}
        chain = Model(two_masses("revolute", **scaled)).chain

        found = model.graph(q, v, 1.5, 1.0 + 0.7 * np.eye(3)[k], [])

        expected = articulated_body.accelerations(chain, q, v, [1.5])
        assert_allclose(np.array(found).ravel(), expected, rtol=1e-13)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_spring_leaves_a_light_rotor_nothing_of_the_links_inertia(kind: str) -> None:
    """A rotor with 1e-10 of the link's inertia amplifies round-off of the link a million times."""
    for inertia in (0.7, 0.9, 1.1, 1.3, 2.9):
        body = Body(mass=inertia, inertia=np.diag([0.0, 0.0, inertia]))
        joint = Joint(type=kind, rotor_inertia=1e-10, stiffness=STIFFNESS)
        chain = Model(Arm(links=(Link(length=0.0, body=body, joint=joint),))).chain

        rotor, twist = articulated_body.accelerations(chain, [0.4, 0.2], [0.0, 0.0], [3.0])

        assert rotor == pytest.approx((3.0 + STIFFNESS * 0.2) / 1e-10, rel=1e-13)
        assert twist == pytest.approx(-rotor - STIFFNESS * 0.2 / inertia, rel=1e-13)
