"""Frequencies that shear and rotary inertia lower: the sizes in the warning against Timoshenko."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from dynamics import ARMS, Arm, Section, ThickLinkWarning, load_arm
from dynamics.description import plausibility
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode
from dynamics.description.plausibility import SHEAR, neglected
from dynamics.model import Model
from tests.dynamics.beam_elements import beam_frequencies

BENDING = [{"kind": "clamped-free", "index": 1, "direction": "y"}]
STEEL, DENSITY = 200e9, 7850.0
COUNT = 400  # elements of a Timoshenko beam


@pytest.fixture(autouse=True)
def nothing_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plausibility, "_told", set())


def bar(length: float, height: float, **changes: Any) -> dict[str, Any]:
    """Description of a square steel bar."""
    area = height**2
    stiffness = {"EIz": STEEL * area * height**2 / 12.0, "EA": STEEL * area}
    return {"length": length, "rho_A": DENSITY * area, "modes": BENDING, **stiffness, **changes}


def timoshenko(length: float, rho_A: Any, EI: Any, EA: Any, tip: tuple[float, float]) -> Any:
    """(2,) [rad/s] of a clamped Timoshenko beam: linear elements with one point for the shear.

    rho_A, EI, EA : numbers, or one for each of the COUNT elements.
    tip : mass [kg] and inertia [kg m^2].
    """
    count = COUNT
    h, n = length / count, 2 * (count + 1)  # deflection and rotation at every node
    M, K = np.zeros((n, n)), np.zeros((n, n))
    consistent = np.array([[2.0, 1.0], [1.0, 2.0]]) * h / 6.0
    bend, shear = np.array([0.0, -1.0, 0.0, 1.0]) / h, np.array([-1.0 / h, -0.5, 1.0 / h, -0.5])
    rows = np.column_stack([x * np.ones(count) for x in (rho_A, EI, EA)])
    for k, (m, bending, normal) in enumerate(rows):
        at = slice(2 * k, 2 * k + 4)
        M[at, at] += np.kron(consistent, np.diag([m, m * bending / normal]))
        K[at, at] += h * (bending * np.outer(bend, bend) + normal / SHEAR * np.outer(shear, shear))
    M[-2, -2] += tip[0]
    M[-1, -1] += tip[1]
    squares = scipy.linalg.eigh(K[2:, 2:], M[2:, 2:], eigvals_only=True, subset_by_index=[0, 1])
    return np.sqrt(squares)


@pytest.mark.parametrize("tip", [(0.0, 0.0), (2.0, 0.004)])
@pytest.mark.parametrize("height", [0.01, 0.02])
def test_the_neglected_share_is_that_of_timoshenkos_beam(
    height: float, tip: tuple[float, float]
) -> None:
    described = bar(0.5, height, tip_mass=tip[0], tip_inertia=np.diag([0.0, 0.0, tip[1]]))
    link = Link(**{**described, "modes": ()})
    EI, EA = described["EIz"], described["EA"]

    slender = beam_frequencies(0.5, link.rho_A, EI, tip_mass=tip[0], tip_inertia=tip[1])[:2]
    thick = timoshenko(0.5, link.rho_A, EI, EA, tip)

    share = 1.0 - thick / slender
    np.testing.assert_allclose(neglected(link, "y"), share, rtol=0.5 * share.max() + 0.02)


def test_the_share_of_a_stepped_and_tapered_bar_is_that_of_timoshenkos_beam() -> None:
    inner, outer = bar(0.25, 0.03), bar(0.25, 0.02)
    names = ("rho_A", "EIz", "EA")
    sections = (
        Section(length=0.25, **{name: inner[name] for name in names}),
        Section(length=0.25, **{name: (outer[name], 0.6 * outer[name]) for name in names}),
    )
    modes = tuple(Mode(kind="clamped-free", index=k, direction="y") for k in (1, 2))
    link = Link(sections=sections, modes=modes)
    x = 0.5 * (np.arange(COUNT) + 0.5) / COUNT

    thick = timoshenko(0.5, *(link.at(name, x) for name in names), (0.0, 0.0))

    share = 1.0 - thick / Model(Arm(links=(link,))).frequencies()
    np.testing.assert_allclose(neglected(link, "y"), share, rtol=0.5 * share.max() + 0.02)
    with pytest.warns(ThickLinkWarning, match="with Link.EA"):
        load_arm(Arm(links=(link,)).to_dict())


def test_a_thick_bar_is_named_with_the_size_once() -> None:
    thick = {"links": [bar(0.5, 0.01), bar(0.3, 0.03)]}
    with pytest.warns(ThickLinkWarning) as told:
        load_arm(thick)
    assert str(told[0].message).startswith("Link 2 is thick")
    assert "along y by 0.8% and 5.1%, with Link.EA" in str(told[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ThickLinkWarning)
        load_arm(thick)


@pytest.mark.parametrize(
    "source",
    [{"links": [bar(0.5, 0.004)]}, {"links": [bar(0.3, 0.03, modes=[])]}, ARMS["srms-like"]],
    ids=["slender", "rigid", "preset"],
)
def test_slender_and_rigid_links_are_not_warned_of(source: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", ThickLinkWarning)
        load_arm(source)


def test_the_section_follows_from_the_polar_inertia_or_a_metals_speed_of_sound() -> None:
    """Of the same square steel bar."""
    by_area = neglected(Link(**{**bar(0.3, 0.03), "modes": ()}), "y")
    EI = bar(0.3, 0.03)["EIz"]
    polar = {"EIy": EI, "rho_Ip": DENSITY * 0.03**4 / 6.0}
    by_polar = neglected(Link(**{**bar(0.3, 0.03, EA=None, **polar), "modes": ()}), "y")
    by_sound = neglected(Link(**{**bar(0.3, 0.03, EA=None), "modes": ()}), "y")
    np.testing.assert_allclose(by_polar, by_area, rtol=1e-12)
    np.testing.assert_allclose(by_sound, by_area, rtol=0.02)


def test_an_arm_with_the_name_of_a_preset_and_links_of_its_own_is_warned_of() -> None:
    own = replace(
        ARMS["slim"],
        links=(Link(**{**bar(0.31, 0.04), "modes": tuple(Mode(**mode) for mode in BENDING)}),),
    )
    with pytest.warns(ThickLinkWarning):
        load_arm(own)


def test_no_frequency_falls_by_more_than_all_of_it() -> None:
    """A stiffness in N mm^2 in place of N m^2."""
    link = Link(**{**bar(0.5, 0.01, EIz=6e9, EA=None), "modes": ()})
    assert 0.99 < neglected(link, "y")[0] < 1.0
