import json
from itertools import combinations
from math import cos, cosh, inf, pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from dynamics import ARMS, Arm, Joint, Link, Mode, Payload, load_arm
from dynamics.description.deflection import curvature, deflection
from dynamics.description.mode_shapes import KINDS, clamped_root, quadrature, shape
from dynamics.formulations.link_constants import link_constants
from dynamics.model import Model
from tests.paths import REFERENCE

CASES = sorted(
    path.stem
    for path in REFERENCE.glob("*.json")
    if "links" in json.loads(path.read_text()).get("expected", {})
)
BENDING = [kind for kind, directions in KINDS.items() if "y" in directions]
ALL_MODES = [
    Mode(kind=kind, index=index, direction=direction)
    for kind, directions in KINDS.items()
    for direction in directions
    for index in (1, 2, 5, 12)
]


def a_link(*modes: Mode, **changes: object) -> Link:
    values = {
        "length": 0.7,
        "rho_A": 0.9,
        "EIz": 12.0,
        "EIy": 31.0,
        "GJ": 8.0,
        "EA": 500.0,
        "rho_Ip": 0.02,
        "tip_mass": 0.4,
        "tip_inertia": ((0.01, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.03)),
    }
    return Link(**{**values, "modes": modes, **changes})


def modes(kind: str, count: int, direction: str = "y", norm: str = "tip-unit") -> tuple[Mode, ...]:
    return tuple(
        Mode(kind=kind, index=index, direction=direction, norm=norm)
        for index in range(1, count + 1)
    )


@pytest.mark.parametrize("case", CASES)
def test_links_agree_with_the_independent_method(case: str) -> None:
    data = json.loads((REFERENCE / f"{case}.json").read_text())
    arm = load_arm(data)

    for link, expected in zip(arm.links, data["expected"]["links"], strict=True):
        constants = link_constants(link)
        shapes = [shape(mode, link.beam) for mode in link.modes]
        K, M = np.array(expected["K"]), np.array(expected["M_clamped_link_only"])
        stiff = np.sqrt(np.outer(np.diag(K), np.diag(K)))
        heavy = np.sqrt(np.outer(np.diag(M), np.diag(M)))

        assert_allclose([s.value(link.length) for s in shapes], expected["phi_tip"], rtol=1e-11)
        assert_allclose(
            [s.slope(link.length) for s in shapes], expected["slope_tip"], rtol=1e-11, atol=1e-14
        )
        assert_allclose([s.beta for s in shapes], expected["beta_l"], rtol=1e-11)
        assert np.all(np.abs(np.array(constants.K) - K) <= 1e-11 * stiff)
        assert np.all(np.abs(np.array(constants.s) - M) <= 1e-11 * heavy)


@pytest.mark.parametrize("mode", ALL_MODES, ids=str)
def test_shapes_meet_their_conditions_at_both_ends(mode: Mode) -> None:
    link = a_link(mode)
    s, l = shape(mode, link.beam), link.length
    steep = max(1.0, abs(float(s.slope(l)) * l))
    bent = max(1.0, abs(float(s.curvature(0.0)) * l**2), abs(float(s.curvature(l)) * l**2))

    at_rest = mode.kind == "hierarchical" and mode.index > 1
    assert float(s.value(l)) == pytest.approx(0.0 if at_rest else 1.0, abs=1e-14)
    if mode.kind == "hierarchical":
        assert float(s.slope(l)) * l == pytest.approx(
            {1: 1.5, 2: 1.0}.get(mode.index, 0.0), abs=1e-13
        )
    assert abs(float(s.value(0.0))) <= 1e-14 * steep
    if mode.kind in ("clamped-free", "clamped-tip-mass", "unconstrained", "poly", "hierarchical"):
        assert abs(float(s.slope(0.0))) * l <= 1e-13 * steep
    if mode.kind in ("clamped-free", "pinned-free"):
        assert abs(float(s.curvature(l))) * l**2 <= 1e-12 * bent
    if mode.kind == "pinned-free":
        assert abs(float(s.curvature(0.0))) * l**2 <= 1e-12 * bent
        assert abs(float(s.slope(0.0))) > 1.0
    if mode.kind in ("torsion-fixed-free", "axial-fixed-free"):
        assert abs(float(s.slope(l))) <= 1e-13 * pi * mode.index / l


