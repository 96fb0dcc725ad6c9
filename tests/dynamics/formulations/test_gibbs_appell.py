"""Gibbs-Appell recursion against brute force, its articulated-body form and energy."""

import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Arm, Joint
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.description.arm import FOURTH_ORDER
from dynamics.description.mode_shapes import KINDS
from dynamics.formulations import gibbs_appell, kinematics
from dynamics.formulations.kinematics import energies
from dynamics.types import Array
from tests.dynamics import brute_force
from tests.dynamics.agreement import (
    accelerations,
    assert_compiled,
    assert_eliminated,
    assert_implicit,
    composite,
    gibbs_residual,
)
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

ANY = [(seed, 1 + seed % 6, seed % 4) for seed in range(24)]  # seed, links, most modes per link
FEW = [
    (0, 1, 1), (1, 1, 3), (2, 2, 2), (3, 2, 3), (4, 3, 3), (5, 4, 2), (6, 6, 1), (7, 3, 0),
    (15, 4, 3), (18, 1, 2), (2, 3, 2), (7, 2, 3), (72, 2, 4), (43, 4, 3), (189, 2, 3), (15, 2, 2),
]  # fmt: skip

any_arm = pytest.mark.parametrize("case", ANY, ids=str)
some_arm = pytest.mark.parametrize("case", FEW, ids=str)


def rate(along: Callable[[Any], Any]) -> float:
    """Exact d/dt at t = 0 of an expression of t."""
    t = ca.SX.sym("t")
    return float(ca.Function("rate", [t], [ca.jacobian(along(t), t)])(0.0))


def moving(t: Any, *derivatives: Array) -> list[Any]:
    """x + t x' (+ t^2/2 x''), element by element."""
    powers = (1.0, t, 0.5 * t * t)
    return [
        sum(p * float(d) for p, d in zip(powers, ds, strict=False))
        for ds in zip(*derivatives, strict=True)
    ]


def test_random_arms_have_everything() -> None:
    """Foreshortened and welded parts with modes, rigid links, torsion, pinned roots, payloads."""
    arms = [random_arm(*case) for case in FEW]
    links = [link for arm in arms for link in arm.links]
    kinds = {mode.kind for link in links for mode in link.modes}

    assert kinds == set(KINDS)
    assert any(arm.foreshortening and arm.n > 10 for arm in arms)
    exact = [link for arm in arms if arm.foreshortening == FOURTH_ORDER for link in arm.links]
    for lumped in (True, False):  # bending in two planes, several shapes in one of them
        wide = [k for k in exact if k.lumped == lumped and k.in_direction("y")]
        assert any(link.in_direction("z") for link in wide)
    assert any(len(k.in_direction("z")) > 1 and k.in_direction("y") for k in exact)
    assert {arm.payload is None for arm in arms} == {True, False}
    assert any(link.segments > 1 and link.modes for link in links)
    assert any(not link.modes for link in links)
    assert any(link.lumped and link.segments > 1 and link.modes for link in links)
    assert any(link.in_direction("x") and link.in_direction("z") for link in links)


@any_arm
def test_elimination_solves_the_composite_equations(case: tuple[int, int, int]) -> None:
    arm = random_arm(*case)
    assert_eliminated(arm, *random_state(arm))


@any_arm
def test_implicit_elimination_solves_the_augmented_equations(case: tuple[int, int, int]) -> None:
    """(M + W) a = B tau - h + W guess, W = s K + d C, K of modes, C of modes and viscous joints."""
    arm = random_arm(*case)
    M, h = composite(arm, *random_state(arm))
    assert_implicit(arm, M, h, random_torque(arm, 1)[0] * np.ones(arm.n), s=1e-5, d=1e-3)


@some_arm
def test_mass_matrix_is_the_metric_of_kinetic_energy(case: tuple[int, int, int]) -> None:
    """M from Gauss points, rotors, hubs and tip bodies; M = M' > 0; T = 1/2 v' M v."""
    arm = random_arm(*case)
    q, v = random_state(arm)

    M, _ = composite(arm, q, v)

    size = np.sqrt(np.diag(M))
    assert np.abs((M - brute_force.mass_matrix(arm, q)) / np.outer(size, size)).max() < 1e-10
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M / np.outer(size, size))[0] > 0.0
    kinetic, _, _ = energies(compiled(arm).chain, floats(q), floats(v))
    assert kinetic == pytest.approx(0.5 * v @ M @ v, rel=1e-12)
    assert kinetic == pytest.approx(brute_force.kinetic_energy(arm, q, v), rel=1e-12)


