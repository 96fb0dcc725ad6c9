"""Sentences about files and choices that are no arm, and files that are not to be trusted."""

import builtins
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynamics import Arm, UrdfWarning, load_arm
from dynamics.description.urdf.arm_text import arm_text
from dynamics.description.urdf.convert import convert
from dynamics.description.urdf.robot import MOST_BYTES
from tests.dynamics.description.urdf.robots import (
    PUBLIC,
    ROD,
    joint,
    link,
    loaded,
    one_rod,
    public,
    robot,
    written,
)


def arm_of(path: Path) -> Arm:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UrdfWarning)
        return load_arm(path)


BASE, END = link("base", ""), link("end", "")
TIP = joint("rod", "end", type="fixed", xyz="0.8 0 0")
REFUSED = {
    "is not valid XML: .* line 1": "<robot",
    "must hold a <robot> at the top, got <arm>": "<arm/>",
    "must not contain a document type": '<!DOCTYPE robot [<!ENTITY a "b">]><robot/>',
    "holds the macro <xacro:arm>; expand it first: xacro FILE > robot.urdf": (
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>'
    ),
    r"must have one link that is no joint's child, got \[\]": robot(),
    r"must have one link that is no joint's child, got \['a', 'b'\]": robot(link("a"), link("b")),
    "form a circle": robot(
        BASE, link("a"), link("b"), joint("a", "b"), joint("b", "a", name="back")
    ),
    "the link 'rod' is the child of two joints, 'ROD' and 'again'": robot(
        BASE, link("rod"), joint("base", "rod"), joint("base", "rod", name="again")
    ),
    "the link 'base' stands twice": robot(BASE, BASE),
    "every <link> must have a printable name, got None": robot("<link/>"),
    "joint 'ROD': <parent> must name a link of the file, got 'nothing'": robot(
        BASE, link("rod"), joint("nothing", "rod")
    ),
    "joint 'ROD': type must be one of .*, got 'screw'": one_rod(type="screw"),
    "joint 'ROD': <axis> must not be zero": one_rod(content='<axis xyz="0 0 0"/>'),
    "joint 'ROD': xyz of <axis> must be 3 numbers, got '0 1'": one_rod(content='<axis xyz="0 1"/>'),
    "joint 'ROD': rpy of <origin> must be 3 numbers, got '0 0 up'": one_rod(rpy="0 0 up"),
    "joint 'ROD': rpy of <origin> must be in radians, .*, got 90; .* are 1.5708": one_rod(
        rpy="0 90 0"
    ),
    "joint 'ROD': xyz of <origin> must be a finite number, got nan": one_rod(xyz="0 0 nan"),
    "joint 'ROD': damping of <dynamics> must not be negative, got -1.0": one_rod(
        content='<axis xyz="0 0 1"/><dynamics damping="-1"/>'
    ),
    "joint 'ROD': a floating joint has several coordinates; .* or make it fixed": one_rod(
        type="floating"
    ),
    "joint 'ROD': a joint that mimics another": one_rod(
        content='<axis xyz="0 0 1"/><mimic joint="other"/>'
    ),
    "link 'rod': value of <mass> must not be negative, got -2.0": one_rod().replace(
        'mass value="2"', 'mass value="-2"'
    ),
    "link 'rod': value of <mass> must be a number, got None": one_rod().replace(
        '<mass value="2"/>', ""
    ),
    "link 'rod' behind joint 'ROD' must have a mass, got none": one_rod().replace(ROD, ""),
    "link 'rod' behind joint 'ROD' must have a mass": one_rod().replace(
        '<mass value="2"/>', '<mass value="0"/>'
    ),
    "link 'rod': iyy of <inertia> must be a number, got None": one_rod().replace('iyy="0.11"', ""),
    "link 'rod': <inertia> must have no negative principal moment": one_rod().replace(
        'ixx="0.001"', 'ixx="-0.001"'
    ),
    "no joint between 'base' and 'rod' moves; choose another tip": robot(
        BASE, link("rod"), joint("base", "rod", type="fixed")
    ),
    r"the tree has several ends, .* tip=LINK. Ends: \['end', 'other'\]": one_rod().replace(
        "</robot>", link("other") + joint("rod", "other") + "</robot>"
    ),
    "last link has no inertia about its joint axis": robot(
        BASE, link("rod", '<inertial><mass value="2"/></inertial>'), joint("base", "rod")
    ),
}  # fmt: skip
CHOICES: dict[str, dict[str, Any]] = {
    "Unknown tip 'rob'; did you mean 'rod'. Known": {"tip": "rob"},
    "Unknown flexible link 'rob'; did you mean 'rod'. Known": {"flexible": {"rob": {"EIz": 1.0}}},
    r"flexible link 'base' is not behind a joint .* Links that are: \['rod', 'end'\]": {
        "flexible": {"base": {"EIz": 1.0}}
    },
    "Unknown key 'EI' in flexible.'rod'.; nearest known: 'EIz'": {"flexible": {"rod": {"EI": 1.0}}},
    "flexible.'rod'. must have a stiffness, .* or sections": {"flexible": {"rod": {"rho_A": 1.0}}},
    "flexible must be a mapping of links to their fields": {"flexible": ["rod"]},
    "rod behind ROD .revolute.: Link.EIz must not be negative, got -1.0": {
        "flexible": {"rod": {"EIz": -1.0}}
    },
    "flexible.'rod'.: tip is that of a last link without a frame": {
        "flexible": {"rod": {"EIz": 1.0, "tip": [1, 0, 0]}}
    },
    "link 'rod' cannot be flexible: it ends where it begins": {
        "tip": "rod", "flexible": {"rod": {"EIz": 1.0}}
    },
    "link 'end' cannot be flexible": {"flexible": {"end": {"EIz": 1.0}}},
}  # fmt: skip


