import json
import pickle
import subprocess
import sys
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics import ARMS, Arm, Base, Joint, Link, Mode, Payload, load_arm
from tests.paths import REFERENCE

BEND = Mode(kind="clamped-free", index=1, direction="y")
TWIST = Mode(kind="torsion-fixed-free", index=1, direction="x")
PLAIN: dict[str, Any] = {"length": 1.0, "rho_A": 0.5, "EIz": 20.0, "modes": (BEND,)}

FREE: dict[str, Any] = {"type": "free", "mass": 2.0, "inertia": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}


def described(**changes: Any) -> dict[str, Any]:
    """Description of a one-link arm as in an arm file."""
    link = {
        "length": 1.0,
        "rho_A": 0.5,
        "EIz": 20.0,
        "modes": [{"kind": "clamped-free", "index": 1, "direction": "y"}],
    }
    return {"links": [{**link, **changes}]}


@pytest.mark.parametrize("name", sorted(ARMS))
def test_presets_know_their_name_and_survive_every_round_trip(name: str) -> None:
    arm = load_arm(name)
    assert arm.name == name
    assert arm.description
    assert load_arm(json.loads(json.dumps(arm.to_dict()))) == arm
    assert pickle.loads(pickle.dumps(arm)) == arm
    assert len({arm, load_arm(arm.to_dict())}) == 1
    assert load_arm(arm) is arm


def finite(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).filter(lambda x: x == 0.0 or x >= 1e-30)


@st.composite
def arms(draw: st.DrawFn) -> Arm:
    links = []
    for _ in range(draw(st.integers(1, 3))):
        x, y, z = (draw(finite(0.0, 1.0)) for _ in range(3))
        shapes = draw(
            st.lists(
                st.builds(
                    Mode,
                    kind=st.sampled_from(("clamped-free", "poly")),
                    index=st.integers(1, 3),
                    direction=st.sampled_from("yz"),
                    norm=st.sampled_from(("tip-unit", "mass", "raw")),
                ),
                max_size=2,
                unique_by=lambda mode: (mode.kind, mode.index, mode.direction),
            )
        )
        links.append(
            Link(
                length=draw(finite(0.1, 3.0)),
                rho_A=draw(finite(0.01, 9.0)),
                EIz=draw(finite(1.0, 100.0)),
                EIy=draw(finite(1.0, 100.0)),
                tip_mass=draw(finite(0.0, 2.0)),
                tip_inertia=((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z)),
                modes=tuple(shapes),
                damping_ratio=draw(finite(0.0, 0.1)),
                joint=Joint(
                    offset=(x, -y, z), viscous=z, rotation=((0, -1, 0), (1, 0, 0), (0, 0, 1))
                ),
            )
        )
    payload = Payload(mass=1.5) if draw(st.booleans()) else None
    rotation = draw(st.sampled_from(("exp", "linear")))
    return Arm(links=tuple(links), gravity=(0, 0, -9.81), rotation=rotation, payload=payload)


@settings(max_examples=40, deadline=None)
@given(arm=arms())
def test_to_dict_and_load_arm_are_inverse(arm: Arm) -> None:
    assert load_arm(json.loads(json.dumps(arm.to_dict()))) == arm


def test_coordinates_run_link_by_link() -> None:
    rigid = Link(length=0.5, rho_A=1.0, joint=Joint(offset=(0.3, 0.0, 0.4)))
    arm = Arm(links=(Link(**PLAIN), rigid, Link(**PLAIN)))
    assert arm.names == ("q1", "d1_1", "q2", "q3", "d3_1")
    assert (arm.n, arm.n_joint, arm.joint_index) == (5, 3, (0, 2, 3))
    assert arm.reach == pytest.approx(3.0)


def test_a_description_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        Link(**PLAIN).length = 2.0  # type: ignore[misc]


def test_skew_is_another_word_for_linear() -> None:
    arms = [Arm(links=(Link(**PLAIN),), rotation=word) for word in ("skew", "linear")]
    assert arms[0] == arms[1]


def test_numpy_numbers_and_lists_become_plain_floats() -> None:
    link = Link(**{**PLAIN, "length": np.float64(1.0), "tip_inertia": np.eye(3), "rho_A": 2})
    assert type(link.length) is type(link.rho_A) is float
    assert link.tip_inertia == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


