"""Links whose modes are not listed: rigid with a warning, rigid as stated, or by rule."""

import json
import logging
import math
import pickle
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynamics import ARMS, Arm, Body, Joint, Link, Mode, Payload, ThickLinkWarning, load_arm
from dynamics.__main__ import main
from dynamics.description.mode_rule import LIGHT, RigidLinkWarning
from dynamics.model import Model
from tests.dynamics.beam_elements import beam_frequencies

BEAM: dict[str, Any] = {"length": 1.0, "rho_A": 0.6, "EIz": 20.0}
HEAVY_HUB = Joint(rotor_inertia=2.0 * LIGHT * 0.2)  # the beam has 0.2 kg m^2 about the joint
REMEDIES = r"modes: \[\] .*modes: auto"


def kinds(link: Link) -> list[tuple[str, int, str]]:
    return [(mode.kind, mode.index, mode.direction) for mode in link.modes]


def test_an_arm_file_that_states_no_modes_warns_with_the_link_and_both_remedies(
    tmp_path: Path,
) -> None:
    (tmp_path / "arm.json").write_text(json.dumps({"links": [{**BEAM, "modes": []}, BEAM]}))
    with pytest.warns(RigidLinkWarning, match=rf"links\[1\] has EIz .*{REMEDIES}") as caught:
        arm = load_arm(tmp_path / "arm.json")
    assert len(caught) == 1
    assert [link.modes for link in arm.links] == [(), ()]


def test_a_link_built_without_modes_warns_at_the_line_that_builds_it() -> None:
    with pytest.warns(RigidLinkWarning, match=rf"A link of 1 m has EIz .*{REMEDIES}") as caught:
        link = Link(**BEAM)
    assert caught[0].filename == __file__
    assert link.modes == ()


def test_a_stated_rigid_link_and_one_without_stiffness_do_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stiff = Link(**BEAM, modes=())
        replace(stiff, length=2.0)
        Link(length=1.0, rho_A=0.6)
        Link(length=1.0, body=Body(mass=1.0))
        assert load_arm({"links": [{**BEAM, "modes": []}]}).links == (stiff,)


def test_rigid_links_with_a_stiffness_survive_the_round_trip_without_a_warning() -> None:
    arm = Arm(links=(Link(**BEAM, modes=()), Link(length=1.0, rho_A=0.6)))
    plain = arm.to_dict()
    assert [link.get("modes") for link in plain["links"]] == [[], None]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_arm(plain) == arm
        warnings.simplefilter("ignore", ThickLinkWarning)  # of some presets, which is right
        for preset in ARMS.values():
            assert load_arm(preset.to_dict()) == preset


@pytest.mark.compiles
def test_evaluating_a_case_without_modes_is_rigid_and_warns_beside_the_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outputs = []
    for name, link in (("silent", BEAM), ("stated", {**BEAM, "modes": []})):
        path = tmp_path / f"{name}.json"
        state = {"q": [0.1], "qd": [0.2], "tau": [0.3]}
        path.write_text(json.dumps({"links": [link], "states": [state]}))
        assert main(["evaluate", str(path)]) == 0
        outputs.append(capsys.readouterr())
    assert outputs[0].out == outputs[1].out
    assert json.loads(outputs[0].out)["names"] == ["q1"]
    assert outputs[0].err.startswith("Warning: silent.json: links[0] has EIz")
    assert outputs[1].err == ""


@pytest.mark.parametrize(
    ("changes", "family"),
    [
        ({}, "unconstrained"),
        ({"joint": HEAVY_HUB}, "clamped-tip-mass"),
        ({"joint": Joint(hub_inertia=HEAVY_HUB.rotor_inertia)}, "clamped-tip-mass"),
        ({"tip_mass": 0.1}, "clamped-tip-mass"),
        ({"segments": 2}, "hierarchical"),
        ({"segments": 3, "joint": HEAVY_HUB, "tip_mass": 1e5}, "hierarchical"),
        ({"joint": Joint(type="prismatic")}, "clamped-tip-mass"),
        ({"joint": Joint(root=(0.1, 0.0, 0.0))}, "clamped-tip-mass"),
        ({"joint": Joint(stiffness=10.0, rotor_inertia=1e-6)}, "clamped-tip-mass"),
        ({"tip_mass": 1e5}, "hierarchical"),
    ],
)
def test_two_modes_of_the_family_that_suits_root_and_tip(
    changes: dict[str, Any], family: str
) -> None:
    link = Link(**{**BEAM, **changes}, modes="auto")  # type: ignore[arg-type]
    assert kinds(link) == [(family, 1, "y"), (family, 2, "y")]