@pytest.mark.parametrize("sentence", REFUSED)
def test_a_file_of_no_arm_is_refused_with_a_sentence(sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"robot.urdf: .*{sentence}"):
        loaded(tmp_path, REFUSED[sentence])


def test_an_inertia_that_does_not_move_is_not_read(tmp_path: Path) -> None:
    """As of antennas on the base of a public robot, whose inertias no body has."""
    odd = ROD.replace('ixx="0.001"', 'ixx="-0.001"')
    antenna = link("antenna", odd) + joint("base", "antenna", type="fixed")
    text = one_rod().replace(BASE, link("base", odd) + antenna)
    assert loaded(tmp_path, text, tip="end") == loaded(tmp_path, one_rod())


@pytest.mark.parametrize("sentence", CHOICES)
def test_a_choice_that_the_file_does_not_have_is_refused(sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"robot.urdf: .*{sentence}"):
        loaded(tmp_path, one_rod(), **CHOICES[sentence])


@pytest.mark.parametrize("source", ["slim", "arm.yaml", {"links": []}])
def test_choices_are_those_of_a_urdf_file(source: Any) -> None:
    with pytest.raises(ValueError, match=r"flexible and tip are of a \.urdf file, got"):
        load_arm(source, tip="rod")


def test_a_missing_or_a_large_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none.urdf: no such file"):
        load_arm(tmp_path / "none.urdf")
    with pytest.raises(ValueError, match=f"at most {MOST_BYTES} bytes"):
        loaded(tmp_path, " " * (MOST_BYTES + 1))


