"""Parallel drives, whose angle is measured from the base of the joint before: brute force."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Arm, Joint, Link, Mode, Model, load_arm, simulate
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.formulations.kinematics import outward, poses
from dynamics.formulations.newton_euler import rigid_links
from dynamics.types import Array
from tests.dynamics import brute_force
from tests.dynamics.agreement import (
    accelerations,
    assert_compiled,
    assert_eliminated,
    assert_equations,
    assert_implicit,
    composite,
)
from tests.dynamics.random_arms import (
    compiled,
    floats,
    flying,
    random_arm,
    random_state,
    random_torque,
    undamped,
)

# seed, links, most modes per link, joints driven in parallel (numbered from 0)
CASES = [
    (0, 2, 2, (1,)), (1, 2, 3, (1,)), (2, 3, 2, (1,)), (3, 3, 3, (2,)), (4, 3, 2, (1, 2)),
    (5, 4, 1, (1, 3)), (6, 4, 3, (2, 3)), (7, 2, 0, (1,)), (8, 5, 2, (1, 2, 4)), (9, 3, 3, (1,)),
    (12, 2, 3, (1,)), (13, 3, 3, (2,)),
]  # fmt: skip
SPRUNG = (2, 9)  # seeds of arms whose parallel joints have springs
Case = tuple[int, int, int, tuple[int, ...]]
any_arm = pytest.mark.parametrize("case", CASES, ids=str)
some_arm = pytest.mark.parametrize("case", CASES[:4], ids=str)


def turn(angle: float) -> Any:
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))


def parallel_arm(seed: int, n_link: int, n_mode: int, driven: tuple[int, ...]) -> Arm:
    """A random arm in space; links before parallel joints bend only in their plane."""
    arm = random_arm(seed, n_link, n_mode)
    rng = np.random.default_rng([seed, 5])
    links = list(arm.links)
    for i in driven:
        joint = replace(
            links[i].joint, parallel=True, rotation=turn(rng.uniform(-2.0, 2.0)), offset=(0, 0, 0)
        )
        if seed in SPRUNG:
            spring = {"stiffness": 200.0, "spring_damping": 0.3, "rotor_inertia": 0.1}
            joint = replace(joint, **spring)
        links[i] = replace(links[i], joint=joint)
        before = links[i - 1]
        kept = [mode for mode in before.modes if mode.direction in ("y", "axial")]
        if n_mode and not any(mode.direction == "y" for mode in kept):
            kept.append(Mode(kind=str(rng.choice(["poly", "pinned-free"])), index=1, direction="y"))
        links[i - 1] = replace(before, modes=tuple(kept), segments=1)
    return replace(arm, links=tuple(links))


def at_origin(arm: Arm) -> tuple[Array, Array]:
    """A random state; a free base is at zero rotation, where rates are velocities."""
    q, v = random_state(arm)
    q[: arm.base.n] = 0.0
    return q, v


def test_the_arms_have_everything() -> None:
    arms = [parallel_arm(*case) for case in CASES]
    before = [
        inner for arm in arms for inner, link in zip(arm.links, arm.links[1:], strict=False)
        if link.joint.parallel
    ]  # fmt: skip
    parallel = [link for arm in arms for link in arm.links if link.joint.parallel]

    assert {mode.direction for link in before for mode in link.modes} == {"y", "axial"}
    assert {"poly", "pinned-free", "clamped-free"} <= {m.kind for k in before for m in k.modes}
    assert any(len(link.modes) > 1 for link in before)
    assert any(link.tip_mass for link in before)
    assert any(link.joint.rotor_inertia for link in before)
    assert any(link.joint.coulomb for link in parallel)
    assert any(link.segments > 1 for link in parallel)
    assert any(link.joint.elastic and link.modes for link in parallel)
    assert {bool(arm.foreshortening) for arm in arms} == {arm.payload is None for arm in arms}


@any_arm
@pytest.mark.parametrize("base", ["fixed", "free"])
def test_equations_are_those_of_brute_force(case: Case, base: str) -> None:
    arm = parallel_arm(*case)
    arm = flying(arm) if base == "free" else arm
    assert_equations(arm, *at_origin(arm))


@any_arm
@pytest.mark.parametrize("base", ["fixed", "free"])
@pytest.mark.parametrize("rotation", ["exp", "linear"])
def test_elimination_solves_the_composite_equations(case: Case, base: str, rotation: str) -> None:
    arm = replace(parallel_arm(*case), rotation=rotation)
    arm = flying(arm) if base == "free" else arm
    assert_eliminated(arm, *at_origin(arm))


@any_arm
def test_implicit_elimination_solves_the_augmented_equations(case: Case) -> None:
    """(M + W) a = B tau - h + W guess, W = s K + d C."""
    arm = parallel_arm(*case)
    M, h = composite(arm, *random_state(arm))
    guess = np.random.default_rng(case[0]).normal(0.0, 5.0, arm.n)
    assert_implicit(arm, M, h, guess, s=1e-4, d=1e-2)


@any_arm
@pytest.mark.parametrize("rotation", ["exp", "linear"])
def test_mass_matrix_is_the_metric_of_the_kinetic_energy(case: Case, rotation: str) -> None:
    """T is computed from velocities; also with a linear tip rotation, which brute force lacks."""
    arm = replace(parallel_arm(*case), rotation=rotation)
    q, v = random_state(arm)
    M, _ = composite(arm, q, v)

    kinetic, elastic, _ = Model(arm).energy(q, v)

    assert kinetic == pytest.approx(0.5 * v @ M @ v, rel=1e-12)
    frictionless, (nodes, weights) = undamped(arm), np.polynomial.legendre.leggauss(3)
    work = [
        q @ brute_force.resisting_forces(frictionless, s * q, 0.0 * q) for s in 0.5 + 0.5 * nodes
    ]
    assert elastic == pytest.approx(0.5 * weights @ work, rel=1e-11)


@any_arm
def test_tip_and_its_velocity_are_those_of_brute_force(case: Case) -> None:
    arm = parallel_arm(*case)
    (q, v), model = random_state(arm), Model(arm)

    tip, velocity = brute_force.tip(arm, q, v)

    assert_allclose(model.tip(q), tip, rtol=0.0, atol=1e-12 * arm.reach)
    assert_allclose(model.tip_velocity(q, v), velocity, rtol=0.0, atol=1e-11 * np.abs(v).max())


@some_arm
def test_neither_turning_nor_bending_the_link_before_turns_this_one(case: Case) -> None:
    arm = parallel_arm(*case)
    q, _ = random_state(arm)
    (i,) = case[3]
    own = [k for k, name in enumerate(arm.names) if name[0] in "qd" and name[1] == str(i)]
    moved = q.copy()
    moved[own] += 0.1
    model = Model(arm)
    last = model.bodies[i].start

    def link(x: Array) -> Any:
        return poses(outward(model.chain, floats(x), floats(0.0 * x)))[last]

    assert len(own) > 1
    assert_allclose(link(moved).R, link(q).R, rtol=0.0, atol=1e-14)
    assert np.abs(np.subtract(link(moved).joint, link(q).joint)).max() > 1e-3


COMPILED = [CASES[1], CASES[4]]


@pytest.mark.compiles
@pytest.mark.parametrize("case", COMPILED, ids=str)
@pytest.mark.parametrize("lanes", [1, LANES])
def test_compiled_accelerations_are_those_of_floats(case: Case, lanes: int) -> None:
    assert_compiled(compiled(parallel_arm(*case)), lanes, 1e-11)


def two_links(**joint: Any) -> Arm:
    """A planar flexible arm without friction and damping."""
    mode = Mode(kind="clamped-free", index=1, direction="y")
    link = Link(length=0.8, rho_A=1.1, EIz=150.0, tip_mass=0.4, modes=(mode,))
    second = replace(link, length=0.6, joint=Joint(parallel=True, **joint))
    return Arm(links=(link, second), gravity=(0.0, -9.81, 0.0), foreshortening=True)


@pytest.mark.compiles
def test_energy_is_conserved_in_motion() -> None:
    """Free fall under gravity, by the compiled code."""
    model = compiled(two_links(stiffness=60.0, rotor_inertia=0.1))
    q, v = np.zeros(model.n), np.zeros(model.n)
    q[0], q[2], v[2] = 0.4, -0.9, 3.0

    path = simulate(model, q, v, None, np.linspace(0.0, 2.0, 21), integrator="dop853", rtol=1e-11)

    energy = np.array([model.energy(*state) for state in zip(path.q, path.v, strict=True)])
    assert_allclose(energy.sum(axis=1), energy[0].sum(), rtol=0.0, atol=1e-8 * np.ptp(energy[:, 0]))
    assert np.ptp(energy[:, 1]) > 0.1


def test_a_flying_arm_keeps_its_momentum() -> None:
    """Moments that bypass a link act on the base, so there is no external moment."""
    arm = undamped(replace(flying(parallel_arm(2, 3, 2, (1,))), gravity=(0.0, 0.0, 0.0)))
    (q, v), tau = at_origin(arm), random_torque(arm)
    a, chain = accelerations(arm, q, v, tau), Model(arm).chain

    def momentum(t: float) -> Array:
        from dynamics.formulations.free_base import momentum

        x, rates = q + t * v + 0.5 * t * t * a, v + t * a
        return np.concatenate(momentum(chain, floats(x), floats(rates)))

    rate = (momentum(1e-5) - momentum(-1e-5)) / 2e-5
    size = np.abs(momentum(0.0)).max() * np.abs(a).max()
    assert np.abs(rate).max() < 1e-8 * size


def test_a_rigid_planar_arm_is_the_textbooks() -> None:
    """M12 = m2 l1 c2 cos(q2 - q1), M11 and M22 constant; only -+ m2 l1 c2 sin(q2 - q1) v^2."""
    l1, l2, r1, r2, rotor = 0.7, 0.5, 2.0, 3.0, 0.05
    joint = Joint(parallel=True, rotor_inertia=rotor)
    arm = Arm(links=(Link(length=l1, rho_A=r1), Link(length=l2, rho_A=r2, joint=joint)))
    m2 = r2 * l2
    coupling = m2 * l1 * 0.5 * l2
    q, v = np.array([0.3, 1.4]), np.array([1.7, -2.2])
    turned = q[1] - q[0]

    M, h = composite(arm, q, v)

    M12 = coupling * np.cos(turned)
    M11, M22 = r1 * l1**3 / 3.0 + m2 * l1**2, m2 * l2**2 / 3.0 + rotor
    assert_allclose(M, [[M11, M12], [M12, M22]], rtol=1e-14)
    centrifugal = coupling * np.sin(turned)
    assert_allclose(h, [-centrifugal * v[1] ** 2, centrifugal * v[0] ** 2], rtol=1e-13)


def test_it_is_the_serial_arm_in_other_coordinates() -> None:
    """Rigid links: q2 parallel = q1 + q2 serial; serially, motor 2 acts on both."""
    arm = two_links()
    rigid = replace(arm, links=tuple(replace(link, modes=()) for link in arm.links))
    second = replace(rigid.links[1], joint=Joint())
    serial = replace(rigid, links=(rigid.links[0], second))
    T = np.array([[1.0, 0.0], [1.0, 1.0]])  # parallel = T serial
    x, rates = np.array([0.5, 0.8]), np.array([1.1, -0.4])

    M, h = composite(rigid, T @ x, T @ rates)
    M_serial, h_serial = composite(serial, x, rates)

    assert_allclose(T.T @ M @ T, M_serial, rtol=1e-13)
    assert_allclose(T.T @ h, h_serial, rtol=1e-12)


# ---- refusals ------------------------------------------------------------------------------------

SLAB = Link(length=1.0, rho_A=1.0, EIz=50.0, EIy=50.0, GJ=50.0, rho_Ip=0.1, modes=())
DRIVEN = replace(SLAB, joint=Joint(parallel=True))
ACROSS = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def bending(direction: str) -> Link:
    kind = "torsion-poly" if direction == "x" else "poly"
    return replace(SLAB, modes=(Mode(kind=kind, index=1, direction=direction),))


@pytest.mark.parametrize(
    ("links", "message"),
    [
        ((DRIVEN,), "or the joint behind another, got the first joint"),
        ((SLAB, replace(SLAB, joint=Joint(parallel=True, type="prismatic"))),
         r'this joint "revolute", got Joint.type \'prismatic\' of this joint'),
        ((replace(SLAB, joint=Joint(type="prismatic")), DRIVEN),
         r'the joint before "revolute", got Joint.type \'prismatic\' of the joint before'),
        ((SLAB, replace(SLAB, joint=Joint(parallel=True, rotation=ACROSS))),
         r"or Joint.rotation a turn about z, got Joint.rotation \(\(1.0"),
        ((SLAB, replace(SLAB, joint=Joint(parallel=True, offset=(0.0, 0.1, 0.0)))),
         r"or Joint.offset zero, got Joint.offset \(0.0, 0.1, 0.0\)"),
        ((replace(SLAB, joint=Joint(stiffness=9.0, rotor_inertia=0.1)), DRIVEN),
         r"or no spring there, got Joint.stiffness 9.0 on the joint before"),
        ((replace(SLAB, joint=Joint(root=(0.1, 0.0, 0.0))), DRIVEN),
         r"or Joint.root zero there, got Joint.root \(0.1, 0.0, 0.0\) of the joint before"),
        ((replace(bending("y"), segments=2), DRIVEN),
         r"or that link in one piece, got Link.segments 2 of the link before"),
        ((bending("z"), DRIVEN), r'got Link.modes of the link before along "z"'),
        ((bending("x"), DRIVEN), r'got Link.modes of the link before along "x"'),
    ],
    ids=range(10),
)  # fmt: skip
def test_it_is_refused_where_no_planar_parallelogram_can_be(
    links: tuple[Link, ...], message: str
) -> None:
    with pytest.raises(ValueError, match="Joint.parallel of link .*" + message):
        Arm(links=links)


def test_it_is_true_or_false_and_survives_a_file() -> None:
    with pytest.raises(ValueError, match=r"Joint.parallel must be true or false, got 1\."):
        Joint(parallel=1)  # type: ignore[arg-type]
    arm = two_links()
    assert arm.to_dict()["links"][1]["joint"] == {"parallel": True}
    assert load_arm(arm.to_dict()) == arm


@pytest.mark.parametrize("formulation", ["book", "complement"])
def test_other_formulations_refuse_it(formulation: str) -> None:
    with pytest.raises(ValueError, match=r"does not support Joint\.parallel, got True"):
        Model(two_links(), formulation=formulation)


def test_newton_euler_refuses_it() -> None:
    rigid = Arm(links=(SLAB, DRIVEN))
    with pytest.raises(ValueError, match="but link 2 has a parallel drive"):
        rigid_links(rigid)