@pytest.mark.parametrize(
    ("mass", "gyration", "family"),
    [
        (0.05, 0.02, "clamped-tip-mass"),
        (1.0, 0.02, "hierarchical"),
        (5.0, 0.02, "hierarchical"),
        (1.0, 1e-4, "clamped-tip-mass"),  # a compact motor
        (0.06, 0.3, "hierarchical"),  # a light boom, long as the link
    ],
)
def test_the_family_suits_what_is_welded_to_the_tip(
    mass: float, gyration: float, family: str
) -> None:
    """It errs less than the other one in the sum of both, beside finite elements of the beam.

    `gyration` [m^2] is that of the body's inertia, the square of its radius.
    """
    body = Body(mass=mass, inertia=(gyration * mass * np.eye(3)).tolist())
    welded = Link(length=0.0, body=body, joint=Joint(type="fixed"))
    exact = beam_frequencies(1.0, 0.6, 20.0, tip_mass=mass, tip_inertia=gyration * mass)[:2]

    def error(modes: Any) -> Any:
        arm = Arm(links=(Link(**BEAM, joint=HEAVY_HUB, modes=modes), welded))
        return Model(arm).frequencies(np.zeros(arm.n), joints="locked") / exact - 1.0

    others = {"clamped-tip-mass": "hierarchical", "hierarchical": "clamped-tip-mass"}
    other = [Mode(kind=others[family], index=k, direction="y") for k in (1, 2)]
    assert np.sum(error("auto")) < np.sum(error(other))
    alone = Link(**BEAM, joint=HEAVY_HUB, modes="auto")
    assert kinds(Arm(links=(alone, welded)).links[0])[0][0] == family
    assert kinds(Arm(links=Arm(links=(alone, welded)).links[:1]).links[0]) == kinds(alone)


@pytest.mark.parametrize(
    ("changes", "turns", "family"),
    [
        ({"rotor_inertia": 0.1}, 0.1 * 0.05 / 0.15, "hierarchical"),  # a geared drive
        ({"rotor_inertia": 1e-4}, 1e-4, "clamped-tip-mass"),
        ({"rotor_inertia": 1e-4, "rotation": {"rpy": (math.pi / 2, 0, 0)}}, 0.05, "hierarchical"),
        ({"rotor_inertia": 1e-4, "type": "prismatic"}, 0.05, "hierarchical"),
    ],
)
def test_the_family_suits_what_the_tip_turns_through_a_joint(
    changes: dict[str, Any], turns: float, family: str
) -> None:
    """A body on a joint, whose centre is at the tip, with all joints free; the root hardly turns.

    The joint lets the tip turn the rotor and the body in series, or the body alone across its axis.
    """
    inertia = (0.05 * np.eye(3)).tolist()
    body = Link(length=0.0, body=Body(mass=1.0, inertia=inertia), joint=Joint(**changes))
    exact = beam_frequencies(1.0, 0.6, 20.0, tip_mass=1.0, tip_inertia=turns)[:2]

    def error(modes: Any) -> float:
        arm = Arm(links=(Link(**BEAM, joint=Joint(rotor_inertia=1e6), modes=modes), body))
        found = Model(arm).frequencies(np.zeros(arm.n), joints="free")
        return float(np.sum(found[:2] / exact - 1.0))

    other = {"clamped-tip-mass": "hierarchical", "hierarchical": "clamped-tip-mass"}[family]
    assert 0.0 <= error("auto") < error([Mode(kind=other, index=k, direction="y") for k in (1, 2)])
    arm = Arm(links=(Link(**BEAM, joint=HEAVY_HUB, modes="auto"), body))
    assert kinds(arm.links[0])[0][0] == family


