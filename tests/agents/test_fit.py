"""`flexarm fit`: table, files and refusals; the page and its picture."""

import errno
import json
import os
import re
import shlex
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env  # noqa: F401
from agents.fit import (
    EXAMPLE,
    PLUCK_EXAMPLE,
    _check_units,
    _joint_units,
    _parser,
    doubts,
    draw,
    frequencies,
    main,
    spikes,
)
from benchmarks.accuracy.measured_data import COMMAND, PLUCK_COMMAND, page_table
from benchmarks.output import RESULTS
from dynamics import compile_arm, load_arm
from dynamics.measured.columns import Columns
from dynamics.measured.fit import Fit
from dynamics.measured.log_file import Log
from dynamics.types import Array, Vector3
from tests.paths import ROOT

LOG = str(RESULTS / "measured_data.csv")
PLUCK = str(RESULTS / "measured_data_pluck.csv")
STORED = json.loads((RESULTS / "measured_data.json").read_text(encoding="utf-8"))
PAGE = (ROOT / "docs" / "measured_data.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("log", "command", "key"), [(LOG, COMMAND, "fit"), (PLUCK, PLUCK_COMMAND, "pluck")]
)
def test_the_stored_log_gives_the_stored_fit(
    log: str, command: list[str], key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if again := key == "pluck":
        (tmp_path / "fit.json").write_text("{}")
    assert main([log, *command, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert said.endswith("/, in place of a former fit\n") == again
    found = json.loads((tmp_path / "fit.json").read_text())
    for name, stored in STORED[key]["parameters"].items():  # of six digits
        assert found["parameters"][name]["value"] == pytest.approx(stored["value"], rel=1e-5)
    assert (tmp_path / "overlay.png").stat().st_size > 10_000
    for line in said.splitlines()[:-1]:
        assert line in PAGE, line


def test_the_page_shows_the_commands_of_its_fits() -> None:
    shown = PAGE.replace("\\\n", " ")
    for name, command in (("measured_data", COMMAND), ("measured_data_pluck", PLUCK_COMMAND)):
        line = next(x for x in shown.splitlines() if f"fit docs/results/{name}.csv " in x)
        assert shlex.split(line)[3:] == command


@pytest.mark.parametrize("example", [EXAMPLE, PLUCK_EXAMPLE])
def test_the_examples_of_the_help_are_commands(example: str) -> None:
    assert _parser("flexarm fit").parse_args(example.split()[2:]).time == "t"


def test_the_page_shows_the_stored_coverage() -> None:
    assert page_table(STORED["cases"]) in PAGE


def changed(command: list[str], change: dict[str, list[str]]) -> list[str]:
    """A command with other values of options, or with more options."""
    given = [*command]
    for option, values in change.items():
        start = given.index(option) + 1 if option in given else len(given)
        stop = next((k for k in range(start, len(given)) if given[k].startswith("--")), len(given))
        given[start:stop] = values if option in given else [option, *values]
    return given


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"--arm": ["slimm"]}, "Unknown arm 'slimm'"),
        ({"--time": ["time"]}, "holds no column 'time'; it holds"),
        ({"--gauge-at": ["1"]}, "--gauge-at takes LINK:X[:DISTANCE], got '1'"),
        ({"--gauge-at": ["0:0.02:0.001"]}, "counts links from 1"),
        ({"--gauge-at": ["1:0.02:0.001"] * 2}, "each column of --gauge, got 2 places for 1"),
        ({"--gauge-at": ["1:0.02"]}, "needs LINK:X:DISTANCE for microstrain"),
        ({"--gauge-at": ["2:0.02:0.001"]}, "link must be"),
        ({"--gauge-at": ["2:angle"]}, "link must be"),
        ({"--gauge-at": ["1:slope"]}, "is an angle, but its unit is microstrain; give the unit"),
        ({"--units": ["gauge=deg"]}, "needs LINK:angle or LINK:slope for a column in deg, got"),
        ({"--shooting": ["0.5"]}, 'shooting needs start "measured"'),
        ({"--to": ["-1"]}, "From 0 s to -1 s the log holds 0 samples"),
        ({"--gauge-at": ["1:2.0:0.001"]}, "x must be within the link"),
        ({"--units": ["gauge=1/m"]}, "give the unit: --units gauge=strain"),
        ({"--units": ["ms"]}, "--units takes KIND=UNIT, got 'ms'"),
        ({"--fit": ["stiffness"]}, "--fit takes NAME=LOW:HIGH, got 'stiffness'"),
        ({"--fit": ["stiffness=1"]}, "--fit takes NAME=LOW:HIGH"),
        ({"--fit": ["mass=0:1"]}, "mass"),
        ({"--fit": ["damping=0:20", "damping=0:9"]}, "['damping'] stand twice in --fit"),
        ({"--units": ["time=ms", "time=s"]}, "['time'] stand twice in --units"),
        ({"--held": ["1", "1:0.2"]}, "['1'] stand twice in --held"),
        ({"--held": ["0"]}, "--held counts joints from 1: joint must be between 1 and 1"),
        ({"--held": ["2"]}, "joint must be between 1 and 1, the arm's joints, got '2'"),
        ({"--held": ["one"]}, "--held takes JOINT[:ANGLE], got 'one'"),
        ({"--held": ["1:nan"]}, "angle of a held joint"),
        ({"--from": ["7"]}, "its time runs from 0 to 2.995 s"),
        ({"--units": ["encoder=mm", "gauge=strain"]}, "one of ['rad', 'deg', 'rev']: --units an"),
    ],
)
def test_bad_command_lines_end_with_one_sentence(
    change: dict[str, list[str]],
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    assert main([LOG, *changed(COMMAND, change), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1
    assert not out.exists()


def test_places_of_gauges_count_links_behind_fixed_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A hub with a beam in a clamp that gives: two links and one joint."""
    links = [{"length": 0, "body": {"mass": 1.0}, "joint": {"rotor_inertia": 0.01}},
             {"length": 0.4, "rho_A": 0.1, "EIz": 1.0, "modes": "auto", "damping_ratio": 0.01,
              "joint": {"type": "fixed", "stiffness": 40.0}}]  # fmt: skip
    (tmp_path / "arm.json").write_text(json.dumps({"links": links}))
    for place, sentence in (
        ("3:0.02:0.0004", "link must be between 1 and 2, the arm's links"),
        ("2:0.5:0.0004", "x must be within the link, 0 to 0.4 m, got 0.5"),
        ("1:0.0:0.0004", "gauge 1 reads bending along y, which link 1 lacks"),
    ):
        given = changed(COMMAND, {"--arm": [str(tmp_path / "arm.json")], "--gauge-at": [place]})
        assert main([LOG, *given, "--out", str(tmp_path / "out")]) == 2
        assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "sentences"),
    [
        (["--from", "-1"], ["--from -1 leaves out nothing: the log begins at 0 s.\n"]),
        (["--from", "0"], ["gauge 1 is not white", "begin a free decay at its release by --from"]),
        (
            ["--fit", "stiffness=0.5:2", "damping=0:9", "gain_gauge_1=0.5:2"],
            ["does not tell gain_gauge_1: its interval is wider than its bounds"],
        ),
        (["--fit", "stiffness=0.2:1.15"], ["stiffness stopped at its bound", "widen --fit"]),
    ],
)
def test_a_doubtful_decay_is_told_with_its_remedy(
    wrong: list[str], sentences: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sentences are absent from the fit of the page."""
    assert main([PLUCK, *PLUCK_COMMAND, *wrong, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    for sentence in sentences:
        assert sentence in said
    assert "gain_gauge_1 stopped at its bound" not in said


def test_a_pluck_without_its_clamp_is_refused_with_the_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    k = PLUCK_COMMAND.index("--held")
    given = [*PLUCK_COMMAND[:k], *PLUCK_COMMAND[k + 2 :]]
    assert main([PLUCK, *given, "--out", str(tmp_path / "out")]) == 2
    assert "needs 1 encoders, got 0; name a column for each joint, or hold the joints" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize(("arm", "name", "is_told"), [
    ("slim", "encoder 1", True), ("stanford", "encoder 3", False), ("slim", "gauge 1", False)
])  # fmt: skip
def test_an_encoder_that_begins_anew_after_a_turn_is_told(
    arm: str, name: str, is_told: bool
) -> None:
    """Only one of a joint that turns does; the third of the Stanford arm slides."""
    t = 0.1 * np.arange(100.0)[:, None]
    for readings, jumps in ((t, False), (t % (2.0 * np.pi), True)):
        found = Fit(
            bounds={"damping": (0.2, 5.0)}, values=np.ones(1), intervals=np.ones((1, 2)),
            covariance=np.eye(1), signals=(name,), measured=readings, nominal=t, fitted=t,
            correlation=np.zeros(1), start={}, arm=load_arm(arm),
        )  # fmt: skip
        assert any("unwrap its column" in x for x in doubts(found)) == (is_told and jumps)


def test_an_unexplained_encoder_suggests_a_clamp() -> None:
    t = 0.01 * np.arange(20.0)[:, None]
    found = Fit(
        bounds={"stiffness": (0.2, 5.0)}, values=np.ones(1), intervals=np.ones((1, 2)),
        covariance=np.eye(1), signals=("encoder 2", "gauge 1"), measured=np.hstack([t, t]),
        nominal=np.hstack([t, t]), fitted=np.hstack([0.0 * t + 0.095, t]),
        correlation=np.zeros(2), start={}, arm=load_arm("slim"),
    )  # fmt: skip
    assert doubts(found) == [
        "The fit explains nothing of encoder 2: check columns, units and signs.",
        "If a joint was clamped, say so: --held 2.",
    ]
    assert doubts(replace(found, fitted=found.measured)) == []


@pytest.mark.parametrize(
    ("gravity", "foreshortening", "is_told"),
    [
        ((0.0, -9.81, 0.0), False, True),
        ((0.0, -9.81, 0.0), True, False),
        ((0.0,) * 3, False, False),
    ],
)
def test_a_fit_in_gravity_tells_what_its_links_lack(
    gravity: Vector3, foreshortening: bool, is_told: bool
) -> None:
    """A link that hangs or stands has another frequency; the printed one is without gravity."""
    t = np.arange(300.0)[:, None]
    arm = replace(load_arm("slim"), gravity=gravity, foreshortening=foreshortening)
    found = Fit(
        bounds={"stiffness": (0.2, 5.0)}, values=np.ones(1), intervals=np.ones((1, 2)),
        covariance=np.eye(1), signals=("gauge 1",), measured=t, nominal=t, fitted=t,
        correlation=np.zeros(1), start=dict.fromkeys(arm.names, (0.0, 0.0)), arm=arm,
    )  # fmt: skip
    assert any("with foreshortening: true" in sentence for sentence in doubts(found)) == is_told
    assert ("locked, without gravity:" in frequencies(arm, found)) == any(gravity)


def test_the_frequency_is_that_of_the_posture_at_the_start() -> None:
    """Folded, the second link adds less to the inertia about the first joint."""
    t, arm = np.arange(300.0)[:, None], load_arm("two-link")
    start = dict.fromkeys(arm.names, (0.0, 0.0)) | {"q2": (2.5, 0.0)}
    found = Fit(
        bounds={"stiffness": (0.2, 5.0)}, values=np.full(1, 4.0), intervals=np.ones((1, 2)),
        covariance=np.eye(1), signals=("gauge 1",), measured=t, nominal=t, fitted=t,
        correlation=np.zeros(1), start=start, arm=arm,
    )  # fmt: skip
    q = np.array([start[name][0] for name in arm.names])
    first = compile_arm(arm).frequencies(q)[0] / (2.0 * np.pi)
    assert f": {first:.4g} Hz as described, {2.0 * first:.4g} Hz." in frequencies(arm, found)


def test_an_option_that_is_repeated_adds_to_the_one_before() -> None:
    once, again = ["--units", "time=ms", "encoder=deg"], ["--units", "time=ms", "--units"]
    rest = ["run.csv", "--arm", "slim", "--time", "t"]
    rest += ["--fit", "damping=0:20", "--fit", "friction=0:2"]
    a, b = (_parser("fit").parse_args([*rest, *words]) for words in (once, [*again, "encoder=deg"]))
    assert a == b
    assert a.fit == ["damping=0:20", "friction=0:2"]


def test_a_full_disk_leaves_the_results_on_the_screen(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("agents.fit.write_json", full)
    out = tmp_path / "out"
    assert main([PLUCK, *PLUCK_COMMAND, "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert "stiffness" in said.out
    assert "Everything" not in said.out
    assert said.err.endswith(f"writing to {out} failed (No space left on device).\n")


@pytest.mark.parametrize(("units", "held", "sentence"), [
    ({"encoder": "deg"}, [], "column 'e3' is in deg, but joint 3 slides; .* --units e3=m\\."),
    ({"command": "mN m"}, [], "column 'u3' is in mN m, but joint 3 slides; .* --units u3=N\\."),
    ({"encoder": "m", "e3": "m"}, [], "column 'e1' is in m, but joint 1 turns"),
    ({"encoder": "deg"}, [0, 1], "column 'e1' is in deg, but joint 3"),
    ({"encoder": "deg", "e3": "mm", "u3": "N"}, [], None),
    ({"command": "-1"}, [], None),
])  # fmt: skip
def test_units_are_those_of_joints_that_turn_or_slide(
    units: dict[str, str], held: list[int], sentence: str | None
) -> None:
    """Of the Stanford arm, the third joint of which slides."""
    numbers = range(1, 7 - len(held))
    columns = Columns(time="t", command=tuple(f"u{k}" for k in numbers),
                      encoder=tuple(f"e{k}" for k in numbers), units=units)  # fmt: skip
    with nullcontext() if sentence is None else pytest.raises(ValueError, match=sentence):
        _check_units(columns, load_arm("stanford"), held)


def test_spikes_of_a_signal_are_told_with_the_time_of_the_largest() -> None:
    """Codes of a lost reading; neither noise nor a slow misfit is one."""
    t: Array = 0.005 * np.arange(600.0)
    read = np.random.default_rng(0).standard_normal((600, 3)) + [0.0, 0.0, 9.0] * t[:, None]
    read[100::200, 1] = (-100.0, -999.0, -100.0)
    read[50::7] = np.nan
    found = Fit(
        bounds={"damping": (0.2, 5.0)}, values=np.ones(1), intervals=np.ones((1, 2)),
        covariance=np.eye(1), signals=("encoder 1", "gauge 1", "gauge 2"), measured=read,
        nominal=0.0 * read, fitted=np.zeros((600, 3)), correlation=np.zeros(3), start={},
        arm=load_arm("slim"),
    )  # fmt: skip
    there = int(np.isfinite(read[:, 1]).sum())
    assert spikes(found, t) == [
        f"Half of the squared residual of gauge 1 is of 1 of its {there} readings, the largest at "
        "1.5 s: if they are spikes, or codes of a lost reading, empty their cells."
    ]


def test_joints_that_slide_are_drawn_in_metres_and_newtons(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The third joint of the Stanford arm does."""
    arm, shown = load_arm("stanford"), []
    assert _joint_units(arm, "[rad]", "[m]") == ["[rad]", "[rad]", "[m]", *["[rad]"] * 3]
    monkeypatch.setattr("agents.fit.save_figure", lambda figure, _: shown.append(figure))
    x = np.sin(np.outer(0.01 * np.arange(50.0), np.arange(1.0, 7.0)))
    found = Fit(
        bounds={"friction": (0.0, 5.0)}, values=np.ones(1), intervals=np.ones((1, 2)),
        covariance=np.eye(1), signals=("encoder 3",), measured=x, nominal=x, fitted=x,
        correlation=np.zeros(1), start={}, arm=arm,
    )  # fmt: skip
    draw(tmp_path / "overlay.png", Log(0.01 * np.arange(50.0), x, x, x[:, :0]), found, ["[m]"], "")
    assert [axes.get_ylabel() for axes in shown[0].axes] == [
        "command\n[N m], [N]",
        "encoder 3\n[m]",
    ]


def test_an_arm_of_more_joints_than_colours_is_drawn(tmp_path: Path) -> None:
    x = np.sin(np.outer(0.01 * np.arange(50.0), np.arange(1.0, 10.0)))
    found = Fit(
        bounds={"stiffness": (0.2, 5.0)}, values=np.ones(1), intervals=np.ones((1, 2)),
        covariance=np.eye(1), signals=("encoder 1",), measured=x, nominal=x, fitted=x,
        correlation=np.zeros(1), start={}, arm=load_arm("slim"),
    )  # fmt: skip
    draw(
        tmp_path / "overlay.png",
        Log(0.01 * np.arange(50.0), x, x, x[:, :0]),
        found,
        ["[rad]"],
        "nine joints",
    )
    assert (tmp_path / "overlay.png").stat().st_size > 10_000


@pytest.mark.parametrize(("readings", "is_told"), [(60, False), (300, True)])
def test_a_short_log_is_not_called_coloured_by_chance(readings: int, is_told: bool) -> None:
    """A correlation of 0.25 is two deviations of 60 white residuals, and four of 300."""
    t = np.where(np.arange(300) < readings, np.arange(300.0), np.nan)[:, None]
    found = Fit(
        bounds={"stiffness": (0.2, 5.0)}, values=np.ones(1), intervals=np.ones((1, 2)),
        covariance=np.eye(1), signals=("gauge 1",), measured=t, nominal=t, fitted=t,
        correlation=np.array([0.25]), start={}, arm=load_arm("slim"),
    )  # fmt: skip
    assert any("is not white" in sentence for sentence in doubts(found)) == is_told


def test_the_python_of_the_page_prints_what_it_says(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    code = PAGE.partition("```python\n")[2].partition("```")[0]
    exec(code, {})
    said = [float(x) for x in re.findall(r"\d+\.\d+", capsys.readouterr().out)]
    written = [float(x) for x in re.findall(r"\d+\.\d+", code.rpartition("#")[2])]
    assert said == pytest.approx(written, rel=1e-3)


def test_an_environment_of_a_fit_draws_its_parameters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In two lines, from the file; every episode has friction and stiffness in their intervals."""
    given = [*COMMAND, "--fit", "stiffness=0.5:2", "damping=0:10", "viscous_1=0:0.1",
             "delay_gauge_1=0:0.05", "--from", "0.5"]  # fmt: skip
    assert main([LOG, *given, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "explained" in said
    found = json.loads((tmp_path / "fit.json").read_text())
    kwargs = found["environment"]
    env = gym.make("FlexArm/OneLink-Reach-v0", **kwargs)
    assert list(kwargs["randomize"]) == ["stiffness", "damping", "viscous_1"]
    drawn = []
    for seed in range(3):
        env.reset(seed=seed)
        drawn.append(env.unwrapped.core.parameters[0].copy())
    low, high = np.array([found["parameters"][name]["interval"] for name in kwargs["randomize"]]).T
    assert np.all((np.maximum(low, 0.0) <= drawn) & (drawn <= high))
    assert np.ptp(drawn, axis=0).min() > 0.0
