"""Stepped and tapered links against exact beams, published tapers and chains of uniform links."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import iv, jv, kv, yv

from dynamics import Arm, Joint, Link, Mode, Section, load_arm, simulate
from dynamics.accuracy.fidelity import rigid
from dynamics.description.arm import FOURTH_ORDER
from dynamics.description.beams.sections import at
from dynamics.formulations.link_constants import chain_constants
from dynamics.model import Model, compile_arm
from dynamics.types import Array

STEPS: list[dict[str, Any]] = [
    {"length": 0.3, "rho_A": 0.24, "EIz": 24.0, "EIy": 20.0, "GJ": 18.0, "rho_Ip": 2e-5},
    {"length": 0.4, "rho_A": 0.12, "EIz": 6.0, "EIy": 8.0, "GJ": 4.5, "rho_Ip": 1e-5},
    {"length": 0.1, "rho_A": 0.20, "EIz": 9.0, "EIy": 9.0, "GJ": 6.0, "rho_Ip": 2e-5},
]
MASS, INERTIA = 0.15, 2e-3
TIP: dict[str, Any] = {"tip_mass": MASS, "tip_inertia": INERTIA * np.eye(3)}
SECTIONS = tuple(Section(**step) for step in STEPS)


def shapes(kind: str, count: int, direction: str = "y") -> tuple[Mode, ...]:
    return tuple(Mode(kind=kind, index=k, direction=direction) for k in range(1, count + 1))


def stepped(*modes: Mode, **changes: Any) -> Link:
    return Link(**{"sections": SECTIONS, "modes": modes, **changes})


def frequencies(link: Link, joints: str = "locked") -> Array:
    return Model(Arm(links=(link,))).frequencies(joints=joints)


# ---- exact beams ---------------------------------------------------------------------------------


def roots(function: Callable[[float], float], grid: Array, count: int) -> Array:
    values = [function(x) for x in grid]
    brackets = [(a, b) for a, b, u, v in zip(grid, grid[1:], values, values[1:]) if u * v < 0.0]  # noqa: B905
    return np.array([brentq(function, *bracket, rtol=1e-13) for bracket in brackets[:count]])


def exact_steps(mass: float, inertia: float, hub: float | None = None) -> Array:
    """[rad/s] of three uniform sections, by transfer matrices of (w, w', M, V).

    The root is clamped, or hinged with the inertia `hub`.
    """

    def determinant(omega: float) -> float:
        moment = 0.0 if hub is None else -(omega**2) * hub
        start = np.array([[0, 0, 1, 0], [0, 0, 0, 1]], dtype=float).T
        if hub is not None:
            start = np.array([[0, 1, moment, 0], [0, 0, 0, 1]], dtype=float).T
        for s in STEPS:
            A = np.zeros((4, 4))
            A[0, 1] = A[2, 3] = 1.0
            A[1, 2], A[3, 0] = 1.0 / s["EIz"], s["rho_A"] * omega**2
            start = expm(A * s["length"]) @ start
        w, slope, M, V = start
        return float(np.linalg.det([M - omega**2 * inertia * slope, V + omega**2 * mass * w]))

    return roots(determinant, np.geomspace(5.0, 3000.0, 300), 4)


@pytest.mark.parametrize(
    ("kind", "tip"), [("clamped-free", (0.0, 0.0)), ("clamped-tip-mass", (MASS, INERTIA))]
)
def test_natural_shapes_have_the_frequencies_of_the_exact_stepped_beam(
    kind: str, tip: tuple[float, float]
) -> None:
    link = stepped(*shapes(kind, 4), **(TIP if tip[0] else {}))
    assert_allclose(frequencies(link), exact_steps(*tip), rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "tip", "hub"),
    [("pinned-free", (0.0, 0.0), 0.0), ("unconstrained", (MASS, INERTIA), 0.02)],
)
def test_shapes_of_a_free_joint_have_the_frequencies_of_the_exact_hinged_beam(
    kind: str, tip: tuple[float, float], hub: float
) -> None:
    link = stepped(
        *shapes(kind, 4), joint=Joint(rotor_inertia=hub), **(TIP if tip[0] else {})
    )  # fmt: skip
    assert_allclose(frequencies(link, "free"), exact_steps(*tip, hub=hub), rtol=1e-9)


@pytest.mark.parametrize(("kind", "digits"), [("hierarchical", 1e-5), ("poly", 1e-4)])
@pytest.mark.parametrize("segments", [1, 2])
def test_polynomial_moments_approach_them_from_above(
    kind: str, digits: float, segments: int
) -> None:
    link = stepped(*shapes(kind, 6), segments=segments, **TIP)
    error = frequencies(link)[:2] / exact_steps(MASS, INERTIA)[:2] - 1.0
    assert (error > -1e-10).all()
    assert (error < digits).all()


def exact_taper(n: int, c: float, count: int) -> Array:
    """Omega l^2 sqrt(rho_A / EI) at the root, of a beam with rho_A ~ x^n and EI ~ x^(n + 2).

    x is the distance from the vertex over that of the root, c that of the tip: Kirchhoff (1879).
    Deflections are x^(-n/2) times Bessel functions of 2 b sqrt(x), with omega = b^2.
    """

    def columns(x: float, b: float) -> Array:
        z, result = 2.0 * b * np.sqrt(x), []
        for bessel, down, up in ((jv, -1, 1), (yv, -1, 1), (iv, 1, 1), (kv, -1, -1)):
            slope = down * b * bessel(n + 1, z)
            moment, shear = b**2 * bessel(n + 2, z), up * b**3 * bessel(n + 1, z)
            result.append((bessel(n, z), slope / np.sqrt(x), moment, shear / np.sqrt(x)))
        return np.array(result).T

    def determinant(b: float) -> float:
        rows = np.array([*columns(c, b)[2:], *columns(1.0, b)[:2]])
        rows = rows / np.abs(rows).max(axis=0)
        return float(np.linalg.det(rows / np.abs(rows).max(axis=1)[:, None]))

    found: Array = roots(determinant, np.linspace(0.5, 12.0, 800), count) ** 2 * (1.0 - c) ** 2
    return found


@pytest.mark.parametrize(("n", "published"), [(1, (5.315, 15.207)), (2, (8.719, 21.146))])
def test_the_exact_wedge_and_cone_are_the_published_ones(
    n: int, published: tuple[float, ...]
) -> None:
    """Kirchhoff's wedge and cone, here cut a thousandth before their points."""
    found = exact_taper(n, 1e-3, 2) / (1.0 - 1e-3) ** 2
    assert_allclose(found, published, rtol=1e-4)


def taper(n: int, c: float, count: int) -> tuple[Section, ...]:
    """Sections between stations that lie on a wedge (n = 1) or a cone (n = 2)."""
    x = np.geomspace(1.0, c, count + 1)
    return tuple(
        Section(length=a - b, rho_A=(a**n, b**n), EIz=(a ** (n + 2), b ** (n + 2)))
        for a, b in zip(x[:-1].tolist(), x[1:].tolist(), strict=True)
    )


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("c", [0.1, 0.5])
def test_linear_sections_converge_to_the_wedge_and_the_cone(n: int, c: float) -> None:
    """A quantity linear between stations is off by the square of their distance."""
    exact = exact_taper(n, c, 2) / (1.0 - c) ** 2
    errors = np.array([
        frequencies(Link(sections=taper(n, c, count), modes=shapes("clamped-free", 2))) / exact - 1
        for count in (10, 20)
    ])  # fmt: skip
    assert_allclose(errors[0] / errors[1], 4.0, rtol=0.03)
    assert_allclose((4.0 * errors[1] - errors[0]) / 3.0, 0.0, atol=0.01 * errors[0].max())


# ---- statics -------------------------------------------------------------------------------------


@pytest.mark.parametrize("segments", [1, 2, 3])
@pytest.mark.parametrize("kind", ["hierarchical", "poly"])
def test_a_tip_force_bends_a_link_by_the_integral_of_its_moment(kind: str, segments: int) -> None:
    """int (l - x)^2 / EI over steps and a linear section, by trapezoids."""
    sections = (*SECTIONS[:2], replace(SECTIONS[2], EIz=(9.0, 3.0)))
    x = np.concatenate([np.linspace(a, b, 20001) for a, b in ((0, 0.3), (0.3, 0.7), (0.7, 0.8))])
    EI = at(sections, "EIz", x)
    for step in (20000, 40001):  # the inner side of a step
        EI[step] = sections[step // 20000 - 1].ends("EIz")[1]
    compliance = np.trapezoid((0.8 - x) ** 2 / EI, x)

    model = Model(Arm(links=(stepped(*shapes(kind, 2), sections=sections, segments=segments),)))
    chain, q = model.chain.links, np.zeros(model.n)
    lever = [(k.tip_phi, k.tip_theta, 0.8 * (1 - (i + 1) / segments)) for i, k in enumerate(chain)]
    load = [p[1] + t[2] * arm for phi, theta, arm in lever for p, t in zip(phi, theta, strict=True)]
    q[1:] = np.linalg.solve(model.stiffness[1:, 1:], load)

    assert q[1:] @ load == pytest.approx(compliance, rel=1e-8)
    for at_x in (0.0, 0.15, 0.3, 0.5, 0.79):  # a gauge times the rigidity reads the moment
        moment = model.strain(q, 0, at_x)[2] * float(at(sections, "EIz", at_x))
        assert moment == pytest.approx(0.8 - at_x, rel=1e-8)
    (link,) = model.arm.links
    assert link.tip_rigidity("y") == pytest.approx(0.8**3 / 3.0 / compliance, rel=1e-8)
    curvature = model.strain(q, 0, 0.0)[2] * 0.8**2 / compliance
    assert link.root_curvature("y") == pytest.approx(curvature, rel=1e-8)


@pytest.mark.parametrize("segments", [1, 10])
def test_a_curvature_on_a_step_is_that_of_the_outer_section(segments: int) -> None:
    """Also where round-off puts the step, or the weld of two segments, behind the gauge."""
    steps = zip((0.1, 0.2, 0.7), (24.0, 6.0, 9.0), strict=True)
    sections = tuple(Section(length=x, rho_A=0.1, EIz=EI) for x, EI in steps)
    link = stepped(*shapes("hierarchical", 2), sections=sections, segments=segments)
    model = Model(Arm(links=(link,)))
    q = np.linspace(0.0, 0.01, model.n)
    for x in (0.1, 0.3):
        inner, on, outer = (model.strain(q, 0, x + aside)[2] for aside in (-1e-8, 0.0, 1e-8))
        assert on == pytest.approx(outer, rel=1e-5)
        assert on != pytest.approx(inner, rel=0.3)


def test_the_straight_link_has_the_mass_and_inertia_of_its_sections() -> None:
    """As a rigid link, with modes and lumped, and as three welded links."""
    link = stepped(joint=Joint(rotor_inertia=0.0))
    parts = tuple(
        Link(**{**step, "modes": ()}, joint=Joint(type="fixed" if k else "revolute"))
        for k, step in enumerate(STEPS)
    )
    wanted = Model(Arm(links=parts)).mass_matrix(np.zeros(1))[0, 0]
    for lumped in (False, True):
        bent = stepped(*shapes("hierarchical", 1), lumped=lumped)
        assert Model(Arm(links=(bent,))).mass_matrix(np.zeros(2))[0, 0] == pytest.approx(wanted)
    rigid_arm = Arm(links=(link,), gravity=(0.0, -9.81, 0.0))
    assert Model(rigid_arm).mass_matrix(np.zeros(1))[0, 0] == pytest.approx(wanted)
    assert rigid(rigid_arm).arm(rigid_arm).links[0].sections == SECTIONS


# ---- a chain of uniform links --------------------------------------------------------------------


def chain(count: int, **arm: Any) -> Arm:
    """Every section as `count` uniform links welded in line, with polynomials in each."""
    modes = [vars(mode) for d in "yz" for mode in shapes("hierarchical", 2, d)]
    modes += [vars(mode) for mode in shapes("torsion-poly", 2, "x")]
    links = [
        {**step, "length": step["length"] / count, "modes": modes, "joint": {"type": "fixed"}}
        for step in STEPS for _ in range(count)
    ]  # fmt: skip
    links[0]["joint"] = {"rotor_inertia": 0.02}
    links[-1].update(TIP)
    return load_arm({"links": links, **arm})


def sectioned(**arm: Any) -> Arm:
    """One link with natural shapes."""
    modes = (*shapes("clamped-tip-mass", 5), *shapes("clamped-tip-mass", 5, "z"))
    link = stepped(*modes, *shapes("torsion-poly", 2, "x"), **TIP)
    return Arm(links=(replace(link, joint=Joint(rotor_inertia=0.02)),), **arm)


@pytest.mark.filterwarnings("ignore::dynamics.ThickLinkWarning")
@pytest.mark.parametrize("joints", ["locked", "free"])
def test_a_link_of_sections_is_the_chain_of_its_welded_parts(joints: str) -> None:
    """Bending in both planes, and torsion under the inertia of the tip."""
    found, wanted = (Model(arm).frequencies(joints=joints) for arm in (sectioned(), chain(4)))
    assert_allclose(found[:5], wanted[:5], rtol=2e-5)


@pytest.mark.compiles
@pytest.mark.filterwarnings("ignore::dynamics.ThickLinkWarning")
def test_a_stepped_arm_moves_as_the_chain_of_its_welded_parts() -> None:
    """A pulse under gravity: the tips stay together, and far from a mean uniform link's."""
    settings: dict[str, Any] = {"gravity": (0.0, -9.81, 0.0), "foreshortening": FOURTH_ORDER}
    planar = stepped(*shapes("clamped-tip-mass", 4), **TIP, joint=Joint(rotor_inertia=0.02))
    links = [
        replace(link, modes=tuple(m for m in link.modes if m.direction == "y"))
        for link in chain(2).links
    ]
    mean = {name: planar.mean(name) for name in ("rho_A", "EIz")}
    uniform = replace(planar, sections=(), **mean)
    tips = []
    for arm in ((planar,), tuple(links), (uniform,)):
        model = compile_arm(Arm(links=arm, **settings))
        rest, times = np.zeros(model.n), np.linspace(0.0, 0.4, 21)

        def torque(t: float, *_: Any) -> Array:
            return np.array([3.0 if t < 0.1 else 1.0])

        path = simulate(model, rest, rest, torque, times, integrator="dop853", rtol=1e-7)
        tips.append(path.tip)
    apart = [np.linalg.norm(tip - tips[1], axis=1).max() for tip in tips]
    moved = np.linalg.norm(tips[1] - tips[1][0], axis=1).max()
    assert moved > 0.1
    assert apart[0] < 2e-3 * moved
    assert apart[2] > 10.0 * apart[0]


# ---- parameters ----------------------------------------------------------------------------------


def test_a_free_stiffness_scales_every_section() -> None:
    modes = (*shapes("clamped-tip-mass", 2), *shapes("torsion-fixed-free", 1, "x"))
    link = stepped(*modes, **TIP)
    harder = tuple(
        Section(**{**step, **{k: 1.3 * step[k] for k in ("EIz", "EIy", "GJ")}}) for step in STEPS
    )
    q, v, tau = np.array([0.2, 0.01, -0.02, 0.05]), np.array([1.0, 0.2, 0.1, 0.3]), np.array([0.4])
    free = Model(Arm(links=(link,)), ("stiffness",)).graph(q, v, tau, 1.3, [])
    wanted = Model(Arm(links=(replace(link, sections=harder),))).graph(q, v, tau, [], [])
    assert_allclose(np.array(free), np.array(wanted), rtol=1e-9)


@pytest.mark.parametrize(("kind", "segments"), [("clamped-tip-mass", 1), ("hierarchical", 2)])
def test_a_damping_ratio_is_that_of_the_natural_modes(kind: str, segments: int) -> None:
    held = {"joint": Joint(type="fixed"), "damping_ratio": 0.02, "segments": segments}
    model = Model(Arm(links=(stepped(*shapes(kind, 4), tip_mass=MASS, **held),)))
    rest = np.zeros(model.n)
    poles = np.linalg.eigvals(model.linearize(rest, rest, np.zeros(0))[0])
    slowest = poles[np.argsort(np.abs(poles))][:4]
    assert_allclose(-slowest.real / np.abs(slowest), 0.02, rtol=1e-6)


@pytest.mark.parametrize(("kind", "direction"), [("clamped-free", "y"), ("torsion-poly", "x")])
def test_the_norm_mass_gives_a_stepped_shape_a_modal_mass_of_one(kind: str, direction: str) -> None:
    shape = Mode(kind=kind, index=1, direction=direction, norm="mass")
    mass = Model(Arm(links=(stepped(shape),))).mass_matrix(np.zeros(2))
    assert mass[1, 1] == pytest.approx(1.0, rel=1e-9)


def test_the_inner_lump_of_a_stepped_link_is_a_point() -> None:
    """All mass that is not at the tip has the inertia of a point, as at Radau's."""
    link = stepped(*shapes("hierarchical", 1), lumped=True)
    (lump,) = chain_constants(Arm(links=(link,)))[0]
    assert lump.first_moment[0] ** 2 == pytest.approx(lump.mass * lump.C0[2][2], rel=1e-12)
    assert 0.0 < lump.first_moment[0] / lump.mass < link.length