def residual(arm: Arm, equations: Any = gibbs_appell) -> float:
    """`gibbs_residual` of the recursion or of an altered one."""
    q, v = random_state(arm)
    a = accelerations(arm, q, v, random_torque(arm))
    return gibbs_residual(arm, *composite(arm, q, v, equations), a)


@some_arm
def test_equations_are_the_gradient_of_the_energy_of_acceleration(
    case: tuple[int, int, int],
) -> None:
    """Gibbs-Appell: M a + h = dS/da + elastic, damping and friction forces."""
    assert residual(random_arm(*case)) < 1e-10


@any_arm
def test_inertial_forces_do_the_work_of_a_changing_mass_matrix(case: tuple[int, int, int]) -> None:
    """v' h_inertial = 1/2 v' (dM/dt) v."""
    arm = random_arm(*case)
    q, v = random_state(arm)
    chain = replace(
        compiled(undamped(arm)).chain, gravity=(0.0, 0.0, 0.0),
        links=tuple(
            replace(k, K=_zeros(k.K), K_pairs=_zeros(k.K_pairs))
            for k in compiled(undamped(arm)).chain.links
        ),
    )  # fmt: skip

    def kinetic(t: Any) -> Any:
        M = gibbs_appell.mass_matrix(chain, moving(t, q, v))
        return 0.5 * sum(v[i] * v[j] * M[i][j] for i in range(arm.n) for j in range(arm.n))

    power = rate(kinetic)

    h = np.array(gibbs_appell.bias(chain, floats(q), floats(v)))
    assert v @ h == pytest.approx(power, abs=1e-11 * np.abs(v) @ np.abs(h))


def _zeros(K: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(0.0 for _ in row) for row in K)


def power_imbalance(arm: Arm) -> float:
    """d(T+V)/dt - tau . slip + dissipation, relative to the largest of these powers [-]."""
    (q, v), tau = random_state(arm), random_torque(arm)
    a = accelerations(arm, q, v, tau)
    chain = compiled(arm).chain

    def total(t: Any) -> Any:
        return sum(energies(chain, moving(t, q, v, a), moving(t, v, a)))

    slip = torque_matrix(arm).T @ v
    resisting = brute_force.resisting_forces(arm, q, v)
    elastic = brute_force.resisting_forces(arm, q, 0.0 * v)
    drive, loss = tau @ slip, v @ (resisting - elastic)
    M, _ = composite(arm, q, v)
    inertial = np.sqrt((v @ M @ v) * (a @ M @ a))
    assert loss >= 0.0
    return abs(rate(total) - drive + loss) / max(abs(drive), loss, inertial)


@any_arm
def test_energy_changes_by_the_work_of_torques_less_dissipation(case: tuple[int, int, int]) -> None:
    """d(T+V)/dt = tau . slip - dissipation; T + V and the accelerations share only kinematics."""
    assert power_imbalance(random_arm(*case)) < 1e-11


@pytest.mark.parametrize("seed", range(4))
def test_a_linear_tip_rotation_creates_energy_in_space(seed: int) -> None:
    """E = 1 + theta~ is not a rotation, theta_dot not its angular velocity: correction 5."""
    arm = random_arm(seed, 3, 3)

    assert power_imbalance(replace(arm, rotation="linear")) > 1e-5
    assert power_imbalance(arm) < 1e-11


CORRECTIONS = {  # correction -> source text with it, and without it
    "1: omega x theta_dot, (70)": ("cross(w, theta_dot)", "ZERO"),
    "2: omega_dot x r, (69)": ("matvec(Phi, r)", "matvec(phi_of(w, ZERO), r)"),
    "3: sign of omega~ B9 omega, (44)": (
        "cross(w, matvec(f.B9, w))",
        "scale(-1.0, cross(w, matvec(f.B9, w)))",
    ),
    "4: joint-deflection block mirrored": (
        "M[row][indices[i][c]] = M[indices[i][c]][row] = entry",
        "M[row][indices[i][c]] = entry",
    ),
    "5a: J_l on tip rotation shapes": ("E, [J_l(u) for u in shapes]", "E, shapes"),
    "5b: J_l_dot theta_dot": ("add(bias, J_l(turning))", "J_l(turning)"),
}


def recursion_without(correction: str) -> ModuleType:
    """Module of the recursion with one correction reverted."""
    old, new = CORRECTIONS[correction]
    own = inspect.getsource(gibbs_appell)
    imported = r"from dynamics\.formulations\.kinematics import \([^)]*\)"
    source = inspect.getsource(kinematics) + re.sub(imported, "", own)
    assert source.count(old) == 1, f"the text of correction {correction} has changed"
    module = ModuleType("altered")
    exec(source.replace(old, new), module.__dict__)
    return module


