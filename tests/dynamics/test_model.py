"""Quantities of the compiled arm against published tables, beam theory and each other."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ARMS, Arm, Joint, Link, Mode, Model, Payload, compile_arm, load_arm, simulate
from dynamics.description.validate import ZEROS
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.types import Array
from tests.dynamics.agreement import assert_slopes, central
from tests.dynamics.random_arms import (
    compiled,
    random_arm,
    random_state,
    random_torque,
    torque_matrix,
    two_link_spatial,
)
from tests.paths import REFERENCE

HANGING = -np.pi / 2


def korayem(count: int, payload: float = 0.0) -> Arm:
    """Two hanging 1 m links, EI 1000 N m^2, 5 kg/m (Korayem & Shafei 2009; Usoro et al. 1986)."""
    modes = tuple(Mode(kind="clamped-free", index=k, direction="y") for k in range(1, count + 1))
    link = Link(length=1.0, rho_A=5.0, EIz=1000.0, modes=modes)
    carried = Payload(mass=payload) if payload else None
    return Arm(links=(link, link), gravity=(0.0, -9.81, 0.0), payload=carried)


def slim(hub: float, count: int, kind: str = "clamped-tip-mass", **changes: float) -> Arm:
    """A 48 in aluminium beam with a tip mass on a hub (Yuan, Book & Huggins 1993).

    Unlike the preset it has the handbook's density and a point mass fitted to mode 1.
    """
    values = {"rho_A": 0.24610, "tip_mass": 0.0408, "tip_inertia": ZEROS, **changes}
    modes = tuple(Mode(kind=kind, index=k, direction="y") for k in range(1, count + 1))
    (link,) = ARMS["slim"].links
    link = replace(link, modes=modes, joint=replace(link.joint, rotor_inertia=hub), **values)
    return Arm(links=(link,))


def assert_prints_as(values: Array, printed: str, units: float = 0.51) -> None:
    """Agreement with printed numbers within `units` (default half a unit) of their last digit."""
    numbers = printed.split()
    assert len(values) == len(numbers)
    for value, number in zip(values, numbers, strict=True):
        unit = 10.0 ** -len(number.partition(".")[2])
        assert value == pytest.approx(float(number), abs=units * unit), (values, printed)


# ---- frequencies ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arm", "printed"),
    [
        (korayem(1), "0.42655 1.1439 36.199 63.276"),
        (korayem(2), "0.42654 1.1437 25.940 45.067 150.23 207.95"),
        (korayem(3), "0.42654 1.1437 25.852 44.815 97.041 130.56 345.9 444.0"),
        (korayem(2, payload=1.0), "0.4101 1.1539 24.562 39.077 147.7 196.7"),
    ],
    ids=["1 mode", "2 modes", "3 modes", "2 modes, 1 kg"],
)
def test_hanging_arm_swings_and_bends_at_the_tabulated_frequencies(arm: Arm, printed: str) -> None:
    """Eigenvalues of the linearised motion under gravity, in Hz."""
    model = compiled(arm)
    q = np.zeros(model.n)
    q[0] = HANGING

    A, _ = model.linearize(q, 0.0 * q, np.zeros(2))

    eigenvalues = np.linalg.eigvals(A)
    assert np.abs(eigenvalues.real).max() < 1e-6 * np.abs(eigenvalues).max()
    found = np.sort(eigenvalues.imag[eigenvalues.imag > 0.0]) / (2.0 * np.pi)
    assert_prints_as(found, printed)


def test_frequencies_do_not_depend_on_gravity() -> None:
    """Elastic forces alone act, so no pendulum frequency is among them."""
    weightless = replace(korayem(2), gravity=(0.0, 0.0, 0.0))
    q = np.array([HANGING, 0.0, 0.0, 0.5, 0.0, 0.0])

    found = compiled(korayem(2)).frequencies(q, joints="free")

    assert np.array_equal(found, compiled(weightless).frequencies(q, joints="free"))
    assert found.size == 4
    assert found[0] > 2.0 * np.pi * 20.0


SLIM = [
    (slim(0.0, 5), "locked", "2.096 13.989 40.53 81.27 136.5"),
    (slim(0.0, 5, "clamped-free", tip_mass=0.0), "locked", "2.609 16.353 45.788 89.727 148.324"),
    (slim(1e-10, 1), "free", "12.78"),
    (slim(1e-10, 2), "free", "9.674 48.0"),
    (slim(1e-10, 2, "clamped-free"), "free", "9.685 51.3"),
    (slim(1e-3, 1), "free", "11.80"),
    (slim(1e-3, 2), "free", "9.418 33.33"),
    (slim(1e-3, 2, "clamped-free"), "free", "9.428 34.44"),
    (slim(1e-2, 1), "free", "7.850"),
    (slim(1e-2, 2), "free", "7.445 17.72"),
    (slim(1e-2, 2, "clamped-free"), "free", "7.449 17.92"),
    (slim(0.1, 1), "free", "3.587"),
    (slim(0.1, 2), "free", "3.583 14.33"),
    (slim(0.1, 2, "clamped-free"), "free", "3.584 14.44"),
]


@pytest.mark.parametrize(("arm", "joints", "printed"), SLIM, ids=[row[2] for row in SLIM])
def test_slim_vibrates_at_the_tabulated_frequencies(arm: Arm, joints: str, printed: str) -> None:
    """Hz, joint locked and free, several hubs and shapes; some table entries are truncated."""
    found = compiled(arm).frequencies(joints=joints) / (2.0 * np.pi)

    assert_prints_as(found, printed, units=1.01)


@pytest.mark.parametrize(
    ("hub", "kind", "printed"),
    [
        (1e-10, "pinned-free", "9.664 32.58"),
        (1e-10, "clamped-tip-mass", "9.664 32.58"),
        (1e-2, "clamped-tip-mass", "7.442 17.66"),
    ],
)
def test_frequencies_with_a_free_joint_converge_from_above_as_modes_are_added(
    hub: float, kind: str, printed: str
) -> None:
    """To the exact frequencies [Hz] of a solution without assumed modes."""
    exact = np.array([float(x) for x in printed.split()])
    few, many = (
        compiled(slim(hub, count, kind)).frequencies(joints="free")[:2] / (2.0 * np.pi)
        for count in (3, 10)
    )

    assert np.all(many < few)
    assert np.all(many > exact * (1.0 - 2e-4))
    assert_allclose(many, exact, rtol=5e-4)


@pytest.mark.parametrize("joints", ["locked", "free"])
def test_a_stiff_plane_leaves_the_frequencies_of_the_soft_one(joints: str) -> None:
    """A link 1e15 times as stiff across; squares of all frequencies span 19 decades."""
    soft, stiff = (Mode(kind="poly", index=1, direction=direction) for direction in "yz")
    flat = Link(length=1.0, rho_A=0.5, EIz=10.0, modes=(soft,), joint=Joint(rotor_inertia=0.1))
    second = replace(flat, EIz=0.1, tip_mass=1.0)
    planar, spatial = (
        Arm(links=tuple(replace(link, EIy=1e16, modes=modes) for link in (flat, second)))
        for modes in ((soft,), (soft, stiff))
    )

    found = compiled(spatial).frequencies(joints=joints)

    assert_allclose(found[:2], compiled(planar).frequencies(joints=joints), rtol=1e-11)


def test_frequencies_equal_those_of_the_linearised_weightless_arm() -> None:
    """Two code paths: eigenvalues of K and M, and of the Jacobian of the accelerations."""
    arm = two_link_spatial(gravity=(0.0, 0.0, 0.0))
    undamped = tuple(
        replace(k, damping_beta=0.0, joint=replace(k.joint, viscous=0.0)) for k in arm.links
    )
    model = compiled(replace(arm, links=undamped))
    q = model.rigid(random_state(model.arm)[0])

    A, _ = model.linearize(q, 0.0 * q, np.zeros(2))

    found = np.sort(np.abs(np.linalg.eigvals(A)))[-2 * (model.n - 2) :: 2]
    assert_allclose(found, model.frequencies(q, joints="free"), rtol=1e-8)


# ---- motion --------------------------------------------------------------------------------------

RELEASED = {  # arm: t [s], theta1, theta2 [deg], tip x, tip y [m], w1, w2 [mm]
    "1 mode": (korayem(1), """
        0.1 -89.708992 3.894121 0.0784129 -1.9973019 0.107478 0.099757
        0.25 -88.577713 -0.480878 0.0411912 -1.9995581 -0.022966 -0.005190
        0.5 -88.394582 -3.827116 -0.0107467 -1.9988571 -0.018085 0.046408
        1.0 -92.160057 2.226159 -0.0367141 -1.9992870 -0.051271 -0.054851"""),
    "2 modes": (korayem(2), """
        0.1 -89.712027 3.878018 0.0784376 -1.9973023 0.192151 0.216450
        0.25 -88.582255 -0.481421 0.0411844 -1.9995582 0.055073 -0.058306
        0.5 -88.392341 -3.824692 -0.0107341 -1.9988578 -0.059302 0.072568
        1.0 -92.159648 2.232737 -0.0366952 -1.9992859 -0.085856 -0.047243"""),
    "2 modes, 1 kg": (korayem(2, payload=1.0), """
        0.1 -89.657453 3.886709 0.0798844 -1.9972494 0.030001 0.042795
        0.25 -88.353962 -0.510336 0.0485759 -1.9993901 0.023667 -0.018215
        0.5 -88.139369 -3.708973 0.0003442 -1.9989532 0.053257 0.001079
        1.0 -92.271444 2.011175 -0.0444267 -1.9992004 -0.069549 -0.070813"""),
}  # fmt: skip


@pytest.mark.parametrize("name", RELEASED)
def test_released_arm_follows_the_tabulated_motion(name: str) -> None:
    """Joint angles, tip and deflections to every printed digit, from -90 and +5 degrees."""
    arm, table = RELEASED[name]
    rows = [line.split() for line in table.strip().splitlines()]
    model = compiled(arm)
    q = np.zeros(model.n)
    q[list(arm.joint_index)] = np.deg2rad([-90.0, 5.0])
    times = [0.0, *(float(row[0]) for row in rows)]

    motion = simulate(model, q, 0.0 * q, None, times, rtol=1e-11)

    for row, q, tip in zip(rows, motion.q[1:], motion.tip[1:], strict=True):
        joints = np.rad2deg(q[list(arm.joint_index)])
        bent = [1e3 * sum(delta) for _, delta in model.chain.split(q)]
        assert_prints_as(np.array([*joints, *tip[:2], *bent]), " ".join(row[1:]))


# ---- quantities at a state -----------------------------------------------------------------------


@pytest.fixture(params=[(1, 1, 3), (3, 2, 3), (4, 3, 3)], ids=str, scope="module")
def model(request: pytest.FixtureRequest) -> Model:
    return compiled(random_arm(*request.param))


def test_energies_are_the_quadratic_forms_of_M_and_K(model: Model) -> None:
    q, v = random_state(model.arm)

    kinetic, elastic, _ = model.energy(q, v)

    assert kinetic == pytest.approx(0.5 * v @ model.mass_matrix(q) @ v, rel=1e-12)
    assert elastic == pytest.approx(0.5 * q @ model.stiffness @ q, rel=1e-12)


def test_the_static_bias_is_the_gradient_of_the_potential_energy(model: Model) -> None:
    """h(q, 0) = dV/dq, by central differences."""
    q, _ = random_state(model.arm)
    rest = np.zeros(model.n)

    def potential(x: Array) -> float:
        return sum(model.energy(x, rest)[1:])

    slope = [central(lambda x, e=e: potential(q + x * e)) for e in np.eye(model.n)]

    h = model.bias(q, rest)
    assert_allclose(slope, h, rtol=0.0, atol=1e-7 * np.abs(h).max())


def test_inverse_dynamics_undoes_the_accelerations(model: Model) -> None:
    """M a + h = B tau for the accelerations under tau."""
    (q, v), tau = random_state(model.arm), random_torque(model.arm)

    forces = model.inverse_dynamics(q, v, model.accelerations(q, v, tau))

    expected = torque_matrix(model.arm) @ tau
    size = np.abs(model.bias(q, v)).max()
    assert_allclose(forces, expected, rtol=0.0, atol=1e-10 * size)


def test_linearisation_equals_central_differences_of_the_accelerations(model: Model) -> None:
    """About a moving, bent state."""
    (q, v), tau = random_state(model.arm), random_torque(model.arm)
    n, m = model.n, model.n_joint

    A, B = model.linearize(q, v, tau)

    assert A.shape == (2 * n, 2 * n)
    assert B.shape == (2 * n, m)
    assert np.array_equal(A[:n], np.eye(2 * n)[n:])
    assert not B[:n].any()
    assert_slopes(model, A, q, v, tau)
    for k, e in enumerate(np.eye(m)):
        by_tau = central(lambda x, e=e: model.accelerations(q, v, tau + x * e), 1.0)
        assert_allclose(B[n:, k], by_tau, rtol=0.0, atol=1e-9 * np.abs(B).max())


def test_tip_velocity_is_the_time_derivative_of_the_tip(model: Model) -> None:
    q, v = random_state(model.arm)

    moved = central(lambda t: model.tip(q + t * v), 1e-4)

    assert_allclose(model.tip_velocity(q, v), moved, atol=1e-8)


def test_the_graph_and_the_compiled_code_give_the_same_accelerations(model: Model) -> None:
    (q, v), tau = random_state(model.arm), random_torque(model.arm)

    traced = np.array(model.graph(q, v, tau, [], [])).ravel()

    assert_allclose(model.accelerations(q, v, tau), traced, rtol=1e-10)


def test_strain_is_the_curvature_of_a_cantilever_under_a_tip_load() -> None:
    """The shapes x^2 and x^3 contain the exact deflection F x^2 (3 l - x) / (6 EI)."""
    l, EI, F = 0.8, 12.0, 3.0
    modes = tuple(
        Mode(kind="poly", index=k, direction=along) for along in ("y", "z") for k in (1, 2)
    )
    torsion = Mode(kind="torsion-poly", index=1, direction="x")
    link = Link(length=l, rho_A=1.0, EIz=EI, EIy=EI, GJ=5.0, rho_Ip=0.1, modes=(*modes, torsion))
    model = compiled(Arm(links=(link,)))
    bend = np.array([F * l**3 / (2.0 * EI), -F * l**3 / (6.0 * EI)])  # [m] of x^2 and x^3 over l
    q = np.array([0.3, *bend, *(2.0 * bend), 0.4])

    for x in (0.0, 0.3, l):
        load = F * (l - x) / EI
        assert_allclose(model.strain(q, 0, x), [0.4 / l, -2.0 * load, load], atol=1e-14)
    # both shapes are 1 at the tip, so the load's generalized forces equal F
    assert_allclose(model.bias(q, 0.0 * q)[1:3], [F, F], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "multiplications", "additions", "divisions"),
    [
        ("S1_m2", 34, 24, 1),
        ("two_link_korayem_m2", 167, 132, 4),
        ("spatial_two_link_torsion", 1061, 824, 8),
        ("six_link_m2", 3858, 3130, 18),
    ],
)
def test_accelerations_take_no_more_operations_than_the_prototype(
    name: str, multiplications: int, additions: int, divisions: int
) -> None:
    """Operations in the prototype's code, with constants folded and symmetric halves shared.

    Multiplications and additions are compared by their sum, as 2 x may count as either.
    """
    arm = load_arm(REFERENCE / f"{name}.json")
    model = compile_arm(arm)

    text = Path(str(model.program(1, "rk4").__file__)).read_text()

    counts = model.operation_count()["accelerations"]
    lines = text.split("accelerations = ")[1].split("measure = ")[0]
    assert counts["multiplications"] + counts["additions"] <= multiplications + additions
    assert lines.count(" / ") <= divisions


def test_mass_matrix_and_bias_of_six_links_take_a_fifth_of_the_published_operations() -> None:
    """Korayem & Shafei count 19 557 multiplications and 18 332 additions for six links."""
    counts = compile_arm(load_arm(REFERENCE / "six_link_m2.json")).operation_count()

    assert counts["mass matrix and bias"]["multiplications"] <= 3752 < 19_557 / 5
    assert counts["mass matrix and bias"]["additions"] <= 3030 < 18_332 / 5
    assert counts["mass matrix and bias"]["divisions"] == 0


BAD = [
    ({"formulation": "newton"}, "Unknown formulation 'newton'"),
    ({"dtype": "float16"}, "Unknown dtype 'float16'"),
    ({"free_parameters": ("colour",)}, r"Unknown free parameter 'colour'. Known: \["),
    ({"free_parameters": "stiffness"}, "free_parameters must be a list, got 'stiffness'"),
]


@pytest.mark.parametrize(("change", "sentence"), BAD, ids=[str(c) for c, _ in BAD])
def test_an_unknown_compile_option_is_refused_with_the_known_ones(
    change: dict[str, object], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        compile_arm(ARMS["slim"], **change)
    assert set(FREE_PARAMETERS) >= {"payload_mass", "stiffness", "damping", "friction"}


def test_an_invalid_argument_is_refused_with_its_name_and_shape() -> None:
    model = compiled(ARMS["slim"])
    q = np.zeros(3)
    for call, sentence in (
        (lambda: model.mass_matrix(np.zeros(2)), r"q must have shape \(3,\), got \(2,\)"),
        (lambda: model.bias(q, np.zeros((3, 1))), r"v must have shape \(3,\), got \(3, 1\)"),
        (lambda: model.accelerations(q, q, q), r"tau must have shape \(1,\), got \(3,\)"),
        (lambda: model.strain(q, 1, 0.0), "link must be between 0 and 0, got 1"),
        (lambda: model.strain(q, 0, 2.0), "x must be within the link, 0 to 1.2192 m, got 2.0"),
        (lambda: model.frequencies(q, joints="loose"), "joints must be .* got 'loose'"),
        (lambda: simulate(model, q, q, None, []), "times must be at least one number"),
        (lambda: simulate(model, q, q, None, [0.0, 1.0, 1.0]), "times must .* strictly increasing"),
        (lambda: model.bias(q, np.ma.array(q, mask=[0, 1, 0])), "v must have no masked .* 1 of 3"),
        (lambda: simulate(model, q + 1e30, q, None, [0.0, 1.0]), r"q\[0\] must be .* got 1e\+30"),
        (lambda: simulate(model, q, q - 1e9, None, [0.0, 1.0]), r"v\[0\] must be .* got -1e\+09"),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()


def test_a_model_is_not_changed_through_the_arrays_that_it_returns() -> None:
    model = compile_arm(ARMS["slim"], free_parameters=("payload_mass", "stiffness"))
    for name in ("encoders", "stiffness", "nominal_parameters"):
        returned, described = getattr(model, name), getattr(model, name).copy()
        with suppress(ValueError):  # NumPy's, of an array that is read-only
            returned += 50.0

        np.testing.assert_array_equal(getattr(model, name), described)
