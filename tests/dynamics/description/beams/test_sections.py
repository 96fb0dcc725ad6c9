"""Links of sections: what is refused, what a file keeps, and one uniform link cut into sections."""

import json
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import Arm, Joint, Link, Mode, Section, load_arm
from dynamics.description.arm import FOURTH_ORDER
from dynamics.description.beams.sections import at, cut, edges, mean, rate
from dynamics.description.mode_shapes import KINDS
from dynamics.formulations.link_constants import LinkConstants, chain_constants

INNER: dict[str, Any] = {"length": 0.3, "rho_A": 0.24, "EIz": 24.0}
OUTER: dict[str, Any] = {"length": 0.5, "rho_A": 0.12, "EIz": [6.0, 3.0]}
NUMBERS: dict[str, Any] = {
    "rho_A": 0.3, "EIz": 5.0, "EIy": 7.0, "GJ": 4.0, "EA": 1e4, "rho_Ip": 1e-4,
}  # fmt: skip
CARRIED: dict[str, Any] = {
    "tip_mass": 0.2, "tip_inertia": np.diag([1e-3, 2e-3, 3e-3]), "joint": Joint(rotor_inertia=0.01),
}  # fmt: skip
RAW = [{"kind": "poly", "index": 1, "direction": "y", "norm": "raw"}]
ACROSS = [{"kind": "poly", "index": 1, "direction": "z"}]
REFUSED = {
    r"links\[0\]: Link.rho_A \(0.12\) and Link.sections exclude each other; give rho_A in every": {
        "rho_A": 0.12
    },
    r"Link.EIz \(6.0\) and Link.sections exclude": {"EIz": 6.0},
    r"Link.length \(0.9\) must be the sum of the lengths of Link.sections \(0.8\)": {"length": 0.9},
    r"sections\[1\].EIz is missing, but Link.sections\[0\] has it": {
        "sections": [INNER, {"length": 0.5, "rho_A": 0.12}]
    },
    r"links\[0\].sections\[0\]: Section.EIz must be positive, got 0.0": {
        "sections": [{**INNER, "EIz": 0.0}]
    },
    r"Section.EIz must have 2 numbers, got 3": {"sections": [{**INNER, "EIz": [3.0, 2.0, 1.0]}]},
    r"Section.EIz must change by a factor of at most 16 .* got \[24.0, 1.0\]; divide the section": {
        "sections": [{**INNER, "EIz": [24.0, 1.0]}]
    },
    r"Section.length must be positive, got -0.3": {"sections": [{**INNER, "length": -0.3}]},
    r"sections\[0\]: Section.rho_A is missing": {"sections": [{"length": 0.3}]},
    r"Unknown key 'EI' in links\[0\].sections\[0\]; nearest known: 'EIz'": {
        "sections": [{**INNER, "EI": 1.0}]
    },
    r"sections must have at most 60 entries, got 61": {"sections": 61 * [INNER]},
    r"sections must be a list, got 3": {"sections": 3},
    r'Mode.norm "raw" needs a uniform link': {"modes": RAW},
    r"Link.EIy must be positive for the mode along 'z' .* in every section": {"modes": ACROSS},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_bad_sections_are_refused_with_a_sentence_that_says_where(sentence: str) -> None:
    link: dict[str, Any] = {"sections": [INNER, OUTER], "modes": "auto"}
    with pytest.raises(ValueError, match=sentence):
        load_arm({"links": [{**link, **REFUSED[sentence]}]})


@pytest.mark.parametrize("changes", [{}, {"length": 0.8}, {"segments": 3}])
def test_a_file_keeps_the_sections_of_an_arm(changes: dict[str, Any]) -> None:
    arm = load_arm({"links": [{"sections": [INNER, OUTER], "modes": "auto", **changes}]})
    (link,) = arm.links
    assert load_arm(json.loads(json.dumps(arm.to_dict()))) == arm
    assert link.length == pytest.approx(0.8)
    assert link.sections == (Section(**INNER), Section(**{**OUTER, "EIz": (6.0, 3.0)}))
    assert link.stiffnesses == ("EIz",)


def test_an_empty_list_of_sections_is_a_uniform_link() -> None:
    link = {"length": 0.5, "rho_A": 0.1}
    assert load_arm({"links": [{**link, "sections": []}]}) == load_arm({"links": [link]})


def test_quantities_are_constant_or_linear_and_a_step_belongs_to_the_outer_section() -> None:
    sections = (Section(**INNER), Section(**OUTER))
    x = np.array([0.0, 0.3 - 1e-12, 0.3, 0.55, 0.8])
    assert_allclose(at(sections, "EIz", x), [24.0, 24.0, 6.0, 4.5, 3.0])
    assert_allclose(rate(sections, "EIz", x), [0.0, 0.0, -6.0, -6.0, -6.0])
    assert mean(sections, "EIz") == pytest.approx((0.3 * 24.0 + 0.5 * 4.5) / 0.8)
    assert mean(sections, "GJ") == 0.0
    part = cut(sections, 0.1, 0.55)
    assert [s.length for s in part] == pytest.approx([0.2, 0.25])
    assert_allclose(at(part, "EIz", x[:4] - 0.1), at(sections, "EIz", x[:4]))
    steep = (Section(length=1.0, rho_A=1.0, EIz=(8.0, 1.0)),)
    assert_allclose(at(steep, "EIz", np.array(edges(steep))), [8.0, 4.0, 2.0, 1.0])


@pytest.mark.parametrize("foreshortening", [False, True, FOURTH_ORDER])
@pytest.mark.parametrize(
    ("kind", "direction"), [(kind, along) for kind, where in KINDS.items() for along in where]
)
def test_a_uniform_link_cut_into_sections_keeps_its_constants(
    kind: str, direction: str, foreshortening: bool | str
) -> None:
    """Closed forms and one polynomial, against a Ritz solution in pieces."""
    modes = tuple(Mode(kind=kind, index=k, direction=direction) for k in (1, 2, 3))
    whole = Link(length=0.8, **NUMBERS, **CARRIED, modes=modes)
    pieces = tuple(Section(length=length, **NUMBERS) for length in (0.3, 0.1, 0.4))
    divided = Link(sections=pieces, **CARRIED, modes=modes)

    wanted, found = (
        chain_constants(Arm(links=(link,), foreshortening=foreshortening))[0][0]
        for link in (whole, divided)
    )

    for field in fields(LinkConstants):
        size = np.abs(np.array(getattr(wanted, field.name), dtype=float)).max(initial=0.0)
        a, b = (np.array(getattr(k, field.name), dtype=float) for k in (wanted, found))
        assert_allclose(b, a, rtol=0.0, atol=1e-8 * size, err_msg=field.name)
