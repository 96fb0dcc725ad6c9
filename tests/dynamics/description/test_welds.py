"""Links in segments: every family of shapes converges to the beam, or a warning gives its error."""

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynamics import Arm, Body, Joint, Link, Mode, Payload, StiffSegmentsWarning, load_arm
from dynamics.description.beams.uniform import clamped_root
from dynamics.description.mode_shapes import FREE_ROOT, KINDS, STIFFNESS
from dynamics.description.welds import FREE_TIP, tip_compliance
from dynamics.model import Model
from tests.dynamics.beam_elements import beam_frequencies

LENGTH, RHO_A, EI, TIP = 0.8, 0.12, 6.0, 0.15
BEAM: dict[str, Any] = {
    "length": LENGTH, "rho_A": RHO_A, "EIz": EI, "EIy": EI, "GJ": 4.0, "EA": 1e4, "rho_Ip": 1e-4,
    "tip_mass": TIP, "joint": Joint(rotor_inertia=0.02),
}  # fmt: skip
SEGMENTS = (1, 2, 4, 8, 16)
WELDABLE = [
    (kind, direction) for kind, at in KINDS.items() if kind not in (*FREE_TIP, *FREE_ROOT)
    for direction in at
]  # fmt: skip
STIFF = [(kind, direction) for kind in FREE_TIP for direction in KINDS[kind]]


def first_frequency(link: Link) -> float:
    """[rad/s] with the joint locked."""
    model = Model(Arm(links=(link,)))
    return float(model.frequencies(np.zeros(model.n), joints="locked")[0])


def of_the_beam(direction: str) -> float:
    """[rad/s] first frequency of the clamped beam, from the roots of its frequency equation."""
    if direction in "yz":
        root = clamped_root(1, TIP / (RHO_A * LENGTH), 0.0)
        return (root / LENGTH) ** 2 * math.sqrt(EI / RHO_A)
    if direction == "x":
        return 0.5 * math.pi / LENGTH * math.sqrt(BEAM["GJ"] / BEAM["rho_Ip"])
    low, high = 0.0, 0.5 * math.pi  # b tan b = rho_A l / tip mass
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = TIP * middle * math.tan(middle) > RHO_A * LENGTH
        low, high = (low, middle) if above else (middle, high)
    return low / LENGTH * math.sqrt(BEAM["EA"] / RHO_A)


def described(kind: str, direction: str, segments: int, count: int = 2) -> Link:
    modes = tuple(Mode(kind=kind, index=k + 1, direction=direction) for k in range(count))
    return Link(**BEAM, modes=modes, segments=segments)


@pytest.mark.parametrize(("kind", "direction"), WELDABLE)
def test_the_first_frequency_converges_over_segments(kind: str, direction: str) -> None:
    exact = of_the_beam(direction)
    found = [first_frequency(described(kind, direction, k)) / exact - 1.0 for k in SEGMENTS]
    assert all(error > -1e-9 for error in found)  # Ritz: never below
    assert found == sorted(found, reverse=True) or max(map(abs, found)) < 1e-7
    assert abs(found[-1]) < 2e-5


