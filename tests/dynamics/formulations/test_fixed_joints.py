"""Fixed joints, roots beside their joints, bodies on flexible links and payloads beyond the tip."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from dynamics import Arm, Body, Joint, Link, Model, Payload, load_arm, simulate
from dynamics.formulations import newton_euler
from tests.dynamics import brute_force
from tests.dynamics.agreement import accelerations, assert_compiled, assert_implicit
from tests.dynamics.random_arms import (
    compiled,
    floats,
    flying,
    random_arm,
    random_state,
    random_torque,
    torque_matrix,
    undamped,
)

CASES = [(seed, 2 + seed % 4, seed % 4) for seed in range(8)]  # seed, links, most modes per link
EXACT = {"integrator": "dop853", "rtol": 1e-11}
any_arm = pytest.mark.parametrize("case", CASES, ids=str)
TOOL = {"length": 0.0, "body": {"mass": 0.3, "com": [0.2, 0.1, 0.0], "inertia": np.eye(3).tolist()}}
ROOTED: dict[str, list[dict[str, Any]]] = {  # links beyond one with a root, by what they change
    "nothing": [], "bending": [{**TOOL, "joint": {"type": "fixed"}}], "torsion": [TOOL],
}  # fmt: skip


def built_up(seed: int, n_link: int, n_mode: int) -> Arm:
    """A random flexible arm with fixed joints, offset roots, bodies and a payload off the tip."""
    arm, rng = random_arm(seed, n_link, n_mode), np.random.default_rng([seed, 5])
    links = []
    for i, link in enumerate(arm.links):
        loose = any(mode.kind in ("pinned-free", "unconstrained") for mode in link.modes)
        joint, body = link.joint, None
        if not loose:
            root = tuple(rng.normal(0.0, 0.1, 3)) if rng.random() < 0.5 else joint.root
            joint = replace(joint, root=root)
            body = _body(rng) if rng.random() < 0.5 else None
            body = body if link.modes or link.segments == 1 else None
            if rng.random() < 0.3:
                joint = replace(joint, stiffness=200.0, spring_damping=0.3, rotor_inertia=0.1)
        if i % 2 and not loose:
            gives = {"stiffness": 150.0, "spring_damping": 0.2} if rng.random() < 0.4 else {}
            place = {"rotation": joint.rotation, "offset": joint.offset, "root": root}
            joint = Joint(type="fixed", **place, **gives)
        links.append(replace(link, joint=joint, body=body))
    payload = Payload(mass=0.4, com=tuple(rng.normal(0.0, 0.1, 3)), inertia=_body(rng).inertia)
    return replace(arm, links=tuple(links), payload=payload)


def _body(rng: np.random.Generator) -> Body:
    turn = Rotation.random(random_state=rng).as_matrix()
    inertia = turn @ np.diag(rng.uniform(0.02, 0.04, 3)) @ turn.T
    com = tuple(rng.normal(0.0, 0.1, 3))
    return Body(mass=rng.uniform(0.2, 1.0), com=com, inertia=tuple(map(tuple, inertia)))


def test_built_up_arms_have_everything() -> None:
    links = [link for case in CASES for link in built_up(*case).links]
    fixed = [link for link in links if not link.joint.moves]
    assert any(k.modes for k in fixed)
    assert any(not k.modes for k in fixed)
    assert any(any(k.joint.root) for k in fixed)
    assert any(any(k.joint.root) and k.joint.elastic for k in fixed)
    assert any(not any(k.joint.root) and k.joint.elastic for k in fixed)
    assert any(any(k.joint.root) and k.joint.elastic for k in links)
    assert any(k.body and k.modes and k.segments > 1 for k in links)


@any_arm
def test_mass_matrix_forces_and_energies_are_those_of_brute_force(
    case: tuple[int, int, int],
) -> None:
    arm = built_up(*case)
    model, (q, v) = Model(arm), random_state(arm)
    a = np.random.default_rng(case[0]).normal(0.0, 5.0, arm.n)
    resisting = brute_force.resisting_forces(arm, q, v)

    M, h = model.mass_matrix(q), model.bias(q, v)

    assert_allclose(M, brute_force.mass_matrix(arm, q), rtol=0.0, atol=1e-12 * np.abs(M).max())
    loads = brute_force.inertial_forces(arm, q, v, a) + resisting
    assert_allclose(M @ a + h, loads, rtol=0.0, atol=1e-11 * np.abs(loads).max())
    kinetic, _, gravity = model.energy(q, v)
    assert kinetic == pytest.approx(brute_force.kinetic_energy(arm, q, v), rel=1e-11)
    assert gravity == pytest.approx(brute_force.gravity_energy(arm, q), rel=1e-11, abs=1e-11)
    position, velocity = brute_force.tip(arm, q, v)
    assert_allclose(model.tip(q), position, rtol=0.0, atol=1e-12 * (arm.reach + np.abs(q).sum()))
    assert_allclose(model.tip_velocity(q, v), velocity, rtol=0.0, atol=1e-11 * np.abs(v).max())


@any_arm
def test_accelerations_solve_the_equations_of_motion(case: tuple[int, int, int]) -> None:
    arm = built_up(*case)
    model, (q, v), tau = Model(arm), random_state(arm), random_torque(arm)
    M, h = model.mass_matrix(q), model.bias(q, v)

    a = accelerations(arm, q, v, tau)

    assert brute_force.imbalance(M, a, torque_matrix(arm) @ tau - h) < 1e-12
    assert_implicit(arm, M, h, np.random.default_rng(1).normal(size=arm.n), 3e-3, 2e-3)


@pytest.mark.compiles
def test_compiled_accelerations_are_those_of_floats() -> None:
    model = compiled(built_up(*CASES[3]))
    assert_compiled(model, 1, 1e-11)


@pytest.mark.parametrize("case", [CASES[1], CASES[6]], ids=str)
def test_momentum_on_a_free_base_is_that_of_brute_force(case: tuple[int, int, int]) -> None:
    arm = flying(built_up(*case))
    (q, v), model = random_state(arm), Model(arm)
    q[: arm.base.n] = 0.0

    linear, angular = model.momentum(q, v)

    expected = brute_force.momentum(arm, q, v)
    size = np.abs(np.concatenate(expected)).max()
    assert_allclose(linear, expected[0], rtol=0.0, atol=1e-11 * size)
    assert_allclose(angular, expected[1], rtol=0.0, atol=1e-11 * size)


@pytest.mark.parametrize("formulation", ["book", "complement"])
def test_other_formulations_carry_a_payload_beyond_the_tip(formulation: str) -> None:
    plain = random_arm(4, 3, 2)
    inertia = _body(np.random.default_rng(0)).inertia
    payload = Payload(mass=0.4, com=(0.1, -0.05, 0.07), inertia=inertia)
    body = _body(np.random.default_rng(1))
    links = tuple(
        replace(k, body=body)
        for k in plain.links
        if all(mode.kind != "pinned-free" for mode in k.modes) and (k.modes or k.segments == 1)
    )
    arm = replace(plain, links=links, payload=payload, foreshortening=False)
    assert any(link.modes for link in links)
    ours, other = Model(arm), Model(arm, formulation=formulation)
    q, v = random_state(arm)

    M, h = ours.mass_matrix(q), ours.bias(q, v)

    assert_allclose(other.mass_matrix(q), M, rtol=0.0, atol=1e-12 * np.abs(M).max())
    assert_allclose(other.bias(q, v), h, rtol=0.0, atol=1e-11 * np.abs(h).max())


@pytest.mark.parametrize("seed", range(4))
def test_rigid_arms_have_the_torques_of_newton_and_euler(seed: int) -> None:
    arm = undamped(built_up(seed, 5, 0))
    springless = [
        replace(link, joint=replace(link.joint, stiffness=None, spring_damping=0.0))
        for link in arm.links
    ]
    arm = replace(arm, links=tuple(springless))
    (q, v), model = random_state(arm), Model(arm)
    a = np.random.default_rng(seed).normal(0.0, 3.0, arm.n)

    found = model.inverse_dynamics(q, v, a)

    bodies = newton_euler.rigid_links(arm)
    expected = newton_euler.inverse_dynamics(bodies, *map(floats, (q, v, a)), gravity=arm.gravity)
    assert_allclose(found, expected, rtol=0.0, atol=1e-11 * np.abs(found).max())
    assert arm.n_joint < len(arm.links)


def test_a_randomised_payload_is_added_at_its_centre() -> None:
    arm = built_up(*CASES[2])
    model = Model(arm, ("payload_mass",))
    q, v = random_state(arm)
    tau = random_torque(arm)
    heavier = replace(arm, payload=replace(arm.payload, mass=arm.payload.mass + 0.7))

    found = model.graph(q, v, tau, 0.7, [])

    assert_allclose(np.array(found).ravel(), accelerations(heavier, q, v, tau), rtol=1e-10)


@pytest.mark.compiles
def test_energy_is_conserved_while_welded_links_swing() -> None:
    arm = replace(undamped(built_up(5, 3, 2)), foreshortening=False)
    links = [
        replace(k, joint=replace(k.joint, spring_damping=0.0), segments=1, lumped=False)
        for k in arm.links
    ]
    model = compiled(replace(arm, links=tuple(links)))
    q, v = random_state(model.arm)

    path = simulate(model, 0.1 * q, 0.1 * v, None, np.linspace(0.0, 0.5, 6), **EXACT)

    energy = [sum(model.energy(*state)) for state in zip(path.q, path.v, strict=True)]
    assert_allclose(energy, energy[0], rtol=1e-8)


# ---- the beam of docs/own_arm.md -----------------------------------------------------------------

BEAM: dict[str, Any] = {"length": 0.8, "rho_A": 0.12, "EIz": 6.0, "tip_mass": 0.15}


def beam(**arm: Any) -> Model:
    shapes = [{"kind": "hierarchical", "index": k, "direction": "y"} for k in range(1, 9)]
    return Model(load_arm({"links": [{**BEAM, "modes": shapes}], **arm}))


def exact_hertz(mass: float, beyond: float, low: float, high: float) -> float:
    """[Hz] of the clamped beam with a point mass `beyond` its tip [m], by Euler and Bernoulli.

    At the tip EI w_xx = omega^2 (m b w + m b^2 w_x), EI w_xxx = -omega^2 ((m + M) w + m b w_x).
    """
    EI, L, rho, tip = BEAM["EIz"], BEAM["length"], BEAM["rho_A"], BEAM["tip_mass"]

    def determinant(hertz: float) -> float:
        squared = (2.0 * np.pi * hertz) ** 2
        b = (rho * squared / EI) ** 0.25
        s, c, sh, ch = np.sin(b * L), np.cos(b * L), np.sinh(b * L), np.cosh(b * L)
        rows = []
        for w in ([ch - c, sh + s, ch + c, sh - s], [sh - s, ch - c, sh + s, ch + c]):
            w0, w1, w2, w3 = (x * b**k for k, x in enumerate(w))
            push = squared * mass * beyond
            moment = EI * w2 - push * w0 - push * beyond * w1
            force = EI * w3 + squared * (mass + tip) * w0 + push * w1
            rows.append((moment, force))
        return float(rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0])

    return float(brentq(determinant, low, high))


@pytest.mark.parametrize(("beyond", "hertz"), [(0.0, (1.807, 27.7)), (0.05, (1.745, 25.34))])
def test_a_payload_beyond_the_tip_has_the_frequencies_of_the_exact_beam(
    beyond: float, hertz: tuple[float, float]
) -> None:
    model = beam(payload={"mass": 0.1, "com": [beyond, 0.0, 0.0]})
    exact = [exact_hertz(0.1, beyond, 0.9 * f, 1.1 * f) for f in hertz]
    assert_allclose(model.frequencies()[:2] / (2.0 * np.pi), exact, rtol=1e-6)
    assert_allclose(exact, hertz, rtol=2e-3)


@pytest.mark.parametrize("beyond", ROOTED)
def test_a_root_beside_the_joint_is_a_hub_of_that_radius(beyond: str) -> None:
    """A rigid link without mass in front, to which the beam is welded, does not change it."""
    joint, others = {"rotor_inertia": 0.02}, ROOTED[beyond]
    link = {**BEAM, "GJ": 4.0, "rho_Ip": 1e-4, "modes": "auto"}
    hub = load_arm({"links": [{**link, "joint": {**joint, "root": [0.05, 0.0, 0.0]}}, *others]})
    tiny = {"length": 0.05, "body": {"mass": 1e-12}, "joint": joint}
    welded = load_arm({"links": [tiny, {**link, "joint": {"type": "fixed"}}, *others]})
    for joints in ("locked", "free"):
        found = Model(hub).frequencies(joints=joints)
        assert_allclose(Model(welded).frequencies(joints=joints), found, rtol=1e-9)
    assert welded.names[:4] == ("q1", "d2_1", "d2_2", "d2_3")
    assert welded.reach == hub.reach == pytest.approx(0.85)


@pytest.mark.parametrize("turn", [0.0, 0.7, np.pi / 2])
def test_a_fixed_joint_at_an_angle_is_a_rotor_held_there(turn: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    angle = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    first = {**BEAM, "modes": "auto", "joint": {"rotor_inertia": 0.02}}
    second = {**BEAM, "length": 0.4, "modes": "auto"}
    weld = {"type": "fixed", "rotation": angle}
    fixed = Model(load_arm({"links": [first, {**second, "joint": weld}]}))
    first["modes"] = [asdict(mode) for mode in fixed.arm.links[0].modes]  # of a laden link
    held = Model(load_arm({"links": [first, {**second, "joint": {"rotor_inertia": 1e9}}]}))
    q = np.zeros(held.n)
    q[held.names.index("q2")] = turn
    assert_allclose(fixed.frequencies(), held.frequencies(q), rtol=1e-6)


def test_a_body_on_a_flexible_link_moves_with_its_root() -> None:
    """It loads the free joint with its inertia about the axis, and leaves the held one alone."""
    body = Body(mass=0.5, com=(0.03, 0.04, 0.0), inertia=np.diag([0.0, 0.0, 1e-3]))
    link = Link(**BEAM, modes=beam().arm.links[0].modes, joint=Joint(rotor_inertia=0.02))
    bare, loaded = Model(Arm(links=(link,))), Model(Arm(links=(replace(link, body=body),)))
    heavier = replace(link, joint=Joint(rotor_inertia=0.02 + 1e-3 + 0.5 * 0.05**2))
    assert_allclose(loaded.frequencies(), bare.frequencies(), rtol=1e-12)
    wanted = Model(Arm(links=(heavier,))).frequencies(joints="free")
    assert_allclose(loaded.frequencies(joints="free"), wanted, rtol=1e-12)


# ---- a clamp that gives --------------------------------------------------------------------------


def clamp(stiffness: float, kind: str = "hierarchical", **joint: Any) -> Arm:
    """A beam of unit length, mass and rigidity on a clamp with k l / EI = stiffness."""
    modes = [{"kind": kind, "index": k, "direction": "y"} for k in range(1, 9)]
    link = {"length": 1.0, "rho_A": 1.0, "EIz": 1.0, "modes": modes}
    return load_arm({"links": [{**link, "joint": {"stiffness": stiffness, **joint}}]})


@pytest.mark.parametrize("stiffness", [0.1, 1.0, 10.0, 100.0])
def test_a_restrained_cantilever_has_the_frequencies_of_its_exact_beam(stiffness: float) -> None:
    """Wave numbers times length: k (1 + cos b cosh b) = b (sin b cosh b - cos b sinh b)."""
    arm = clamp(stiffness, type="fixed")

    def characteristic(b: float) -> float:
        turning = np.sin(b) - np.cos(b) * np.tanh(b)
        return float(stiffness * (1.0 / np.cosh(b) + np.cos(b)) - b * turning)

    roots = [brentq(characteristic, low, high) for low, high in ((0.1, 2.5), (3.5, 4.8), (6.8, 8))]
    found = np.sqrt(Model(arm).frequencies()[:3])

    assert arm.names[:2] == ("s1", "d1_1")
    assert arm.n_joint == 0
    assert_allclose(found, roots, rtol=1e-6)


def test_a_clamp_that_gives_is_an_elastic_joint_whose_rotor_is_held() -> None:
    arm = clamp(3.0, type="fixed", spring_damping=0.2)
    held = clamp(3.0, rotor_inertia=0.1, spring_damping=0.2)
    assert_allclose(Model(arm).frequencies(), Model(held).frequencies(), rtol=1e-9)


def test_a_spring_without_rotor_names_the_clamp() -> None:
    with pytest.raises(ValueError, match='A clamp that gives has no rotor: type "fixed"'):
        clamp(3.0)