REFUSED_LINKS = {
    "length must be positive, got -1.0": {"length": -1.0},
    "length .* must be a number, got True": {"length": True},
    "length .* must be a number, got None": {"length": None},
    "length .* finite number, got nan": {"length": float("nan")},
    "length .* finite number, got 10000": {"length": 10**400},
    "length .* at most 1e.30": {"length": 1e200},
    "length .* at least 1e-30": {"length": 1e-200},
    "rho_A .* got the text '1e-3' .remove the quotes": {"rho_A": "1e-3"},
    "rho_A .* got the text '1 kg/m' .write the number alone": {"rho_A": "1 kg/m"},
    "EIz must be positive .*got None": {"EIz": None},
    "EIz must not be negative, got -2.0": {"EIz": -2.0},
    "EIz .N m.2. must be 0 or at least 1e-30, got 1e-100": {"EIz": 1e-100},  # frequencies were nan
    "damping_ratio .* 0 or at least 1e-30, got 1e-320": {"damping_ratio": 1e-320},
    "EIy must be positive .*'z'.*got None": {
        "modes": [{"kind": "poly", "index": 1, "direction": "z"}]
    },
    "damping_ratio must not be negative, got -0.1": {"damping_ratio": -0.1},
    "exclude each other": {"damping_ratio": 0.1, "damping_beta": 0.1},
    "segments must be between 1 and 1000, got 0": {"segments": 0},
    "segments must be an int, got 1.0": {"segments": 1.0},
    "modes must be a list, got 'poly'": {"modes": "poly"},
    "tip_inertia must have 3 rows": {"tip_inertia": [[1, 2, 3]]},
    "Mode.kind is missing": {"modes": [{"index": 1, "direction": "y"}]},
    "index must be an int, got 1.5": {"modes": [{"kind": "poly", "index": 1.5, "direction": "y"}]},
    "index must be between 1 and 50, got 51": {
        "modes": [{"kind": "poly", "index": 51, "direction": "y"}]
    },
    "'x' does not fit kind 'poly'": {"modes": [{"kind": "poly", "index": 1, "direction": "x"}]},
    "'z' does not fit kind 'pinned-free'": {
        "modes": [{"kind": "pinned-free", "index": 1, "direction": "z"}]
    },
    "norm must be one of .*got 'unit'": {
        "modes": [{"kind": "poly", "index": 1, "direction": "y", "norm": "unit"}]
    },
    "clamped-free 1 along 'y' 2 times": {"modes": [described()["links"][0]["modes"][0]] * 2},
    "linearly dependent": {
        "modes": [
            {"kind": "clamped-free", "index": 1, "direction": "y"},
            {"kind": "clamped-tip-mass", "index": 1, "direction": "y"},
        ]
    },
    "rho_Ip must be positive for 2 torsion modes": {
        "GJ": 1.0,
        "tip_inertia": [[1, 0, 0], [0, 0, 0], [0, 0, 0]],
        "modes": [{"kind": "torsion-poly", "index": k, "direction": "x"} for k in (1, 2)],
    },
    "torsion mode but no inertia about x": {
        "GJ": 1.0,
        "modes": [{"kind": "torsion-poly", "index": 1, "direction": "x"}],
    },
    "norm 'mass' of a torsion mode": {
        "GJ": 1.0,
        "modes": [{"kind": "torsion-poly", "index": 1, "direction": "x", "norm": "mass"}],
    },
    "times that of the link": {
        "tip_mass": 1e9,
        "modes": [{"kind": "clamped-tip-mass", "index": 1, "direction": "y"}],
    },
    "'lenght' in links.0.; nearest known: 'length'": {"lenght": 1.0},
    "'viscosity' in links.0..joint; nearest known: 'viscous'": {"joint": {"viscosity": 1.0}},
    "joint must be a mapping": {"joint": 3},
    "coulomb_speed must be positive, got 0.0": {"joint": {"coulomb_speed": 0.0}},
    "rotor_inertia must not be negative": {"joint": {"rotor_inertia": -1.0}},
    "hub_inertia must not be negative": {"joint": {"hub_inertia": -1.0}},
    "offset must have 3 numbers, got 2: .1, 2.": {"joint": {"offset": [1, 2]}},
    "must be a rotation .*determinant -1": {
        "joint": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}
    },
    "Joint.type must be one of .*got 'screw'": {"joint": {"type": "screw"}},
    "Joint.stiffness must be positive, got 0.0": {"joint": {"stiffness": 0.0}},
    "rotor_inertia must be positive with Joint.stiffness .5.0.": {"joint": {"stiffness": 5.0}},
    "spring_damping .0.2. needs a spring": {"joint": {"spring_damping": 0.2}},
    "pinned-free with a prismatic joint": {
        "joint": {"type": "prismatic"},
        "modes": [{"kind": "pinned-free", "index": 1, "direction": "y"}],
    },
    "Body.mass is missing": {"modes": [], "body": {}},
    "Body.mass must not be negative, got -2.0": {"modes": [], "body": {"mass": -2.0}},
    "Body.inertia must be symmetric": {
        "modes": [],
        "body": {"mass": 1.0, "inertia": [[1, 1, 0], [0, 1, 0], [0, 0, 1]]},
    },
    "must be a rotation": {"joint": {"rotation": [[1, 1e-6, 0], [0, 1, 0], [0, 0, 1]]}},
}