@pytest.mark.parametrize("segments", SEGMENTS)
def test_modes_by_rule_have_the_frequency_of_the_beam_in_any_number_of_segments(
    segments: int,
) -> None:
    """2.2707 Hz, by the frequency equation, which 60 finite elements confirm."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        link = Link(**{**BEAM, "EIy": None, "GJ": None}, modes="auto", segments=segments)  # type: ignore[arg-type]
    assert first_frequency(link) / (2.0 * math.pi) == pytest.approx(2.2707, abs=2e-4)
    assert tip_compliance(link.modes, link.beam, segments) == pytest.approx(1.0, rel=3e-5)


@pytest.mark.parametrize("segments", SEGMENTS[1:])
@pytest.mark.parametrize(("kind", "direction"), STIFF)
def test_shapes_with_a_free_tip_warn_in_segments_with_the_size_of_the_error(
    kind: str, direction: str, segments: int
) -> None:
    """The warning's compliance beside that of the assembled model, from its M, K and kinematics."""
    with pytest.warns(StiffSegmentsWarning) as caught:
        link = described(kind, direction, segments)
    stated = float(str(caught[0].message).split("yields only ")[1].split(" of")[0])
    model = Model(Arm(links=(link,)))
    modal = range(1, model.n)
    moves = {"y": 1, "z": 2, "axial": 0}
    step = 1e-7

    def tip(i: int) -> float:
        q = np.zeros(model.n)
        q[i] = step
        if direction == "x":
            return step * (model.chain.links[(i - 1) // 2].tip_theta[(i - 1) % 2][0])
        return float((model.tip(q) - model.tip(np.zeros(model.n)))[moves[direction]])

    load = np.array([tip(i) for i in modal]) / step
    whole = float(load @ np.linalg.solve(model.stiffness[1:, 1:], load))
    beam = {"x": LENGTH / BEAM["GJ"], "axial": LENGTH / BEAM["EA"]}.get(
        direction, LENGTH**3 / 3.0 / EI
    )
    assert stated == pytest.approx(whole / beam, rel=5e-3)
    assert stated < 0.95
    assert first_frequency(link) > 1.02 * of_the_beam(direction)


@pytest.mark.parametrize(("kind", "direction"), STIFF)
def test_shapes_with_a_free_tip_warn_before_a_weld_with_the_size_of_the_error(
    kind: str, direction: str
) -> None:
    """The tip's compliance under a moment, a torque or a force along it, from K and kinematics."""
    link = replace(described(kind, direction, 1), tip_mass=0.0)
    part = replace(link, joint=Joint(type="fixed"))
    with pytest.warns(StiffSegmentsWarning, match="Link 1 has .* at a weld") as caught:
        arm = load_arm(Arm(links=(link, part)))
    stated = float(str(caught[0].message).split("yields only ")[1].split(" of")[0])
    first = Model(Arm(links=(link,)))
    body = first.chain.links[0]
    load = np.array(body.tip_phi if direction == "axial" else body.tip_theta).sum(axis=1)
    whole = float(load @ np.linalg.solve(first.stiffness[1:, 1:], load))
    assert stated == pytest.approx(whole * BEAM[STIFFNESS[direction]] / LENGTH, rel=5e-3)
    assert stated < 0.96
    with warnings.catch_warnings():
        warnings.simplefilter("error", StiffSegmentsWarning)
        load_arm(Arm(links=(link, replace(part, joint=Joint()))))  # a joint that moves
        if direction != "axial":  # a mass on the axis loads the tip along it alone
            load_arm(Arm(links=(link, Link(length=0.0, body=Body(mass=1.0), joint=part.joint))))
        load_arm(replace(arm, links=(described("hierarchical", "y", 1), part)))


def turning(*moments: float) -> Payload:
    return Payload(mass=TIP, inertia=np.diag(moments).tolist())


def warned(*links: Link, payload: Payload) -> bool:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_arm(Arm(links=links, payload=payload))
    return any(issubclass(entry.category, StiffSegmentsWarning) for entry in caught)


@pytest.mark.parametrize("kind", ["clamped-free", "clamped-tip-mass", "hierarchical"])
@pytest.mark.parametrize("direction", ["y", "z"])
def test_a_payload_that_turns_with_the_tip_warns_of_shapes_that_miss_the_frequencies(
    kind: str, direction: str
) -> None:
    """Beside finite elements: two clamped-free shapes err by 46 % in the second frequency."""
    inertia = 0.01
    link = replace(described(kind, direction, 1), tip_mass=0.0)
    payload = turning(0.0, inertia, inertia)
    model = Model(Arm(links=(link,), payload=payload))
    found = model.frequencies(np.zeros(model.n), joints="locked")[:2]
    exact = beam_frequencies(LENGTH, RHO_A, EI, tip_mass=TIP, tip_inertia=inertia)[:2]
    assert warned(link, payload=payload) == (np.abs(found / exact - 1.0).max() > 0.01)
    massless = Link(length=0.01, rho_A=1e-6, joint=Joint(type="fixed"))
    assert warned(link, massless, payload=payload) == (kind != "hierarchical")


@pytest.mark.parametrize(
    ("kind", "direction", "payload", "told"),
    [
        ("clamped-free", "y", Payload(mass=TIP), False),  # a force across: no moment
        ("clamped-free", "y", turning(0.01, 0.01, 0.0), False),
        ("clamped-free", "y", turning(0.0, 0.0, 0.01), True),
        ("clamped-free", "z", turning(0.0, 0.0, 0.01), False),
        ("clamped-free", "z", Payload(mass=TIP, com=(0.1, 0.0, 0.0)), True),
        ("torsion-fixed-free", "x", Payload(mass=TIP, com=(0.1, 0.0, 0.0)), False),
        ("torsion-fixed-free", "x", turning(1e-3, 0.0, 0.0), True),
        ("axial-fixed-free", "axial", Payload(mass=TIP), True),
        ("axial-fixed-free", "axial", Payload(mass=1e-4, com=(1.0, 0.0, 0.0)), False),
    ],
)
def test_a_payload_warns_only_where_it_loads_the_tip_along_a_mode(
    kind: str, direction: str, payload: Payload, told: bool
) -> None:
    assert warned(described(kind, direction, 1), payload=payload) == told


def test_shapes_with_a_free_tip_do_not_warn_in_one_piece_or_beside_one_that_bears_moment() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        described("clamped-free", "y", 1)
        both = (
            Mode(kind="clamped-free", index=1, direction="y"),
            Mode(kind="poly", index=1, direction="y"),
        )
        Link(**BEAM, modes=both, segments=4)


def test_the_warning_is_of_the_direction_whose_shapes_bear_no_moment() -> None:
    shapes = [Mode(kind=k, index=1, direction=d) for k, d in (("clamped-free", "z"), ("poly", "y"))]
    told = []
    for modes in (shapes, shapes[:1]):
        with pytest.warns(StiffSegmentsWarning, match="has clamped-free modes along 'z'") as caught:
            Link(**BEAM, modes=modes, segments=4)
        told.append(str(caught[0].message))
    assert told[0] == told[1]


def test_torsion_in_segments_without_an_inertia_of_its_own_is_refused() -> None:
    link = Link(**BEAM, modes=(Mode(kind="torsion-poly", index=1, direction="x"),), segments=3)
    with pytest.raises(ValueError, match=r"Link\.rho_Ip must be positive for 3 torsion modes"):
        replace(link, rho_Ip=0.0)
