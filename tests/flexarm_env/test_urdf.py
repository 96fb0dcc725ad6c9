"""Robots of URDF files in environments, and the command that converts them."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

import flexarm
from dynamics import load_arm
from flexarm_env.__main__ import main
from flexarm_env.rendering import Renderer
from tests.dynamics.description.urdf.robots import (
    joint,
    link,
    loaded,
    one_rod,
    public,
    robot,
    written,
)

CONTENT = '<axis xyz="0 0 1"/><dynamics damping="0.05"/>'
TWO = robot(
    link("base", ""), link("upper"), link("lower"), link("end", ""),
    joint("base", "upper", CONTENT, xyz="0 0 0.3"), joint("upper", "lower", CONTENT, xyz="0.8 0 0"),
    joint("lower", "end", type="fixed", xyz="0.8 0 0"),
)  # fmt: skip


def test_an_environment_of_a_robot_with_a_flexible_link_steps(tmp_path: Path) -> None:
    bend = {"kind": "clamped-free", "index": 1, "direction": "y"}
    arm = loaded(tmp_path, TWO, flexible={"lower": {"EIz": 40.0, "modes": [bend]}})
    env = gym.make("FlexArm/TwoLink-Reach-v0", arm=arm, control_dt=0.02).unwrapped
    env.reset(seed=0)
    assert env.arm.names == ("q1", "q2", "d2_1")
    for _ in range(20):
        observation, _, terminated, _, info = env.step(np.array([0.4, -0.3], dtype=np.float32))
        assert np.isfinite(observation).all()
        assert not terminated
    q = env.core.q[0]
    assert np.all(np.abs(q) > 1e-6)
    assert np.abs(info["root_curvature"]).max() > 0.0
    lines = Renderer(env.core).shapes(env.core, q, 1.0)
    assert lines[-1][-1] == pytest.approx(env.model.tip(q), abs=1e-12)


def test_an_environment_takes_the_file_as_its_arm(tmp_path: Path) -> None:
    """Rigid: without the limits of joints, of which a warning says so."""
    limited = TWO.replace(CONTENT, CONTENT + '<limit effort="9"/>', 1)
    with pytest.warns(UserWarning, match=r"the limits of \['UPPER'\]: an arm has none"):
        env = gym.make(
            "FlexArm/TwoLink-Reach-v0", arm=written(tmp_path, limited), control_dt=0.02
        ).unwrapped
    assert env.arm == loaded(tmp_path, limited)
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[0]).all()


def test_an_environment_refuses_a_joint_that_slides(tmp_path: Path) -> None:
    arm = loaded(tmp_path, one_rod(type="prismatic"))
    with pytest.raises(ValueError, match="take arms whose joints turn, but joint 1 is prismatic"):
        gym.make("FlexArm/OneLink-Reach-v0", arm=arm, control_dt=0.02)


def test_the_command_writes_the_arm_that_python_loads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = str(written(tmp_path, TWO)), tmp_path / "robot.yaml"
    bent = ["--flexible", "lower", "EIz=40", "EIy=30.5", "--flexible", "upper", "EIz=90"]
    assert flexarm.main(["arms", "convert", file, *bent, "--out", str(out)]) == 0
    expected = loaded(
        tmp_path, TWO, flexible={"lower": {"EIz": 40, "EIy": 30.5}, "upper": {"EIz": 90}}
    )
    assert load_arm(out) == expected
    assert flexarm.main(["arms", "convert", file, *bent]) == 0
    assert capsys.readouterr().out == out.read_text(encoding="utf-8")


def test_an_arm_file_that_nobody_reads_is_no_fault_of_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unread(*_: object) -> None:
        raise BrokenPipeError

    file = str(written(tmp_path, TWO))
    monkeypatch.setattr(sys, "stdout", SimpleNamespace(write=unread))
    with pytest.raises(BrokenPipeError):
        main(["convert", file])


def test_the_command_warns_in_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An arm of these lengths is warned of once in a process."""
    rods = robot(link("base", ""), link("rod"), link("end", ""), joint("base", "rod", CONTENT),
                 joint("rod", "end", type="fixed", xyz="0.8125 0 0"))  # fmt: skip
    words = [str(written(tmp_path, rods)), "--flexible", "rod", "EIz=40", "EA=1000"]
    assert flexarm.main(["arms", "convert", *words]) == 0
    assert re.fullmatch("flexarm arms: Link 1 is thick: .* as much.\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--tip", "nothing"], "ur5.urdf: Unknown tip 'nothing'"),
        ([], "ur5.urdf: the tree has several ends"),
        (["--flexible", "forearm_link"], "must have a stiffness"),
        (["--flexible", "forearm_link", "EIz"], "expected KEY=VALUE, got 'EIz'"),
        (["--flexible", "forearm_link", "EIz=[1"], r"EIz must be a number, got '\[1'"),
        (
            ["--tip", "tool0", "--flexible", "forearm_link", "EIz=6x"],
            r"EIz .* got the text '6x' \(write the number alone",
        ),
        (["--tip", "tool0", "--out", "no/where.yaml"], "No such file or directory"),
    ],
)
def test_the_command_ends_with_one_sentence(
    words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert flexarm.main(["arms", "convert", str(public("ur5")), *words]) == 2
    errors = capsys.readouterr().err
    assert re.match(f"flexarm arms convert: .*{sentence}", errors)
    assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--out", "there.yaml"], r"there.yaml is there already, perhaps completed by hand"),
        (["--out", "arm.json"], r"--out must end in .yaml or .yml, got 'arm.json'"),
        (["--tip", "tool0", "--out", "there.yaml/x.yaml"], r"there.yaml/x.yaml: Not a directory"),
        (["--flexible", "a", "EIz=6", "--flexible", "a", "EIy=7"], r"--flexible a is given twice"),
        (["--flexible", "a", "EIz=6", "EIz=7"], r"'EIz'. stand twice in --flexible a"),
    ],
)
def test_a_conversion_replaces_no_file_and_drops_no_word(
    words: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.yaml").write_text("# by hand")
    assert flexarm.main(["arms", "convert", str(public("ur5")), *words]) == 2
    assert re.search(sentence, capsys.readouterr().err)
    assert [path.name for path in tmp_path.iterdir()] == ["there.yaml"]
    assert Path("there.yaml").read_text() == "# by hand"


def test_a_folder_is_refused_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert flexarm.main(["arms", "convert", "."]) == 2
    assert capsys.readouterr().err.startswith("flexarm arms convert: .: cannot read '.'")
