"""URDF files of the tests."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.testing import assert_allclose
from numpy.typing import ArrayLike

from dynamics import Arm, UrdfWarning, load_arm
from tests.paths import ROOT

PUBLIC = {"ur5": "tool0", "gen3": "EndEffector_Link", "panda": "panda_hand_tcp"}  # robot -> tip
ROD = (  # 2 kg, 0.8 m along x
    '<inertial><origin xyz="0.4 0 0"/><mass value="2"/>'
    '<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.11" iyz="0" izz="0.11"/></inertial>'
)


def public(robot: str) -> Path:
    return ROOT / "tests" / "reference" / "urdf" / f"{robot}.urdf"


def link(name: str, content: str = ROD) -> str:
    return f'<link name="{name}">{content}</link>'


def joint(parent: str, child: str, content: str = '<axis xyz="0 0 1"/>', **values: str) -> str:
    """Joint with the name of its child in capitals."""
    name, kind = values.get("name", child.upper()), values.get("type", "revolute")
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    place = f'<origin xyz="{values.get("xyz", "0 0 0")}" rpy="{values.get("rpy", "0 0 0")}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{place}{content}</joint>'


def robot(*parts: str) -> str:
    return '<robot name="rods">\n' + "\n".join(parts) + "\n</robot>\n"


def one_rod(**values: str) -> str:
    """A rod behind a joint, with a frame at its end."""
    end = joint("rod", "end", type="fixed", xyz="0.8 0 0")
    return robot(
        link("base", ""), link("rod"), link("end", ""), joint("base", "rod", **values), end
    )


def written(folder: Path, text: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def loaded(folder: Path, text: str, **choices: Any) -> Arm:
    """Arm of a text; what it does not take over is ignored."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UrdfWarning)
        return load_arm(written(folder, text), **choices)


def assert_close(found: ArrayLike, expected: ArrayLike) -> None:
    """To 1e-10 of the largest entry."""
    assert_allclose(found, expected, rtol=0.0, atol=1e-10 * float(np.abs(expected).max()))
