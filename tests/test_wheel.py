"""The wheel: it holds what its commands need, and they work outside the checkout."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests.paths import ROOT

PARTS = ("agents", "configs", "dynamics", "flexarm_env")
FILES = ("LICENSE", "README.md", "flexarm.py", "pyproject.toml", "setup.py")
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheel of a copy of the checkout, which keeps no traces of the build."""
    copy = tmp_path_factory.mktemp("copy")
    for part in PARTS:
        shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
    for file in FILES:
        shutil.copy(ROOT / file, copy)
    subprocess.run([*PIP, "wheel", "--no-deps", "-w", copy / "dist", copy], check=True)
    (built,) = (copy / "dist").glob("flexarm-*.whl")
    return built


@pytest.fixture(scope="module")
def flexarm(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command `flexarm` of a fresh environment, which sees this one's libraries alone."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (packages,) = folder.glob("[Ll]ib/**/site-packages")
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    subprocess.run([*PIP, "--python", folder, "install", "--no-deps", wheel], check=True)
    return folder / ("Scripts" if os.name == "nt" else "bin") / "flexarm"


def run(command: Path, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the command in an empty folder, without the checkout on the path."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [command, *arguments], cwd=folder, env=env, capture_output=True, text=True, check=False
    )


def test_the_wheel_holds_every_package_and_its_data(wheel: Path) -> None:
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    wanted = {"flexarm.py"} | {
        str(path.relative_to(ROOT))
        for part in ("agents", "dynamics", "flexarm_env")
        for path in (ROOT / part).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    configs = ROOT / "configs"
    files = [*configs.glob("*.yaml"), *configs.glob("rl_zoo/*.yml")]
    wanted |= {f"agents/configs/{path.relative_to(configs).as_posix()}" for path in files}
    assert held == wanted


def test_commands_work_outside_the_checkout(flexarm: Path, tmp_path: Path) -> None:
    """Experiments are found by name, and so are shipped policies and their bounds."""
    assert "leaderboard" in run(flexarm, "--help", folder=tmp_path).stdout
    assert "FlexArm/OneLink-{Reach," in run(flexarm, "arms", folder=tmp_path).stdout
    refused = run(flexarm, "train", "one_link_reach_ppo", "--steps", "0", folder=tmp_path)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1), refused.stderr
    assert "--steps must be between" in refused.stderr
    ranking = ["--tasks", "FlexArm/OneLink-Reach-v0", "--tracks", "state", "--episodes", "2"]
    ranked = run(flexarm, "leaderboard", *ranking, "--controllers", "ppo", folder=tmp_path)
    assert ranked.returncode == 0, ranked.stderr
    assert "regret" in (tmp_path / "leaderboard" / "leaderboard.md").read_text()


@pytest.mark.slow
def test_a_shipped_experiment_is_trained_outside_the_checkout(
    flexarm: Path, tmp_path: Path
) -> None:
    done = run(flexarm, "train", "one_link_reach_ppo", "--steps", "8192", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    run_folder = tmp_path / "runs" / "one_link_reach_ppo" / "seed0"
    assert (run_folder / "arm.gif").is_file()
    finished = run(flexarm, "train", "--resume", str(run_folder), folder=tmp_path)
    assert f"flexarm train --resume {run_folder} --steps 16384" in finished.stdout