@pytest.mark.parametrize("hub", [0.0, 1e-3, 0.05, 5.0])
@pytest.mark.parametrize("body", [(0.0, 0.0), (0.3, 0.0), (0.1, 2e-3), (40.0, 0.5)])
def test_unconstrained_shapes_are_natural_modes_on_a_free_joint(
    hub: float, body: tuple[float, float]
) -> None:
    """Frequencies of three of them beside the roots of the exact frequency equation."""
    (m, J), l, rho_A, EI = body, 1.3, 0.4, 7.0
    tip = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, J))
    link = Link(length=l, rho_A=rho_A, EIz=EI, tip_mass=m, tip_inertia=tip,
                joint=Joint(rotor_inertia=0.25 * hub, hub_inertia=0.75 * hub),
                modes=modes("unconstrained", 3))  # fmt: skip
    found = Model(Arm(links=(link,))).frequencies(np.zeros(4), joints="free")[-3:]

    def equation(omega: float) -> float:
        """Determinant of the conditions on e^(k(x-l)), e^(-kx), cos kx, sin kx."""
        k = (rho_A * omega**2 / EI) ** 0.25
        e, c, s = np.exp(-k * l), np.cos(k * l), np.sin(k * l)
        at_0 = [(e, e, e), (1.0, -1.0, 1.0), (1.0, 0.0, -1.0), (0.0, 1.0, 0.0)]
        at_l = [(1.0, 1.0, 1.0, 1.0), (e, -e, e, -e), (c, -s, -c, s), (s, c, -s, -c)]
        rows = [
            [w for w, _, _ in at_0],
            [EI * k**2 * bent + hub * omega**2 * k * slope for _, slope, bent in at_0],
            [EI * k**2 * bent - J * omega**2 * k * slope for _, slope, bent, _ in at_l],
            [EI * k**3 * third + m * omega**2 * w for w, _, _, third in at_l],
        ]
        size = [max(map(abs, row)) for row in rows]
        return float(np.linalg.det(np.array(rows) / np.array(size)[:, None]))

    for omega in found:
        root = brentq(equation, omega * (1.0 - 1e-5), omega * (1.0 + 1e-5), xtol=1e-12)
        assert omega == pytest.approx(root, rel=1e-8)


@pytest.mark.parametrize("mode", ALL_MODES, ids=str)
def test_slope_and_curvature_are_the_derivatives(mode: Mode) -> None:
    """The integral of the derivative along the link is the difference of the end values."""
    link = a_link(mode)
    s = shape(mode, link.beam)
    x, weights = quadrature(link.length, (mode,))

    grown = float(s.value(link.length)) - float(s.value(0.0))
    turned = float(s.slope(link.length)) - float(s.slope(0.0))
    assert weights @ s.slope(x) == pytest.approx(grown, rel=1e-12)
    if mode.direction in ("y", "z"):
        largest = float(np.abs(s.slope(x)).max())
        assert weights @ s.curvature(x) == pytest.approx(turned, abs=1e-12 * largest)


def test_clamped_free_shapes_have_their_textbook_integrals_at_any_index() -> None:
    """int s_j s_k = l/4 and int s_j'' s_k'' = beta^4/(4 l^3) for equal j, k, else zero."""
    link = a_link(*modes("clamped-free", 20), tip_mass=0.0)
    constants = link_constants(link)
    beta = np.array([clamped_root(index, 0.0, 0.0) for index in range(1, 21)])

    assert_allclose([cos(b) * cosh(b) for b in beta[:5]], -1.0, rtol=1e-8)
    assert_allclose(beta[5:], (np.arange(6, 21) - 0.5) * pi, rtol=1e-8)
    mass = link.rho_A * link.length
    assert_allclose(np.diag(constants.s), mass / 4.0, rtol=1e-12)
    assert_allclose(np.diag(constants.K), link.EIz * beta**4 / (4.0 * link.length**3), rtol=1e-12)
    for table in (constants.s, constants.K):
        assert np.count_nonzero(table) == 20  # orthogonal pairs are exact zeros


@pytest.mark.parametrize("direction", ["y", "z"])
def test_clamped_tip_mass_shapes_are_orthogonal_with_the_tip_body(direction: str) -> None:
    link = a_link(*modes("clamped-tip-mass", 12, direction))
    constants = link_constants(link)
    body = np.array(constants.tip_inertia)
    phi, theta = np.array(constants.tip_phi), np.array(constants.tip_theta)

    M = np.array(constants.s) + link.tip_mass * phi @ phi.T + theta @ body @ theta.T
    K = np.array(constants.K)

    scale = np.sqrt(np.diag(M))
    assert_allclose(M / np.outer(scale, scale), np.eye(12), atol=1e-12)
    rigidity = {"y": link.EIz, "z": link.EIy}[direction]
    beta = np.array([shape(mode, link.beam).beta for mode in link.modes])
    expected = rigidity * beta**4 / (link.rho_A * link.length**4)
    assert_allclose(np.diag(K) / np.diag(M), expected, rtol=1e-11)


