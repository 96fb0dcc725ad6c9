"""`flexarm COMMAND`: what each command runs, and what hides it."""

import os
import runpy
import subprocess
import sys
from functools import partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

import flexarm
from agents.training import main as train
from dynamics import extras
from dynamics.arms import ARMS
from dynamics.command import UNREAD, UNWRITTEN, completed
from flexarm_env import IDS
from flexarm_env.__main__ import environments, table
from tests.imports import sources
from tests.paths import ROOT


def python(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder, whose modules come before those of the checkout."""
    code = f"import sys; sys.path[:0] = [{str(folder)!r}, {str(ROOT)!r}]; {arguments[0]}"
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", flexarm.COMMANDS)
def test_every_command_says_what_it_takes(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        flexarm.main([name, "--help"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: flexarm {name}")
    assert callable(import_module(flexarm.COMMANDS[name][0]).main)


PACKAGES = sorted(x.parent.relative_to(ROOT).as_posix() for x in ROOT.glob("[a-z]*/**/__main__.py"))


@pytest.mark.parametrize("package", [path.replace("/", ".") for path in PACKAGES])
def test_every_package_that_runs_says_what_it_takes(
    package: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["-m", "--help"])
    monkeypatch.delitem(sys.modules, f"{package}.__main__", raising=False)
    with pytest.raises(SystemExit) as end:
        runpy.run_module(package, run_name="__main__")
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("usage: ")


@pytest.mark.parametrize(
    ("name", "arguments", "own"),
    [
        ("train", ["--config", "none.yaml"], "train.py"),
        ("evaluate", ["nothing", "--out", "nowhere"], "agents.evaluate"),
        ("export", ["nothing", "--format", "c"], "agents.export.command"),
        ("sweep", [], "agents.sweep"),
        ("leaderboard", ["--tasks", "nothing"], "agents.leaderboard"),
        ("certify", ["nothing"], "flexarm_env.certify"),
        (
            "fit",
            ["none.csv", "--arm", "slim", "--time", "t", "--command", "u", "--encoder", "q"],
            "agents.fit",
        ),
    ],
)
def test_messages_begin_with_the_command_that_was_typed(
    name: str,
    arguments: list[str],
    own: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """And are those of its module otherwise."""
    monkeypatch.chdir(tmp_path)
    status = flexarm.main([name, *arguments])
    assert status == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith(f"flexarm {name}: ")
    assert import_module(flexarm.COMMANDS[name][0]).main(arguments) == status
    again = capsys.readouterr().err.splitlines()[-1]
    assert again == said.replace(f"flexarm {name}", own)


def test_unknown_commands_are_refused_and_none_prints_the_help(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for given, code in (["no-such"], 2), ([], 0):
        with pytest.raises(SystemExit) as end:
            flexarm.main(given)
        assert end.value.code == code
    shown = capsys.readouterr()
    assert "invalid choice: 'no-such'" in shown.err
    assert all(line in shown.out for _, line in flexarm.COMMANDS.values())


def test_the_help_imports_no_learning_library(tmp_path: Path) -> None:
    """Neither that of the dispatcher nor those of its commands."""
    ran = python(
        "import flexarm, contextlib\n"
        "for name in [None, *flexarm.COMMANDS]:\n"
        "    with contextlib.suppress(SystemExit): flexarm.main([name, '--help'][name is None:])\n"
        "print({'torch', 'stable_baselines3'} & set(sys.modules))",
        folder=tmp_path,
    )
    assert ran.stdout.count("usage: flexarm") == 1 + len(flexarm.COMMANDS)
    assert ran.stdout.endswith("set()\n"), ran


def test_the_table_of_arms_has_every_preset_and_every_id() -> None:
    rows = table().splitlines()[1:]
    assert [row.split()[0] for row in rows] == list(ARMS)
    shown = " ".join(map(environments, ARMS))
    assert shown.count("FlexArm/") == len({env_id.split("-")[0] for env_id in IDS})
    for env_id in IDS:
        scene, task, _ = env_id.split("-")
        assert f"{scene}-" in shown
        assert task in shown


def test_output_that_nobody_reads_ends_a_command_quietly(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "flexarm.py"), "arms"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path
    ) as run:
        assert run.stdout is not None
        assert run.stderr is not None
        run.stdout.close()
        assert run.stderr.read() == b""
    assert run.returncode == UNREAD


def test_a_help_that_nobody_reads_ends_quietly_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ends by SystemExit, with its text in a buffer that Python would write as it closes."""
    source, sink = os.pipe()
    os.close(source)
    with os.fdopen(sink, "w", encoding="utf-8") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert completed("train.py", partial(train, ["--help"])) == UNREAD
    assert capsys.readouterr().err == ""


RUNS = [x for x in (*sources(*flexarm.PACKAGES), ROOT / "train.py") if "sys.exit(" in x.read_text()]


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_module_that_runs_ends_as_a_command(path: Path) -> None:
    name = path.relative_to(ROOT).as_posix()
    if name != "train.py":
        name = name.removesuffix(".py").removesuffix("/__main__").replace("/", ".")
    assert f'sys.exit(completed("{name}", main))' in path.read_text()


def test_closed_output_lets_a_command_end_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert flexarm.main(["arms"]) == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full here")
def test_output_that_cannot_be_written_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert flexarm.main(["arms"]) == UNWRITTEN
    said = capsys.readouterr().err
    assert said == "flexarm arms: standard output: No space left on device.\n"


def test_a_present_folder_that_was_removed_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert flexarm.main(["certify", "arm.yaml"]) == flexarm.MISSING
    said = capsys.readouterr().err
    assert said == "flexarm: the present folder was removed; go to another one.\n"


def test_an_interrupted_command_ends_with_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def pressed(*_: object, **__: object) -> int:
        raise KeyboardInterrupt

    for what in ("flexarm_env.__main__.main", "flexarm.import_module"):
        monkeypatch.setattr(what, pressed)
        assert flexarm.main(["arms"]) == flexarm.INTERRUPTED
        assert capsys.readouterr().err == "flexarm arms: interrupted.\n"


@pytest.mark.parametrize("package", ["flexarm_env", "agents.evaluate"])
def test_a_users_own_dynamics_is_named(package: str, tmp_path: Path) -> None:
    (tmp_path / "dynamics.py").write_text("")
    ran = python(f"import {package}", folder=tmp_path)
    assert f"ImportError: {tmp_path}/dynamics.py hides flexarm's package 'dynamics'" in ran.stderr


def test_a_users_own_agents_are_named(tmp_path: Path) -> None:
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").write_text("")
    ran = python("import flexarm; sys.exit(flexarm.main(['evaluate']))", folder=tmp_path)
    assert ran.returncode == 2
    assert "hides flexarm's package 'agents'; rename it" in ran.stderr
    assert ran.stderr.count("\n") == 1


def test_a_missing_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(name: str) -> None:
        raise ModuleNotFoundError("No module named 'filelock'", name="filelock")

    monkeypatch.setattr(flexarm, "import_module", refused)
    assert flexarm.main(["train"]) == 2
    assert "train needs filelock" in (error := capsys.readouterr().err)
    assert 'pip install -c constraints.txt -e ".[train]"' in error
    assert flexarm.main(["sweep"]) == 2
    assert '-e ".[scale]"' in capsys.readouterr().err


def test_outside_a_checkout_the_advice_installs_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the command and by its modules alike; a user of the wheel has no folder of ours."""
    assert flexarm.installation("peers") == extras.installation("peers")
    assert extras.installation("peers").endswith('pip install -c constraints.txt -e ".[peers]"')
    monkeypatch.setattr(flexarm, "__file__", str(tmp_path / "flexarm.py"))
    monkeypatch.setattr(extras, "ROOT", tmp_path)
    assert flexarm.installation("peers") == 'run: pip install "flexarm[peers]"'
    assert extras.installation("peers") == 'run: pip install "flexarm[peers]"'


@pytest.mark.parametrize(
    ("missing", "line", "needed_by"),
    [
        ("filelock", "import agents.evaluate", "agents"),
        ("rich", "import agents.training", "agents"),
        ("stable_baselines3", "from flexarm_env import SB3VecEnv", "SB3VecEnv"),
        ("exudyn", "import benchmarks.peers.engines", "benchmarks.peers"),
    ],
)
def test_modules_name_a_missing_extra_too(
    missing: str, line: str, needed_by: str, tmp_path: Path
) -> None:
    ran = python(f"sys.modules[{missing!r}] = None; {line}", folder=tmp_path)
    extra = "peers" if missing == "exudyn" else "train"
    assert f"Error: {needed_by} needs {missing}" in ran.stderr
    assert ran.stderr.endswith(f'pip install -c constraints.txt -e ".[{extra}]"\n')


@pytest.mark.parametrize("module", ["agents.policy", "agents.fit"])
def test_policies_and_fits_need_no_extra(module: str, tmp_path: Path) -> None:
    extra = ("daqp", "filelock", "optuna", "rich", "sb3_contrib", "stable_baselines3")
    ran = python(
        f"sys.modules.update(dict.fromkeys({extra}))\n"
        f"import {module}\nprint('torch' in sys.modules)",
        folder=tmp_path,
    )
    assert ran.stdout == "False\n", ran.stderr


def test_the_version_is_that_of_the_distribution(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        flexarm.main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"flexarm {version('flexarm')}\n"
