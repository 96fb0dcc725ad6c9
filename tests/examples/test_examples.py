"""Every shipped example runs from its first line to its last in a short form."""

import importlib.util
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

from tests.paths import ROOT

HERE = ("sb3_ppo", "sb3_contrib_trpo", "cleanrl_ppo")  # need no further library
STRAIN = "least_strain"
SHORT = ("--steps", "256", "--episodes", "2")
APART = {  # script and arguments: libraries that it needs
    ("torchrl_ppo", *SHORT): ("tensordict", "torchrl"),
    ("rsl_rl_ppo", *SHORT): ("rsl_rl",),
    ("skrl_ppo", *SHORT): ("skrl",),
    ("rllib_ppo", *SHORT, "--single"): ("ray", "tree"),
    ("rllib_ppo", *SHORT): ("ray", "tree"),
    ("ray_tune", "--steps", "256", "--trials", "2"): ("ray",),
}
ROW = re.compile(r"│ [^│]*│ +\d+ % │ +\d\.\d{3} │")  # success and score of a table


def require(*libraries: str) -> None:
    """Skip the test if a library is missing, and say how to get it."""
    for library in libraries:
        if importlib.util.find_spec(library) is None:
            pytest.skip(
                f'{library} is not installed: pip install -c constraints.txt -e ".[examples]"'
            )


def finished(command: Sequence[str], folder: Path) -> str:
    """Output of a command that must succeed within ten minutes."""
    environment = os.environ | {"RAY_USAGE_STATS_ENABLED": "0", "COLUMNS": "120"}
    environment["PYTHONPATH"] = str(ROOT)
    environment["RAY_ADDRESS"] = "local"  # not the cluster of another test
    result = subprocess.run(
        [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True,
        timeout=600,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr[-3000:]
    return result.stdout


@pytest.mark.parametrize("name", HERE)
def test_an_example_trains_and_prints_its_result(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [name, *SHORT])
    monkeypatch.setenv("COLUMNS", "120")
    threads = torch.get_num_threads()
    runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")
    torch.set_num_threads(threads)
    assert ROW.search(capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.parametrize("command", APART, ids=" ".join)
def test_an_example_of_another_library_trains_and_prints_its_result(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    require(*APART[command])
    out = finished([str(ROOT / "examples" / f"{command[0]}.py"), *command[1:]], tmp_path)
    assert ROW.search(out) or re.search(r"^best score \d\.\d{3} with \{'learning_rate'", out, re.M)


@pytest.mark.parametrize(("name", "libraries"), {c[0]: APART[c] for c in APART}.items())
def test_an_example_without_its_library_names_the_extra(
    name: str, libraries: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, libraries[0], None)
    with pytest.raises(ModuleNotFoundError, match=rf"{name}.py needs {libraries[0]}\b.* -e "):
        runpy.run_path(str(ROOT / "examples" / f"{name}.py"))


@pytest.mark.slow
def test_a_failure_in_the_last_step_is_no_time_out_for_rsl_rl(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    require("rsl_rl")
    example = runpy.run_path(str(ROOT / "examples" / "rsl_rl_ppo.py"))
    short = {"max_episode_steps": 1, "deflection_limit": 1e-6}
    for keywords, late in (({"max_episode_steps": 1}, 1.0), (short, 0.0)):
        monkeypatch.setitem(example["Arms"].__init__.__globals__, "KEYWORDS", keywords)
        arms = example["Arms"]("cpu")
        _, _, ended, extras = arms.step(torch.ones(arms.num_envs, 1))
        assert ended.all()
        assert (extras["time_outs"] == late).all()


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_rl_zoo_trains_with_the_shipped_settings(algorithm: str, tmp_path: Path) -> None:
    require("rl_zoo3")
    settings = str(ROOT / "configs" / "rl_zoo" / f"{algorithm}.yml")
    command = ["-m", "rl_zoo3.train", "--algo", algorithm, "--env", "FlexArm/OneLink-Reach-v0"]
    command += ["--gym-packages", "flexarm_env", "-conf", settings, "--eval-freq", "-1"]
    finished([*command, "-n", "256", "-f", str(tmp_path)], tmp_path)
    assert list(tmp_path.rglob("FlexArm-OneLink-Reach-v0.zip"))


@pytest.mark.slow
def test_the_shortest_example_learns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every episode settles after the training that the script asks for by default."""
    monkeypatch.setattr(sys, "argv", ["cleanrl_ppo"])
    monkeypatch.setenv("COLUMNS", "120")
    runpy.run_path(str(ROOT / "examples" / "cleanrl_ppo.py"), run_name="__main__")
    row = ROW.search(capsys.readouterr().out)
    assert row is not None
    assert "100 %" in row[0]


@pytest.mark.slow
def test_the_move_of_least_strain_bends_less_and_ends_still(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the single environment, for a second after the move."""
    monkeypatch.setattr(sys, "argv", [STRAIN])
    monkeypatch.setenv("COLUMNS", "120")
    runpy.run_path(str(ROOT / "examples" / f"{STRAIN}.py"), run_name="__main__")
    out = capsys.readouterr().out
    numbers = r"[^│]*│ *([^ ]+) *│ *([^ ]+)"
    rows = [re.findall(name + numbers, out)[0] for name in ("largest curvature", "curvature after")]
    (torque, strain), after = (tuple(map(float, row)) for row in rows)
    assert strain < 0.8 * torque
    assert max(after) < 1e-6


def test_every_example_is_tested_and_shown() -> None:
    names = {path.stem for path in (ROOT / "examples").glob("*.py")}
    assert names == {*HERE, *(command[0] for command in APART), STRAIN}
    pages = [ROOT / "docs" / name for name in ("libraries.md", "gradients.md")]
    shown = "".join(page.read_text(encoding="utf-8") for page in pages)
    for name in names:
        assert f"examples/{name}.py" in shown
