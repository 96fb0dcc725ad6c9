"""Small complete runs: their files, their refusals, and resuming after a kill."""

import csv
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agents.evaluate import find_env
from agents.evaluate import main as evaluate
from agents.run_folder.checkpoints import list_checkpoints
from agents.run_folder.folder import RunFolder
from agents.training import main as train
from tests.agents.tiny import ENV_ID, ROOT, train_py, wait_for_steps, write_config


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A finished run."""
    folder = tmp_path_factory.mktemp("run")
    out = folder / "out"
    assert train(["--config", str(write_config(folder, "ppo", 1024)), "--out", str(out)]) == 0
    return RunFolder(out)


def test_a_run_writes_all_its_files(run: RunFolder) -> None:
    files = {str(f.relative_to(run.path)) for f in run.path.rglob("*") if f.is_file()}
    expected = "config.yaml versions.json metrics.jsonl metrics.csv evaluation.json evaluation.csv"
    expected += " learning_curve.png trajectories.png arm.gif replay.html pd_gains.json"
    expected += " policy/policy.json policy/weights.npz untrained/policy.json"
    assert set(expected.split()) <= files
    assert any(name.startswith("tensorboard/events.out") for name in files)
    assert json.loads((run.path / "versions.json").read_text())["seed"] == 0
    with open(run.path / "evaluation.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [r["controller"] for r in rows[::3]] == [
        "trained policy",
        "joint PD",
        "untrained policy",
        "pd-zv",
        "lqr",
    ]


def test_no_file_of_a_run_needs_unpickling(run: RunFolder) -> None:
    """Neither pickles nor zips of stable-baselines3: arrays and text only."""
    files = [f for f in run.path.rglob("*") if f.is_file() and "events" not in f.name]
    suffixes = {f.suffix for f in files if f.name not in (".lock", "SHA256SUMS")}
    assert suffixes <= {".yaml", ".json", ".jsonl", ".csv", ".npz", ".png", ".gif", ".html"}


def test_evaluation_is_deterministic(run: RunFolder, tmp_path: Path) -> None:
    texts = []
    for name in ("a", "b"):
        arguments = [str(run.path), "--env", ENV_ID, "--episodes", "3", "--seed", "5"]
        assert evaluate([*arguments, "--out", str(tmp_path / name)]) == 0
        texts.append((tmp_path / name / "evaluation.json").read_text())
    assert texts[0] == texts[1]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nothing", "--env", ENV_ID], "Unknown run or controller 'nothing'. Give a run's folder"),
        (["pdd", "--env", ENV_ID], "did you mean 'pd'?"),
        (["x" * 300, "--env", ENV_ID], "x" * 300),  # as without permission: no fault of --out
        (["pd", "--env", "FlexArm/NoSuch-Reach-v0"], "NoSuch"),
        (["pd"], "--env is needed, such as --env FlexArm/"),
        (
            ["pd", "--env", ENV_ID, "--episodes", "0"],
            "--episodes must be between 1 and 10_000, got 0",
        ),
        (["pd", "--env", ENV_ID, "--seed", "-1"], "--seed must be between 0 and"),
        (["pd", "--env", ENV_ID, "--env-kwargs", "{no_such: 1}"], "Unknown key 'no_such'"),
        (["pd", "--env", ENV_ID, "--env-kwargs", "{obs: [}"], "--env-kwargs must be a YAML table"),
        (["pd", "--env", ENV_ID, "--env-kwargs", "{obs: sensor}"], "sensor"),
        (
            ["zero", "--env", ENV_ID, "--env-kwargs", "{max_episode_steps: -1}"],
            "--env-kwargs.max_episode_steps must be a number of control steps, got -1",
        ),
        (["pd", "--env", ENV_ID, "--env-kwargs", "[" * 9999], "--env-kwargs must be a YAML table"),
        (["lqr", "--env", ENV_ID, "--env-kwargs", "{torque_limit: 0.5}"], "lqr was not tuned"),
        (
            ["lqr", "--env", ENV_ID, "--env-kwargs", "{hardware: laboratory}"],
            "{'hardware': 'laboratory'}; use lqg, which was, or pd, whose gains are searched here",
        ),
        (["lqg", "--env", ENV_ID.replace("Reach", "Track")], "lqg was not tuned"),
        (["zero", "--env", ENV_ID.replace("Reach", "ReachGoal")], "has dicts as observations"),
        ([str(ROOT / "configs"), "--env", ENV_ID], "holds no policy.json"),
        ([str(ROOT / "train.py"), "--env", ENV_ID], "is no zip of stable-baselines3"),
    ],
)
def test_bad_command_lines_end_with_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate([*arguments, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_environments_of_a_users_module_in_the_present_folder_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also by the script `flexarm`, which has no present folder among its places of modules."""
    (tmp_path / "my_lab.py").write_text(
        "import gymnasium as gym\nimport flexarm_env\n"
        "keywords = flexarm_env.IDS['FlexArm/OneLink-Reach-v0']['kwargs']\n"
        "gym.register('MyLab/Slim-v0', vector_entry_point=flexarm_env.FlexArmVectorEnv,\n"
        "             entry_point=flexarm_env.FlexArmEnv, max_episode_steps=9, kwargs=keywords)\n"
        "gym.register('MyLab/Endless-v0', vector_entry_point=flexarm_env.FlexArmVectorEnv,\n"
        "             kwargs=keywords)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [x for x in sys.path if x not in ("", ".")])
    arguments = ["--episodes", "1", "--out", "out"]
    assert evaluate(["zero", "--env", "my_lab:MyLab/Slim-v0", *arguments]) == 0
    assert (tmp_path / "out" / "evaluation.json").is_file()
    assert evaluate(["zero", "--env", "no_lab:MyLab/Slim-v0", *arguments]) == 2
    assert "no_lab" in capsys.readouterr().err
    assert evaluate(["zero", "--env", "my_lab:MyLab/Endless-v0", *arguments]) == 2
    assert "give max_episode_steps" in capsys.readouterr().err


def test_a_folder_of_runs_names_one_and_a_file_of_a_policy_stands_for_it(
    run: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path), "--episodes", "1"]
    assert evaluate([str(run.path.parent), *out]) == 2
    assert (
        f"holds runs, not a policy; name one of them, such as {run.path}" in capsys.readouterr().err
    )
    assert not any(tmp_path.iterdir())
    assert evaluate([str(run.policy / "policy.json"), *out]) == 0
    assert (tmp_path / "evaluation.json").is_file()