@pytest.mark.parametrize("sentence", REFUSED_LINKS)
def test_a_bad_link_is_refused_with_a_sentence_that_says_where(sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as caught:
        load_arm(described(**REFUSED_LINKS[sentence]))
    assert "\n" not in str(caught.value)


LUMPED = {
    "length": 1.0, "rho_A": 1.0, "EIz": 9.0, "lumped": True,
    "modes": [{"kind": "hierarchical", "index": k, "direction": "y"} for k in (1, 2)],
}  # fmt: skip
REFUSED_ARMS = {
    "links must hold at least one": {"links": []},
    "must have a coordinate on a fixed base, got only fixed joints": {
        "links": [{"length": 1.0, "rho_A": 1.0, "joint": {"type": "fixed"}}]
    },
    r"Link 1 is lumped and has two modes along 'y', .*got Link.tip_inertia\[2\]\[2\] = 0.0": {
        "links": [LUMPED]
    },
    "Link 1 is lumped and has two modes along 'y', but nothing that its tip turns": {
        "links": [LUMPED, {"length": 1.0, "rho_A": 1.0}]
    },
    "links must be a list": {"links": {}},
    r"links\[0\] must be a mapping": {"links": [3]},
    "rotation must be one of .*got 'euler'": {"rotation": "euler"},
    r"foreshortening \(or 'fourth-order'\) must be true or false, got 1": {"foreshortening": 1},
    "or 'fourth-order'. must be true or false, got 'third'": {"foreshortening": "third"},
    "Base.mass must be positive, got 0.0": {"base": {"type": "free"}},
    "Base.inertia must be positive definite": {"base": {"type": "free", "mass": 2.0}},
    "no principal moment above the sum .* 1, 1, 2.1": {
        "base": {**FREE, "inertia": [[1, 0, 0], [0, 2.1, 0], [0, 0, 1]]}
    },
    "Base.quaternion must have length 1 .*got length 2": {
        "base": {**FREE, "quaternion": [2.0, 0.0, 0.0, 0.0]}
    },
    "Base.quaternion must have 4 numbers, got 3": {"base": {**FREE, "quaternion": [1, 0, 0]}},
    r"Base.velocity\[1\] .*finite number, got nan": {
        "base": {**FREE, "velocity": [0.0, float("nan"), 0.0]}
    },
    "euler and quaternion exclude each other": {
        "base": {**FREE, "euler": [0, 0, 0], "quaternion": [1, 0, 0, 0]}
    },
    "base.euler must be in radians, .*, got 90": {"base": {**FREE, "euler": [0, 90, 0]}},
    "'speed' in base; nearest known": {"base": {**FREE, "speed": 1.0}},
    "Base.mass .2.0. needs a free base": {"base": {"mass": 2.0}},
    "Arm.payload .* needs a link": {"base": FREE, "links": [], "payload": {"mass": 1.0}},
    'Base.driven .True. needs a free base; set type to "planar"': {"base": {"driven": True}},
    "Base.driven .True. needs Base.type .planar., got .free.": {"base": {**FREE, "driven": True}},
    r"Base.driven must be true or false, got 1": {"base": {**FREE, "type": "planar", "driven": 1}},
    r"Base.inertia\[2\]\[2\] must be positive, got 0.0": {"base": {"type": "planar", "mass": 2.0}},
    r"Base.position .* must lie in the x-y plane": {
        "base": {**FREE, "type": "planar", "position": [0.0, 0.0, 1.0]}
    },
    r"Base.quaternion .* must lie in the x-y plane": {
        "base": {**FREE, "type": "planar", "quaternion": [0.0, 1.0, 0.0, 0.0]}
    },
    "Base.type must be one of .*got 'sea'": {"base": {"type": "sea"}},
    "units must be one of .'SI'., got 'mm'": {"units": "mm"},
    "name must be text, got 3": {"name": 3},
    r"gravity\[1\] .*finite number, got nan": {"gravity": [0.0, float("nan"), 0.0]},
    "gravity must be a list, got 9.81": {"gravity": 9.81},
    "Payload.mass is missing": {"payload": {}},
    "Payload.mass must not be negative, got -1.0": {"payload": {"mass": -1.0}},
    "Payload.inertia must be symmetric": {
        "payload": {"mass": 1.0, "inertia": [[1, 1, 0], [0, 1, 0], [0, 0, 1]]}
    },
    "last link has no inertia about its joint axis": {
        "links": [{"length": 0.0, "body": {"mass": 1.0}}]
    },
    "'gravty' in the arm; nearest known: 'gravity'": {"gravty": [0, 0, 0]},
}


@pytest.mark.parametrize("sentence", REFUSED_ARMS)
def test_a_bad_arm_is_refused_with_a_sentence(sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        load_arm({**described(), **REFUSED_ARMS[sentence]})


def test_a_free_base_survives_the_round_trip() -> None:
    base = {**FREE, "com": [0.1, 0.0, 0.0], "quaternion": [0.1, 0.5, -0.7, 0.5]}
    arm = load_arm({**described(), "base": base})

    assert load_arm(json.loads(json.dumps(arm.to_dict()))) == arm
    assert arm.names[:7] == (
        "base_px", "base_py", "base_pz", "base_rx", "base_ry", "base_rz", "q1"
    )  # fmt: skip
    assert (arm.n, arm.n_joint, arm.joint_index) == (8, 1, (6,))
    assert pickle.loads(pickle.dumps(arm)) == arm


def test_a_planar_base_survives_the_round_trip() -> None:
    base = {**FREE, "type": "planar", "driven": True, "position": [1.0, 2.0, 0.0]}
    arm = load_arm({**described(), "base": base | {"euler": [0.5, 0.0, 0.0]}})

    assert load_arm(json.loads(json.dumps(arm.to_dict()))) == arm
    assert arm.names[:4] == ("base_px", "base_py", "base_rz", "q1")
    assert (arm.n, arm.n_joint, arm.n_torque, arm.joint_index) == (5, 1, 2, (3,))
    assert arm.base.q == pytest.approx((1.0, 2.0, 0.5), rel=1e-15)


def test_euler_angles_stand_for_a_quaternion() -> None:
    arm = load_arm({**described(), "base": {**FREE, "euler": [np.pi / 2, 0.0, 0.0]}})

    half = np.sqrt(0.5)
    assert arm.base.quaternion == pytest.approx((half, 0.0, 0.0, half), abs=1e-15)


def test_descriptions_that_are_not_descriptions_are_refused() -> None:
    link = Link(**PLAIN)
    for build in (
        lambda: Arm(links=("link",)),  # type: ignore[arg-type]
        lambda: Arm(links=(link,), base="fixed"),  # type: ignore[arg-type]
        lambda: Arm(links=(link,), payload=1.0),  # type: ignore[arg-type]
        lambda: replace(link, modes=("poly",)),  # type: ignore[arg-type]
        lambda: replace(link, joint=None),  # type: ignore[arg-type]
        lambda: Base(type="free", mass=1.0),
        lambda: load_arm(3),  # type: ignore[arg-type]
    ):
        with pytest.raises(ValueError):
            build()


def test_a_payload_with_inertia_about_x_carries_a_torsion_mode() -> None:
    link = Link(length=1.0, rho_A=0.5, GJ=4.0, modes=(TWIST,))
    inertia = ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert Arm(links=(link,), payload=Payload(mass=0.0, inertia=inertia)).n == 2
    assert Arm(links=(link, Link(**PLAIN, rho_Ip=1e-4))).n == 4  # the next link provides it


def test_files_of_both_kinds_give_the_same_arm(tmp_path: Path) -> None:
    (tmp_path / "arm.json").write_text(json.dumps(described()))
    (tmp_path / "arm.yaml").write_text(
        "links:\n- {length: 1.0, rho_A: 0.5, EIz: 20.0, modes: "
        "[{kind: clamped-free, index: 1, direction: 'y'}]}\n"
    )
    assert load_arm(tmp_path / "arm.json") == load_arm(str(tmp_path / "arm.yaml"))


def test_a_case_file_is_an_arm_file_too() -> None:
    assert load_arm(REFERENCE / "six_link_m2.json").n == 18


def test_what_is_not_there_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone\.json: no such file in /.*\.$"):
        load_arm(tmp_path / "gone.json")
    with pytest.raises(ValueError, match="Unknown arm 'slimm'; did you mean 'slim'\\? Presets: "):
        load_arm("slimm")
    with pytest.raises(ValueError, match=r"^\.: must end in \.json"):
        load_arm(Path())
    for name in ("arm.yaml", "robot.urdf"):
        with pytest.raises(ValueError, match="of a user who has none; write the whole path"):
            load_arm(f"~no-such-user/{name}")
    folder = tmp_path / "folder.json"
    folder.mkdir()
    with pytest.raises(ValueError, match="cannot read"):
        load_arm(folder)


def test_importing_the_descriptions_is_cheap() -> None:
    code = "import sys, dynamics; print(sorted({'casadi', 'numba', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