def test_a_massless_tip_makes_the_clamped_free_beam() -> None:
    zeros = ((0.0, 0.0, 0.0),) * 3
    light = a_link(*modes("clamped-tip-mass", 5), tip_mass=0.0, tip_inertia=zeros)
    free = a_link(*modes("clamped-free", 5), tip_mass=0.0, tip_inertia=zeros)
    assert_allclose(link_constants(light).K, link_constants(free).K, rtol=1e-13)


@settings(max_examples=60, deadline=None)
@given(
    mass=st.one_of(st.just(0.0), st.floats(1e-9, 1e6)),
    inertia=st.one_of(st.just(0.0), st.floats(1e-9, 1e6)),
)
def test_clamped_roots_miss_none(mass: float, inertia: float) -> None:
    """Roots of a beam with a tip body interlace with those of the beam with a fixed tip slope."""
    roots = [clamped_root(index, mass, inertia) for index in range(1, 9)]
    lighter = [clamped_root(index, mass, 0.0) for index in range(1, 9)]
    held = [clamped_root(index, mass, inf) for index in range(1, 9)]
    slack = 1.0 + 1e-9
    for k in range(8):
        assert roots[k] <= lighter[k] * slack
        assert roots[k] <= held[k] * slack
        if k:
            assert roots[k] > roots[k - 1]
            assert roots[k] * slack >= held[k - 1]


def test_pinned_free_shapes_carry_no_angular_momentum_about_the_joint() -> None:
    """Free-free about a pin: orthogonal to the rigid rotation, so c_j is an exact zero."""
    constants = link_constants(a_link(*modes("pinned-free", 4), rho_Ip=0.0))
    assert np.count_nonzero(constants.c) == 0
    assert np.count_nonzero(constants.C) == 0
    assert np.all(np.abs(constants.root_slope) > 0.0)


@pytest.mark.parametrize("kind", BENDING)
def test_mass_norm_makes_the_modal_mass_one(kind: str) -> None:
    link = a_link(*modes(kind, 3, norm="mass"))
    constants = link_constants(link)
    M = np.array(constants.s)
    if kind == "clamped-tip-mass":
        theta, phi = np.array(constants.tip_theta), np.array(constants.tip_phi)
        M = M + link.tip_mass * phi @ phi.T + theta @ np.array(link.tip_inertia) @ theta.T
    assert_allclose(np.diag(M), 1.0, rtol=1e-12)


def test_norms_differ_by_the_tip_value_only() -> None:
    unit, raw = (a_link(*modes("clamped-free", 3, norm=norm)) for norm in ("tip-unit", "raw"))
    tip = np.array(link_constants(raw).tip_phi)[:, 1]
    assert_allclose(tip, (2.0, -2.0, 2.0), rtol=1e-13)  # cosh - cos - sigma (sinh - sin)
    K = np.array(link_constants(unit).K) * np.outer(tip, tip)
    assert_allclose(link_constants(raw).K, K, rtol=1e-12)


def test_integrals_are_those_of_the_definitions() -> None:
    """Every vector and matrix integral against a plain sum over points of the link."""
    chosen = (
        Mode(kind="pinned-free", index=1, direction="y"),
        Mode(kind="poly", index=1, direction="y"),
        Mode(kind="clamped-free", index=2, direction="z"),
        Mode(kind="poly", index=2, direction="z", norm="mass"),
        Mode(kind="torsion-poly", index=1, direction="x"),
    )
    link = a_link(*chosen, rho_Ip=0.0)
    k = link_constants(link)
    x, weights = quadrature(link.length, chosen)
    r = np.zeros((5, x.size, 3))
    for j in range(5):
        r[j] = deflection(link, np.eye(5)[j], x)
    eta = np.stack([x, 0 * x, 0 * x], axis=1)
    mu = link.rho_A * weights

    def skew(a: np.ndarray) -> np.ndarray:
        return np.cross(a[:, None, :], np.eye(3)[None]).transpose(0, 2, 1)  # (points, 3, 3)

    def total(values: np.ndarray) -> np.ndarray:
        return np.tensordot(mu, values, axes=1)

    def crossed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return total(skew(a).transpose(0, 2, 1) @ skew(b))

    close = {"rtol": 1e-12, "atol": 1e-14}
    assert_allclose(k.first_moment, total(eta), **close)
    assert_allclose(k.C0, crossed(eta, eta), **close)
    for i in range(5):
        assert_allclose(k.epsilon[i], total(r[i]), **close)
        assert_allclose(k.c[i], total(np.cross(eta, r[i])), **close)
        assert_allclose(k.C[i], crossed(eta, r[i]), **close)
        for j in range(5):
            assert_allclose(k.s[i][j], total((r[i] * r[j]).sum(axis=1)), **close)
            assert_allclose(k.c_jk[i][j], total(np.cross(r[i], r[j])), **close)
            assert_allclose(k.D[i][j], crossed(r[i], r[j]), **close)