def test_a_beam_along_the_axis_of_the_bending_does_not_turn_with_it() -> None:
    """Bending along y leaves it pointing along z; bending along z turns it."""
    across = Joint(type="fixed", rotation={"rpy": (0.0, -math.pi / 2, 0.0)})  # type: ignore[arg-type]
    first = Link(**{**BEAM, "EIy": 20.0}, joint=HEAVY_HUB, modes="auto")  # type: ignore[arg-type]
    arm = Arm(links=(first, Link(length=0.8, rho_A=0.6, joint=across)))
    families = [family for family, _, _ in kinds(arm.links[0])]
    assert families == 2 * ["clamped-tip-mass"] + 2 * ["hierarchical"]


@pytest.mark.parametrize("mass", [0.05, 1.0])
@pytest.mark.parametrize("fixed", ["payload", "link"])
def test_a_body_beyond_the_tip_of_a_link_on_a_light_joint_is_no_free_tip(
    fixed: str, mass: float
) -> None:
    """Its first frequency with the joint locked is within 1 %; free tips made it 15 % too high."""
    exact = beam_frequencies(1.0, 0.6, 20.0, tip_mass=mass)[0]
    link = Link(**BEAM, modes="auto")
    welded = Link(length=0.0, body=Body(mass=mass), joint=Joint(type="fixed"))
    arm = {
        "payload": Arm(links=(link,), payload=Payload(mass=mass)),
        "link": Arm(links=(link, welded)),
    }[fixed]
    assert kinds(link)[0][0] == "unconstrained"
    found = Model(arm).frequencies(np.zeros(arm.n), joints="locked")[0]
    assert found == pytest.approx(exact, rel=0.01)


def test_torsion_needs_inertia_and_stretching_gets_no_mode() -> None:
    stiff = {**BEAM, "EIy": 30.0, "GJ": 5.0, "EA": 1e6, "joint": HEAVY_HUB, "modes": "auto"}
    bending = [("clamped-tip-mass", k, d) for d in "yz" for k in (1, 2)]
    assert kinds(Link(**stiff)) == bending
    assert kinds(Link(**stiff, rho_Ip=1e-3)) == [*bending, ("torsion-fixed-free", 1, "x")]
    heavy = ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3))  # too few for every segment
    assert kinds(Link(**stiff, tip_inertia=heavy)) == [*bending, ("torsion-poly", 1, "x")]
    welded = [("hierarchical", k, d) for d in "yz" for k in (1, 2)]
    assert kinds(Link(**stiff, tip_inertia=heavy, segments=2)) == welded
    twisting = [("torsion-poly", k, "x") for k in (1, 2)]
    assert kinds(Link(**stiff, rho_Ip=1e-3, segments=2)) == [*welded, *twisting]


@pytest.mark.parametrize(
    ("ratio", "beyond"),
    [(0.0, ""), (0.3, ""), (0.5, ""), (100.0, ""), (0.5, "a link"), (100.0, "a link"),
     (0.3, "a payload"), (100.0, "a payload")],
)  # fmt: skip
def test_torsion_by_rule_has_the_frequency_of_a_bar_with_what_its_tip_turns(
    ratio: float, beyond: str
) -> None:
    """b tan b = rho_Ip l / J, w = b / l sqrt(GJ / rho_Ip); one mode errs by 3 % at most."""
    length = 0.5
    size, J = 1e-3 * length, ratio * 1e-3 * length
    low, high = 0.0, 0.5 * np.pi
    for _ in range(60):
        b = 0.5 * (low + high)
        low, high = (low, b) if J * b * np.tan(b) > size else (b, high)
    exact = low / length * np.sqrt(5.0 / 1e-3)
    bar: dict[str, Any] = {
        **BEAM,
        "length": length,
        "EIz": None,
        "GJ": 5.0,
        "rho_Ip": 1e-3,
        "modes": "auto",
    }
    inertia = np.diag([J, 0.0, 0.0]).tolist()
    if beyond == "a payload":
        load = Payload(mass=1.0, inertia=np.diag([J, 0.5 * J, 0.5 * J]).tolist())
        arm = Arm(links=(Link(**bar, joint=HEAVY_HUB),), payload=load)
    elif beyond:  # a body beside the bar's axis, on a joint across it
        across = Joint(rotation=((1, 0, 0), (0, 0, -1), (0, 1, 0)), rotor_inertia=1.0)
        mass = Body(mass=1.0, com=(0.0, J**0.5, 0.0))
        arm = Arm(links=(Link(**bar, joint=HEAVY_HUB), Link(length=0.0, body=mass, joint=across)))
    else:
        arm = Arm(links=(Link(**bar, tip_inertia=inertia, joint=HEAVY_HUB),))
    found = Model(arm).frequencies(np.zeros(arm.n), joints="locked")
    assert found == pytest.approx([exact], rel=0.03)