def test_an_evaluation_never_replaces_that_of_a_run(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in run.path.glob("*.*")}
    assert evaluate([str(run.path), "--episodes", "1", "--out", str(run.path)]) == 2
    assert "choose another --out" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in run.path.glob("*.*")} == before


def test_given_keywords_are_not_called_those_of_the_training(
    run: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--env-kwargs", "{max_episode_steps: 20}", "--episodes", "1", "--out", str(tmp_path)]
    assert evaluate([str(run.path), *given]) == 0
    assert "of the training" not in capsys.readouterr().out


def test_the_output_folder_is_checked_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert evaluate(["nothing", "--out", str(tmp_path / "file")]) == 2
    assert "cannot be written to" in capsys.readouterr().err
    assert train(["--out", str(tmp_path)]) == 2
    assert "is not empty" in capsys.readouterr().err


def test_training_refuses_bad_requests(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, sentence in (
        (["--resume", str(tmp_path)], "is not a run"),
        (["--config", str(tmp_path / "none.yaml")], "there is no such file"),
        (["--steps", "0"], "--steps must be between 1 and 100_000_000_000, got 0"),
        (["--resume", str(tmp_path), "--seed", "1"], "--resume allows only --steps"),
        (["one_link_reach_distilled", "--steps", "99"], "must be below total_steps (99)"),
    ):
        assert train(arguments) == 2
        assert sentence in capsys.readouterr().err


def test_a_finished_run_is_reported_and_unchanged(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    def files() -> dict[Path, tuple[int, bytes]]:
        paths = [path for path in run.path.rglob("*") if path.is_file() and path.name != ".lock"]
        return {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in paths}

    before = files()
    for arguments in ([], ["--steps", "1024"], ["--steps", "5"]):
        assert train(["--resume", str(run.path), *arguments]) == 0
        said = capsys.readouterr().out
        assert "is finished at 1,024 steps" in said
        assert f"python train.py --resume {run.path} --steps 2048" in said
    assert files() == before


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_a_killed_run_resumes_and_loses_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], unjudged: list[RunFolder]
) -> None:
    """After SIGKILL and --resume every logged row is still there, the steps continue from the last
    checkpoint, and the run reaches its last step and its evaluation."""
    total = 6000 if name == "sac" else 120_000
    run = RunFolder(tmp_path / "out")
    process = train_py("--config", write_config(tmp_path, name, total), "--out", run.path)
    wait_for_steps(process, run, 256)
    process.kill()
    process.communicate()
    before = run.log.read_text(encoding="utf-8")
    checkpoint = int(list_checkpoints(run.checkpoints)[-1].name.removeprefix("step_"))
    assert 0 < checkpoint < total, "the kill came too late to show anything"

    steps = checkpoint + 2000 if name == "ppo" else checkpoint + 200
    assert train(["--resume", str(run.path), "--steps", str(steps)]) == 0
    assert f"Resuming at {checkpoint:,}" in capsys.readouterr().out
    assert [judged.path for judged in unjudged] == [run.path]

    after = run.log.read_text(encoding="utf-8")
    assert after.startswith(before)
    new = [row for row in run.rows() if row["session"] == 1]
    assert new[0]["steps"] > checkpoint
    assert new[-1]["steps"] >= steps
    curve = [row["steps"] for row in run.curve()]
    assert curve == sorted(set(curve))
    assert (run.policy / "policy.json").is_file()


def test_keywords_of_a_training_count_only_without_an_id() -> None:
    about = {"env_id": ENV_ID, "env_kwargs": {"control_dt": 0.01}}
    policy: Any = SimpleNamespace(about=about)
    assert find_env(policy, None, None) == (ENV_ID, {"control_dt": 0.01})
    assert find_env(policy, ENV_ID, None) == (ENV_ID, {})
    assert find_env(policy, None, {"obs": "sensors"}) == (ENV_ID, {"obs": "sensors"})
    assert find_env(policy, "FlexArm/OneLink-Damp-v0", None) == ("FlexArm/OneLink-Damp-v0", {})