@settings(max_examples=40, deadline=None)
@given(rates=st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6))
def test_hub_and_rotary_inertia_are_the_energy_of_their_rates(rates: list[float]) -> None:
    """T = 1/2 int rho_Ip (w_x + sum d_j s_j)^2 + 1/2 J_hub (w_z + sum d_j theta_zj(0))^2."""
    chosen = (
        Mode(kind="pinned-free", index=1, direction="y"),
        Mode(kind="torsion-fixed-free", index=1, direction="x"),
        Mode(kind="torsion-poly", index=2, direction="x"),
    )
    bare = a_link(*chosen, rho_Ip=1e-30, joint=Joint())
    link = a_link(*chosen, rho_Ip=0.05, joint=Joint(hub_inertia=0.3))
    w, d = np.array(rates[:3]), np.array(rates[3:])

    def energy(k: object) -> float:
        return float(0.5 * w @ k.C0 @ w + d @ np.array(k.c) @ w + 0.5 * d @ np.array(k.s) @ d)

    x, weights = quadrature(link.length, chosen)
    spin = w[0] + d[1] * shape(chosen[1], link).value(x) + d[2] * shape(chosen[2], link).value(x)
    turn = w[2] + d[0] * float(shape(chosen[0], link).slope(0.0))
    expected = 0.5 * 0.05 * weights @ spin**2 + 0.5 * 0.3 * turn**2

    added = energy(link_constants(link)) - energy(link_constants(bare))
    assert added == pytest.approx(expected, rel=1e-9, abs=1e-10)


def test_a_rotor_that_modes_turn_resists_like_a_gyroscope() -> None:
    """The moment 2 C_j w d_j of a rotor is w x (I t_j d_j e), the rate of its turning momentum."""
    chosen = (
        Mode(kind="pinned-free", index=1, direction="y"),
        Mode(kind="torsion-poly", index=1, direction="x"),
    )
    bare = link_constants(a_link(*chosen, rho_Ip=0.0))
    k = link_constants(a_link(*chosen, rho_Ip=0.05, joint=Joint(hub_inertia=0.3)))
    momenta = ((0.0, 0.0, 0.3 * k.root_slope[0]), (0.05 * 0.7 / 2.0, 0.0, 0.0))  # int x/l = l/2
    w = np.array((0.3, -1.1, 0.7))
    for j, momentum in enumerate(momenta):
        added = np.array(k.C[j]) - np.array(bare.C[j])
        assert_allclose(2.0 * added @ w, np.cross(w, momentum), atol=1e-14)


@pytest.mark.parametrize("kind", ["clamped-free", "clamped-tip-mass"])
def test_damping_is_the_ratio_of_each_clamped_mode(kind: str) -> None:
    """c_j = 2 zeta sqrt(K_jj m_jj) with the tip mass, or the inertia that torsion turns.

    Shapes that a tip's rotary inertia has bent move it too.
    """
    chosen = (*modes(kind, 2), Mode(kind="torsion-poly", index=1, direction="x"))
    link = a_link(*chosen, damping_ratio=0.03)
    k = link_constants(link)
    rotary = 0.03 * (kind == "clamped-tip-mass")
    turned = [rotary * shape(mode, link.beam).slope(0.7) ** 2 for mode in chosen[:2]]
    m = np.diag(k.s) + np.array((0.4 + turned[0], 0.4 + turned[1], link.tip_inertia[0][0]))
    assert_allclose(np.diag(k.damping), 0.06 * np.sqrt(np.diag(k.K) * m), rtol=1e-14)
    assert np.count_nonzero(k.damping) == 3

    beta = link_constants(a_link(*chosen, damping_beta=0.002))
    assert_allclose(beta.damping, 0.002 * np.array(beta.K), rtol=1e-14)
    torsion = link_constants(a_link(*chosen, damping_beta=0.002, damping_beta_torsion=0.0))
    assert_allclose(torsion.damping, np.diag((1, 1, 0)) @ beta.damping, rtol=1e-14)


