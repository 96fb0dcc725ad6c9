"""Shapes of a beam without mass, and links whose mass is lumped."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Arm, Link, Mode, Model
from dynamics.formulations.linearized import damping, inertia, stiffness
from dynamics.formulations.link_constants import link_constants


def test_hierarchical_shapes_span_the_powers_with_a_diagonal_stiffness() -> None:
    """Natural frequencies do not depend on the basis of a space of shapes."""
    found = []
    for kind in ("hierarchical", "poly"):
        modes = tuple(Mode(kind=kind, index=k, direction="y") for k in range(1, 5))
        arm = Arm(links=(Link(length=0.7, rho_A=0.9, EIz=6.0, tip_mass=0.3, modes=modes),))
        found.append(Model(arm).frequencies(joints="locked"))
    K = np.array(
        link_constants(
            replace(
                arm.links[0],
                modes=tuple(Mode(kind="hierarchical", index=k, direction="y") for k in range(1, 5)),
            )
        ).K
    )

    assert_allclose(found[0], found[1], rtol=1e-9)
    assert np.count_nonzero(K) == 4
    assert_allclose(np.diag(K)[:2], [3.0 * 6.0 / 0.7**3, 4.0 * 6.0 / 0.7**3], rtol=1e-12)


def test_a_straight_lumped_link_keeps_its_inertia() -> None:
    modes = (Mode(kind="hierarchical", index=1, direction="y"),)
    link = Link(length=0.7, rho_A=0.9, rho_Ip=0.02, EIz=6.0, tip_mass=0.3, modes=modes)
    rigid = []
    for lumped in (False, True):
        c = link_constants(replace(link, lumped=lumped))
        tip = c.tip_mass * 0.7
        rigid.append([c.mass + c.tip_mass, c.first_moment[0] + tip, c.C0[2][2] + tip * 0.7])
        rigid[-1].append(c.C0[0][0] + c.tip_inertia[0][0])

    assert_allclose(rigid[0], rigid[1], rtol=1e-14)
    assert np.count_nonzero(c.s) == np.count_nonzero(c.epsilon) == 0
    assert c.tip_mass - 0.3 == pytest.approx(0.9 * 0.7 / 4.0)


@pytest.mark.parametrize("kind", ["clamped-free", "clamped-tip-mass", "poly", "hierarchical"])
@pytest.mark.parametrize("segments", [1, 3])
def test_every_natural_mode_of_a_lumped_link_has_the_damping_ratio(
    kind: str, segments: int
) -> None:
    """The eight slowest, by the roots of the damped link: fewer than six along a direction."""
    modes = tuple(
        Mode(kind=kind, index=k, direction=direction) for direction in "yz" for k in (1, 2)
    )
    link = Link(
        length=0.7, rho_A=0.9, EIz=6.0, EIy=9.0, tip_mass=0.3, tip_inertia=np.diag((0, 1e-3, 2e-3)),  # type: ignore[arg-type]
        modes=modes, segments=segments, lumped=True, damping_ratio=0.02,
    )  # fmt: skip
    model = Model(Arm(links=(link,)))
    M, K, C = (
        f(model.chain, *given)[1:, 1:]
        for f, given in ((inertia, (np.zeros(model.n),)), (stiffness, ()), (damping, ()))
    )
    zero, one = np.zeros_like(M), np.eye(len(M))
    rates = np.block([[zero, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    roots = np.linalg.eigvals(rates)
    roots = sorted(roots[roots.imag > 0.0], key=abs)[:8]
    ratios = [-root.real / abs(root) for root in roots]
    assert_allclose(ratios, 0.02, rtol=1e-9)
    assert_allclose(np.abs(roots), model.frequencies()[: len(roots)], rtol=1e-9)


@pytest.mark.parametrize("segments", [1, 2])
def test_a_damping_ratio_of_a_mode_without_mass_is_refused(segments: int) -> None:
    """Links beyond another joint give the second mode mass in the arm, but not alone."""
    modes = tuple(Mode(kind="clamped-free", index=k, direction="z") for k in (1, 2))
    given = {"length": 0.7, "rho_A": 0.9, "EIy": 6.0, "modes": modes, "segments": segments}
    with pytest.raises(ValueError, match=r"damping_ratio \(0.01\) .* along 'z' needs .*\[1\]\[1\]"):
        Link(**given, lumped=True, damping_ratio=0.01)
    assert Link(**given, lumped=True, damping_beta=0.01).lumped


@pytest.mark.parametrize(
    ("kind", "count", "sentence"),
    [("pinned-free", 1, "pinned-free modes, got True"), ("poly", 3, "may hold 2 along 'y', got 3")],
)
def test_a_lumped_link_refuses_shapes_that_its_tip_cannot_follow(
    kind: str, count: int, sentence: str
) -> None:
    modes = tuple(Mode(kind=kind, index=k, direction="y") for k in range(1, count + 1))
    with pytest.raises(ValueError, match=sentence):
        Link(length=0.7, rho_A=0.9, EIz=6.0, modes=modes, lumped=True)