def test_no_entity_is_expanded_and_no_nesting_is_too_deep(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><robot name="&b;"/>'
    with pytest.raises(ValueError, match="must not contain a document type"):
        loaded(tmp_path, bomb)
    with pytest.raises(ValueError, match="is not valid XML: undefined entity"):
        loaded(tmp_path, '<robot name="&a;"/>')
    deep = one_rod().replace("</robot>", "<a>" * 100_000 + "</a>" * 100_000 + "</robot>")
    assert loaded(tmp_path, deep) == loaded(tmp_path, one_rod())


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_file_is_an_arm_or_refused(seed: int, tmp_path: Path) -> None:
    """Numbers replaced by others, and pieces cut out: a ValueError, and nothing else."""
    rng = np.random.default_rng(seed)
    text = public(list(PUBLIC)[seed]).read_text(encoding="utf-8")
    numbers = [match.span() for match in re.finditer(r"-?\d\S*?(?=[ \"])", text)]
    refused = []
    for _ in range(60):
        damaged = text
        if rng.random() < 0.3:
            begin = int(rng.integers(len(text)))
            damaged = text[:begin] + text[begin + int(rng.integers(1, 40)) :]
        else:
            for k in sorted(rng.choice(len(numbers), 3), reverse=True):
                start, stop = numbers[k]
                damaged = damaged[:start] + str(rng.choice(ODD)) + damaged[stop:]
        try:
            loaded(tmp_path, damaged, tip=PUBLIC[list(PUBLIC)[seed]], flexible=BENT[seed])
        except ValueError as error:
            refused.append(str(error))
    assert 0 < len(refused) < 60
    assert all(sentence.startswith("robot.urdf: ") for sentence in refused)


ODD = ["0", "-1", "1e-300", "1e29", "1e300", "nan", "inf", "", "x", "3.14159"]
BENT: list[dict[str, dict[str, Any]]] = [
    {"forearm_link": {"EIz": 4.0e3}},
    {"ForeArm_Link": {"EIz": 2.0e3}},
    {"panda_hand": {"EIz": 1.0e3}},
]


def test_no_other_file_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []

    def recorded(file: Any, *rest: Any, **more: Any) -> Any:
        opened.append(Path(file).name)
        return original(file, *rest, **more)

    mesh = '<visual><geometry><mesh filename="robot.stl"/></geometry></visual>'
    path = written(
        tmp_path, one_rod().replace(ROD, ROD + mesh + mesh.replace("visual", "collision"))
    )
    (tmp_path / "robot.stl").write_text("solid", encoding="utf-8")
    original = builtins.open
    monkeypatch.setattr(builtins, "open", recorded)
    load_arm(path)
    assert opened == ["robot.urdf"]


@pytest.mark.parametrize("name", PUBLIC)
def test_the_written_file_is_the_same_arm(name: str, tmp_path: Path) -> None:
    """To the last bit, with a link that bends and without."""
    flexible: dict[str, dict[str, Any]] = {
        "ur5": {"upper_arm_link": {"EIz": 9.0e3, "EIy": 9.0e3, "damping_ratio": 0.01}},
        "gen3": {"ForeArm_Link": {"EIz": 2.0e3, "GJ": 1.0e3, "segments": 2}},
        "panda": {"panda_hand": {"EIy": 1.0e3, "modes": []}},
    }
    for choice in ({}, flexible[name]):
        found = convert(public(name), PUBLIC[name], choice)
        path = tmp_path / "robot.yaml"
        path.write_text(arm_text(found, public(name).name), encoding="utf-8")
        assert load_arm(path) == found.arm
        text = path.read_text(encoding="utf-8")
        assert len(re.findall(r"^# .* behind ", text, re.MULTILINE)) >= found.arm.n_joint
        assert all(" ".join(note.split())[:40] in text for note in found.notes)


def test_no_name_of_a_file_becomes_a_line_of_the_written_one(tmp_path: Path) -> None:
    """A line break in an attribute is a space, unless it is written as a character."""
    for character in ("&#10;", "&#13;", "&#x85;", "&#x2028;"):
        with pytest.raises(ValueError, match="every <link> must have a printable name"):
            loaded(tmp_path, one_rod().replace('"end"', f'"end{character}links: []"'))
        named = written(tmp_path, one_rod().replace('"rods"', f'"rods{character}links: []"'))
        text = arm_text(convert(named), "odd\nlinks: []\u2028.urdf")
        assert len(re.findall("^links:", text, re.MULTILINE)) == 1
        path = tmp_path / "robot.yaml"
        path.write_text(text, encoding="utf-8")
        assert load_arm(path) == convert(named).arm


@pytest.mark.parametrize(
    ("declared", "encoding"),
    [
        ("ISO-8859-1", "latin-1"), ("windows-1252", "cp1252"), ("UTF-8", "utf-8-sig"),
        ("UTF-16", "utf-16"), ("utf-16", "utf-16-be"), (None, "utf-8"), (None, "utf-8-sig"),
    ],
)  # fmt: skip
def test_a_file_is_read_in_the_encoding_that_it_declares(
    declared: str | None, encoding: str, tmp_path: Path
) -> None:
    text = one_rod().replace('name="rods"', 'name="Bügel"')
    line = f'<?xml version="1.0" encoding="{declared}"?>\n' if declared else ""
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    path = tmp_path / "robot.urdf"
    path.write_bytes(mark + (line + text).encode(encoding))
    found, expected = arm_of(path), arm_of(written(tmp_path, text))
    assert found.name == "Bügel"
    assert found == expected


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("", "must be text in utf-8.* byte .*; save it as UTF-8, or declare its encoding in"),
        ('<?xml version="1.0" encoding="UTF-8"?>', "must be text in UTF-8 .*; save it as UTF-8"),
        ("<?xml version='1.0' encoding='klingon'?>", "declares the unknown encoding 'klingon'"),
        ("<?xml version='1.0' encoding='zip'?>", "declares the unknown encoding 'zip'"),
    ],
)
def test_a_file_in_another_encoding_than_it_declares_is_refused(
    line: str, sentence: str, tmp_path: Path
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes((line + one_rod().replace('name="rods"', 'name="Bügel"')).encode("latin-1"))
    with pytest.raises(ValueError, match=f"robot.urdf: {sentence}"):
        load_arm(path)