def test_stiffness_between_directions_is_an_exact_zero() -> None:
    link = a_link(*modes("poly", 2, "y"), *modes("poly", 2, "z"), *modes("torsion-poly", 2, "x"))
    K = np.array(link_constants(link).K)
    assert_allclose(K, K.T, rtol=1e-14)
    assert K[0, 1] > 0.0
    for i, j in combinations(range(6), 2):
        if link.modes[i].direction != link.modes[j].direction:
            assert K[i, j] == 0.0


def test_a_tip_load_bends_the_polynomial_shapes_as_a_cantilever() -> None:
    """(x/l)^2 and (x/l)^3 represent the static deflection F l^3 / (3 EI) exactly."""
    link = a_link(*modes("poly", 2))
    delta = np.linalg.solve(np.array(link_constants(link).K), np.array((5.0, 5.0)))
    l = link.length
    tip = deflection(link, delta, np.array([l]))[0]
    assert_allclose(tip, (0.0, 5.0 * l**3 / (3.0 * 12.0), 0.0), rtol=1e-12)
    assert delta @ curvature(link, 0.0) == pytest.approx((0.0, 0.0, 5.0 * l / 12.0), rel=1e-12)


def test_bending_along_z_turns_the_tip_against_y() -> None:
    link = a_link(*modes("poly", 1, "z"))
    constants = link_constants(link)
    assert constants.tip_phi == ((0.0, 0.0, 1.0),)
    assert constants.tip_theta == ((0.0, pytest.approx(-2.0 / 0.7), 0.0),)
    assert_allclose(curvature(link, 0.3), [[0.0, -2.0 / 0.7**2, 0.0]], rtol=1e-14)


def test_the_payload_joins_the_tip_body_but_not_the_shapes() -> None:
    link = a_link(*modes("clamped-tip-mass", 2))
    inertia = ((0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.3))
    bare, loaded = link_constants(link), link_constants(link, Payload(mass=2.0, inertia=inertia))
    assert loaded.tip_mass == pytest.approx(2.4)
    assert_allclose(np.diag(loaded.tip_inertia), (0.11, 0.22, 0.33), rtol=1e-14)
    assert (loaded.K, loaded.s, loaded.damping) == (bare.K, bare.s, bare.damping)


def test_a_right_angle_written_with_round_off_becomes_exact() -> None:
    c = cos(pi / 2)  # 6e-17
    link = a_link(joint=Joint(rotation=((1.0, 0.0, 0.0), (0.0, c, -1.0), (0.0, 1.0 - 1e-16, c))))
    exact = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    assert link_constants(link).rotation == exact


def test_a_rigid_link_has_no_modal_constants() -> None:
    constants = link_constants(a_link(rho_Ip=0.0))
    assert (constants.epsilon, constants.s, constants.K, constants.tip_phi) == ((), (), (), ())
    assert constants.mass == pytest.approx(0.63)
    assert curvature(a_link(), 0.0).shape == (0, 3)


def test_the_deluca_siciliano_links_have_the_published_clamped_frequencies() -> None:
    """0.48, 1.80 Hz with all beyond the elbow, 2.18, 15.91 Hz: IEEE Trans. SMC 21(4), 1991."""
    first, second = ARMS["deluca-siciliano"].links
    body = first.tip_mass + 0.1 + 0.1  # elbow, second link, payload
    about = 0.1 + 0.1 * 0.5**2 / 3.0 + 0.1 * 0.5**2 + 5e-4  # hub, second link, payload
    loaded = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, about))
    for link, published in (
        (Link(**{**vars(first), "tip_mass": body, "tip_inertia": loaded}), (0.4797, 1.7966)),
        (second, (2.1783, 15.9145)),
    ):
        modes = [Mode(kind="clamped-tip-mass", index=k, direction="y") for k in (1, 2)]
        beta = np.array([shape(mode, link.beam).beta for mode in modes])
        frequency = beta**2 / (2.0 * pi) * np.sqrt(link.EIz / (link.rho_A * link.length**4))
        assert_allclose(frequency, published, atol=1e-4)