def test_the_choice_is_logged_with_what_stays_rigid(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "dynamics"):
        load_arm({"links": [{**BEAM, "GJ": 5.0, "tip_mass": 0.1, "modes": "auto"}]})
    (record,) = caplog.records
    assert "2 clamped-tip-mass along y" in record.getMessage()
    assert "none along x (GJ unused, no inertia about x is stated)" in record.getMessage()


def test_an_automatic_arm_survives_the_round_trip_and_follows_changes() -> None:
    arm = load_arm({"links": [{**BEAM, "modes": "auto"}]})
    assert arm.automatic
    assert arm.to_dict()["links"][0]["modes"] == "auto"
    for copy in (load_arm(arm.to_dict()), pickle.loads(pickle.dumps(arm))):
        assert copy == arm
        assert copy.automatic
    changed = replace(arm.links[0], joint=HEAVY_HUB)
    assert kinds(changed)[0][0] == "clamped-tip-mass"
    listed = arm.with_listed_modes()
    assert listed == arm
    assert not listed.automatic
    assert listed.to_dict()["links"][0]["modes"][0]["kind"] == "unconstrained"


@pytest.mark.parametrize("value", ["automatic", "rigid", "", 2, {"y": 2}])
def test_modes_that_are_no_list_are_refused_with_the_remedy(value: object) -> None:
    sentence = rf'Link\.modes must be a list, got {value!r}; .*"auto" .*\[\]'
    with pytest.raises(ValueError, match=rf"links\[0\]: {sentence}"):
        load_arm({"links": [{**BEAM, "modes": value}]})
    with pytest.raises(ValueError, match=sentence):
        Link(**BEAM, modes=value)  # type: ignore[arg-type]


@pytest.mark.parametrize("tip_mass", [1e-6, 50.0, 200.0])
def test_both_modes_by_rule_have_the_damping_ratio_of_the_link(tip_mass: float) -> None:
    """From the eigenvalues of the clamped link, also where its tip is very heavy."""
    link = Link(**{**BEAM, "rho_A": 0.01}, tip_mass=tip_mass, damping_ratio=0.03, joint=HEAVY_HUB,
                modes="auto")  # type: ignore[arg-type]  # fmt: skip
    model = Model(Arm(links=(link,)))
    A, _ = model.linearize(*np.zeros((2, 3)), np.zeros(1))
    clamped = A[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])]
    M = model.mass_matrix(np.zeros(3))
    forces = M[1:, :] @ A[3:, :]  # of the link's coordinates, with the joint held
    clamped[2:] = np.linalg.solve(M[1:, 1:], forces[:, [1, 2, 4, 5]])
    poles = np.linalg.eigvals(clamped)
    np.testing.assert_allclose(-poles.real / np.abs(poles), 0.03, rtol=1e-6)


def test_a_lumped_link_without_tip_inertia_gets_one_mode() -> None:
    """A second one would move no mass."""
    light, heavy = (
        Link(**BEAM, tip_mass=1.0, tip_inertia=inertia * np.eye(3), lumped=True, modes="auto")  # type: ignore[arg-type]
        for inertia in (0.0, 1e-3)
    )
    assert [len(link.modes) for link in (light, heavy)] == [1, 2]
    assert Model(Arm(links=(light,))).frequencies().size == 1


def test_modes_by_rule_without_a_stiffness_are_warned_of() -> None:
    with pytest.warns(RigidLinkWarning, match=r"states modes: auto but neither EIz, .* rigid"):
        Link(length=1.0, rho_A=0.6, modes="auto")  # type: ignore[arg-type]