@pytest.mark.parametrize("correction", CORRECTIONS)
def test_every_correction_to_the_paper_is_needed(correction: str) -> None:
    assert residual(random_arm(4, 3, 3), recursion_without(correction)) > 1e-6


@pytest.mark.parametrize("correction", [c for c in CORRECTIONS if not c.startswith("4")])
def test_a_planar_arm_needs_no_correction(correction: str) -> None:
    """The paper's planar example therefore could not reveal these errors."""
    arm = replace(random_arm(4, 3, 3, spatial=False), foreshortening=False)

    assert residual(arm, recursion_without(correction)) < 1e-10


CODE = [random_arm(18, 1, 2), random_arm(3, 2, 3), two_link_spatial()]


@pytest.mark.compiles
@pytest.mark.parametrize("arm", CODE, ids=lambda arm: f"{arm.n_joint}-link-{arm.n}")
@pytest.mark.parametrize("lanes", [1, LANES])
def test_compiled_code_is_the_recursion_on_floats(arm: Arm, lanes: int) -> None:
    """Compared in every lane, including a partly filled block."""
    model = compiled(arm)
    assert_compiled(model, lanes, 1e-12)


@some_arm
def test_an_undeflected_arm_is_the_rigid_chain(case: tuple[int, int, int]) -> None:
    """Textbook forward kinematics, for any modes."""
    arm = random_arm(*case)
    q = compiled(arm).rigid(random_state(arm)[0])

    p, R = np.zeros(3), np.eye(3)
    for link, angle in zip(arm.links, q[list(arm.joint_index)], strict=True):
        c, s = np.cos(angle), np.sin(angle)
        p = p + R @ link.joint.offset
        R = R @ link.joint.rotation @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        p = p + link.length * R[:, 0]

    assert_allclose(compiled(arm).tip(q), p, rtol=0.0, atol=1e-13 * arm.reach)


@some_arm
def test_tip_and_its_velocity_are_those_of_the_bent_arm(case: tuple[int, int, int]) -> None:
    arm = random_arm(*case)
    q, v = random_state(arm)

    tip, velocity = brute_force.tip(arm, q, v)

    assert_allclose(compiled(arm).tip(q), tip, rtol=0.0, atol=1e-12 * arm.reach)
    size = np.abs(velocity).max()
    assert_allclose(compiled(arm).tip_velocity(q, v), velocity, rtol=0.0, atol=1e-12 * size)


def test_a_spatial_arm_moved_in_its_plane_stays_there() -> None:
    """Forces on out-of-plane coordinates at rest are exactly zero."""
    first, second = two_link_spatial().links
    arm = two_link_spatial(links=(first, replace(second, joint=Joint())), gravity=(0.0, -9.81, 0.0))
    out_of_plane = [2, 3, 6]  # "z" bending, torsion
    q, v = random_state(arm)
    q[out_of_plane] = v[out_of_plane] = 0.0

    a = accelerations(arm, q, v, random_torque(arm))

    assert np.all(a[out_of_plane] == 0.0)
    assert np.all(a[[0, 1, 4, 5]] != 0.0)
    assert compiled(arm).tip(q)[2] == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_planar_arm_seen_in_a_mirror_moves_in_the_mirror(seed: int) -> None:
    arm = replace(random_arm(seed, 3, 2, spatial=False), payload=None)
    straight = tuple(
        replace(k, joint=replace(k.joint, offset=(k.joint.offset[0], 0.0, 0.0))) for k in arm.links
    )
    arm = replace(arm, links=straight, gravity=(-9.81, 0.0, 0.0))
    (q, v), tau = random_state(arm), random_torque(arm)

    assert_allclose(accelerations(arm, -q, -v, -tau), -accelerations(arm, q, v, tau), rtol=1e-13)


def test_turning_base_and_gravity_together_changes_nothing() -> None:
    """Accelerations do not depend on the world frame."""
    arm = random_arm(4, 3, 3)
    (q, v), tau = random_state(arm), random_torque(arm)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    first = arm.links[0].joint
    joint = replace(
        first,
        rotation=tuple(map(tuple, turn @ first.rotation)),
        offset=tuple(turn @ first.offset),
    )
    turned = replace(
        arm,
        links=(replace(arm.links[0], joint=joint), *arm.links[1:]),
        gravity=tuple(turn @ arm.gravity),
    )

    a = accelerations(arm, q, v, tau)

    assert_allclose(accelerations(turned, q, v, tau), a, rtol=0.0, atol=1e-11 * np.abs(a).max())
