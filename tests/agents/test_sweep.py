"""Sweeps with Ray Tune: refusals, one machine, and a cluster that loses a machine."""

import errno
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from agents.config import Config, load_config
from agents.learners.export import export_policy
from agents.policy import load_policy, save_policy
from agents.run_folder.folder import ARM, arm_digest
from agents.sweep.command import SweepError, finish, located, main, run
from agents.sweep.trial import DIVERGED, train_trial
from agents.training import about_policy, build_model
from agents.tune.learners import LOST
from tests.agents.tiny import one_sentence, write_config
from tests.paths import ROOT


def sweep(*arguments: str | Path) -> subprocess.Popen[str]:
    """Start `python -m agents.sweep` with the arguments."""
    return subprocess.Popen(
        [sys.executable, "-m", "agents.sweep", *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | {"RAY_USAGE_STATS_ENABLED": "0", "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ranking(out: Path) -> list[dict[str, Any]]:
    """Trials of a sweep as its results have them by now."""
    path = out / "sweep.json"
    trials: list[dict[str, Any]] = json.loads(path.read_text())["trials"] if path.exists() else []
    return trials


def wait(process: subprocess.Popen[str], reached: Callable[[], bool]) -> None:
    """Wait until a condition holds, while the process runs."""
    deadline = time.monotonic() + 600.0
    while not reached():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "not reached after ten minutes"
        time.sleep(0.1)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "an experiment file is needed"),
        (["none.yaml"], "there is no such file"),
        (["one_link_reach_pp"], "Did you mean 'one_link_reach_ppo'?"),
        (["CONFIG", "--trials", "0"], "--trials must be between 1 and 10_000, got 0"),
        (["CONFIG", "--steps", "0"], "total_steps must be between 1 and"),
        (["--resume", "none"], "none holds no sweep to resume; begin one by CONFIG --out none"),
        (["--resume", "none", "--trials", "9"], "--trials 9 is for a new sweep, and --resume"),
        (["--resume", "none", "--trials", "20"], "--trials 20 is for a new sweep"),
        (["--resume", "none", "--keep-all"], "--keep-all is for a new sweep"),
        (["CONFIG", "--resume", "none"], "is for a new sweep"),
        (["CONFIG", "--address", "first"], "--address must be HOST:PORT or auto, got 'first'"),
        (["CONFIG", "--address", "first:99999"], "--address must be HOST:PORT or auto"),
    ],
)
def test_unusable_requests_are_refused_in_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agents.sweep.command.require_ray", lambda: None)
    config = str(write_config(tmp_path, "ppo", 256))
    assert main([config if x == "CONFIG" else x for x in arguments]) == 2
    assert sentence in one_sentence(capsys)
    assert [path.suffix for path in tmp_path.iterdir()] == [".yaml"]


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders in which a sweep would begin, without Ray and without compiling."""
    begun: list[Path] = []
    monkeypatch.setattr("agents.sweep.command.require_ray", lambda: None)
    monkeypatch.setattr("agents.sweep.command.prepare", lambda config, warm: None)
    monkeypatch.setattr("agents.sweep.command.run", lambda out, *more: begun.append(out))
    return begun


def test_a_sweep_with_no_cluster_at_its_address_ends_within_seconds_and_leaves_no_folder(
    planned: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, config = tmp_path / "out", str(write_config(tmp_path, "ppo", 256))
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{listener.getsockname()[1]}"  # bound, and nobody listens
        begin = time.monotonic()
        assert main([config, "--address", address, "--out", str(out)]) == 2
        assert time.monotonic() - begin < 10.0
        assert f"nothing listens at --address {address}" in one_sentence(capsys)
        assert not out.exists()
        listener.listen()
        assert main([config, "--address", address, "--out", str(out)]) == 0
    assert planned == [out]
    for rays_own in ("auto", "ray://127.0.0.1:1"):
        assert main([config, "--address", rays_own, "--out", str(tmp_path / rays_own[:4])]) == 0


def test_a_folder_is_free_until_its_sweep_began(
    planned: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A refused --out points to --resume where that would go on, and there alone."""
    out, config = tmp_path / "out", str(write_config(tmp_path, "ppo", 256))
    arguments = [config, "--out", str(out)]
    assert main(arguments) == 0
    assert [path.name for path in out.glob("[a-z]*")] == ["config.yaml"]
    assert main(["--resume", str(out)]) == 2
    assert f"begin one by CONFIG --out {out}" in one_sentence(capsys)
    assert main([*arguments, "--steps", "512"]) == 0
    assert planned == [out, out]
    (out / "config.yaml").write_text(Path(config).read_text() + "# mine\n")
    assert main(arguments) == 2
    assert "is not empty and holds no sweep; choose another --out." in one_sentence(capsys)
    assert (out / "config.yaml").read_text().endswith("# mine\n")
    (out / "tune").mkdir()
    assert main(arguments) == 2
    assert f"is not empty; choose another --out, or --resume {out}" in one_sentence(capsys)
    assert main(["--resume", str(out)]) == 0
    assert planned == [out, out, out]


def test_workers_in_other_folders_find_the_arm_and_the_warm_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.yaml").touch()
    monkeypatch.chdir(tmp_path)
    for given, found in (
        ("mine.yaml", str(tmp_path / "mine.yaml")),
        (str(tmp_path / "mine.yaml"), str(tmp_path / "mine.yaml")),
        ("slim", "slim"),
    ):
        config = load_config(write_config(tmp_path, "ppo", 256, kwargs={"arm": given}))
        assert located(config).env.kwargs == {"arm": found}
        assert located(config).env.id == config.env.id
    plain = load_config(write_config(tmp_path, "ppo", 256))
    assert located(plain) == plain
    for given, found in (("a/b", str(tmp_path / "a" / "b")), ("one_link_reach_ppo",) * 2):
        warm = replace(plain, agent=replace(plain.agent, warm_start=given))
        assert located(warm).agent.warm_start == found


def test_a_sweep_follows_no_arm_file_that_has_changed_since_it_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config, planned = load_config(write_config(tmp_path, "ppo", 64)), []
    policy = export_policy(build_model(config), about_policy(config))
    arm = tmp_path / "mine.yaml"
    arm.write_text("links: []")
    kwargs = {"arm": str(arm)}
    about = policy.about | {"env_kwargs": kwargs, ARM: arm_digest(kwargs)}
    folder = tmp_path / "out" / "tune" / "trial" / "checkpoint_000000" / "policy"
    save_policy(replace(policy, about=about), folder)
    monkeypatch.setattr("agents.sweep.command.require_ray", lambda: None)
    monkeypatch.setattr("agents.sweep.command.run", lambda *given: planned.append(given))
    assert main(["--resume", str(tmp_path / "out")]) == 0
    arm.write_text("links: [{}]")
    assert main(["--resume", str(tmp_path / "out")]) == 2
    assert f"{arm}: has changed since the training of the policy began" in one_sentence(capsys)
    assert len(planned) == 1


@pytest.mark.parametrize(
    ("end", "status", "sentence"),
    [
        (KeyboardInterrupt(), 130, "interrupted; go on by --resume"),
        (BrokenPipeError(), 1, "nobody reads the output; go on by --resume"),
        (OSError(errno.ENOSPC, "No space left on device"), 1, "left on device; go on by --resume"),
        (ConnectionError("refused"), 1, "no cluster at None (refused)"),
    ],
)
def test_a_sweep_that_ends_early_says_why_and_how_it_goes_on(
    end: BaseException,
    status: int,
    sentence: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def ended(*given: Any) -> None:
        raise end

    monkeypatch.setattr("agents.sweep.command.start", ended)
    assert main(["one_link_reach_ppo"]) == status
    assert sentence in one_sentence(capsys)


def test_a_missing_ray_is_named_with_the_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray.tune", None)
    assert main([str(write_config(tmp_path, "ppo", 256))]) == 2
    assert 'pip install -c constraints.txt -e ".[scale]"' in one_sentence(capsys)


def test_without_an_address_a_sweep_joins_no_cluster_that_happens_to_run_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ray itself would join it; only RAY_ADDRESS, as in jobs of a cluster, stands for --address."""
    joined = []

    def init(address: str, **_: Any) -> None:
        joined.append(address)
        raise ConnectionError

    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(init=init, tune=None))
    monkeypatch.setitem(sys.modules, "agents.sweep.progress", SimpleNamespace(Ranking=None))
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    for address in (None, "cluster:6379"):
        with pytest.raises(ConnectionError):
            run(tmp_path, address, [])
    monkeypatch.setenv("RAY_ADDRESS", "job:6379")
    with pytest.raises(ConnectionError):
        run(tmp_path, None, [])
    assert joined == ["local", "cluster:6379", "job:6379"]


def reports_of(
    config: Config, monkeypatch: pytest.MonkeyPatch, checkpoint: Any = None
) -> list[dict[str, Any]]:
    """Reports of a trial to Ray, which need not be installed."""
    entries: list[dict[str, Any]] = []
    tune = SimpleNamespace(
        get_checkpoint=lambda: checkpoint,
        report=lambda entry, checkpoint=None: entries.append(entry),
        Checkpoint=SimpleNamespace(from_directory=lambda folder: None),
    )
    context = SimpleNamespace(get_node_id=lambda: "here")
    ray = SimpleNamespace(tune=tune, get_runtime_context=lambda: context)
    monkeypatch.setitem(sys.modules, "ray", ray)
    train_trial({"planned": {"experiment": config.to_dict()}})
    return entries


def test_a_trial_whose_checkpoint_is_damaged_begins_anew_with_its_warm_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_config(tmp_path, "ppo", 64)
    config = load_config(path)
    policy = export_policy(build_model(config), about_policy(config))
    save_policy(replace(policy, biases=(*policy.biases[:-1], policy.biases[-1] + 0.5)), tmp_path)
    config = replace(config, agent=replace(config.agent, warm_start=str(tmp_path)))
    (tmp_path / "damaged" / "step_000000000128").mkdir(parents=True)
    damaged = SimpleNamespace(as_directory=lambda: nullcontext(tmp_path / "damaged"))
    assert reports_of(config, monkeypatch, damaged) == reports_of(config, monkeypatch)


def test_a_trial_that_diverges_ends_with_a_report_and_is_not_trained_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ray would repeat a trial that raises, which diverges again."""

    def diverging(config: Config) -> Any:
        model = build_model(config)
        model.policy.value_net.bias.data.fill_(np.nan)
        return model

    monkeypatch.setattr("agents.sweep.trial.build_model", diverging)
    (entry,) = reports_of(load_config(write_config(tmp_path, "ppo", 128)), monkeypatch)
    assert entry == LOST | {DIVERGED: True, "steps": 128, "restarts": 0, "node": "here"}
    only = SimpleNamespace(metrics=entry)
    with pytest.raises(SweepError, match=r"all trials of .* have diverged"):
        finish(tmp_path, [only])


def test_a_sweep_that_has_moved_is_ranked_where_it_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ray stores the object that ranks with the sweep, before it moves."""
    monkeypatch.setitem(sys.modules, "ray.tune", SimpleNamespace(Callback=object))
    monkeypatch.setitem(sys.modules, "agents.sweep.progress", None)
    del sys.modules["agents.sweep.progress"]  # imported anew, and removed after the test
    progress = import_module("agents.sweep.progress")
    ranked = progress.Ranking("sweep.json")
    experiment = {"agent": {"kwargs": {"gamma": 0.9}}, "total_steps": 64}
    results = {3: {"steps": 64, "objective": 0.5}, 4: {"steps": 64} | LOST | {DIVERGED: True}}
    trials = [
        SimpleNamespace(
            config={"planned": {"number": number, "experiment": experiment}},
            status="TERMINATED",
            last_result=result,
            storage=SimpleNamespace(experiment_fs_path=str(tmp_path / "tune")),
        )
        for number, result in results.items()
    ]
    ranked.write(trials)
    states = [(t["trial"], t["state"]) for t in ranking(tmp_path)]
    assert states == [(3, "done"), (4, DIVERGED)]


@pytest.mark.slow
def test_a_killed_sweep_resumes_and_names_a_best_that_trains(tmp_path: Path) -> None:
    """No trial falls behind what it had reached before the kill; the rest is trained.

    The folder may have moved.
    """
    pytest.importorskip(
        "ray", reason='needs the extra: pip install -c constraints.txt -e ".[scale]"'
    )
    out, config = tmp_path / "out", write_config(tmp_path, "ppo", 8_000)
    data = yaml.safe_load(config.read_text())
    data["sweep"] = {"gamma": {"between": [0.9, 0.99]}}
    config.write_text(yaml.safe_dump(data))
    process = sweep(config, "--trials", "5", "--out", out)
    wait(process, lambda: any(t["state"] != "unfinished" for t in ranking(out)))
    process.kill()
    process.communicate()
    before = {t["trial"]: t for t in ranking(out) if t["state"] != "unfinished"}
    out = out.rename(tmp_path / "moved")

    output, error = sweep("--resume", out).communicate()
    assert "Best: score" in output, error
    after = {t["trial"]: t for t in ranking(out)}
    assert sorted(after) == list(range(5))
    assert all(t["state"] in ("done", "stopped early") for t in after.values())
    for number, trial in before.items():  # one stopped just before the kill may go on
        assert after[number]["kwargs"] == trial["kwargs"]
        assert after[number]["steps"] >= trial["steps"]
        if after[number]["steps"] == trial["steps"]:
            assert after[number]["objective"] == trial["objective"]
    best = load_config(out / "best.yaml")
    first = max(after.values(), key=lambda t: t["objective"])
    assert best.agent.kwargs == first["kwargs"]
    assert load_policy(out / "policy").about["steps"] == first["steps"]


@pytest.mark.slow
def test_a_cluster_that_loses_a_machine_loses_nothing_that_was_finished(tmp_path: Path) -> None:
    """Two nodes with one core each; one is killed while a trial trains on it."""
    pytest.importorskip(
        "ray", reason='needs the extra: pip install -c constraints.txt -e ".[scale]"'
    )
    from ray.cluster_utils import Cluster

    soon = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500}
    node = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
    cluster = Cluster(
        initialize_head=True,
        head_node_args=node | {"include_dashboard": False, "_system_config": soon},
    )
    try:
        worker = cluster.add_node(**node)
        cluster.wait_for_nodes()
        out, config = tmp_path / "out", write_config(tmp_path, "ppo", 12_000)
        process = sweep(
            config, "--trials", "5", "--address", cluster.address, "--keep-all", "--out", out
        )

        def half_way() -> bool:
            done = [t for t in ranking(out) if t["state"] == "done"]
            there = [t for t in ranking(out) if t.get("node") == worker.node_id]
            return bool(done) and any(2_000 < t["steps"] < 8_000 for t in there)

        wait(process, half_way)
        before = {t["trial"]: t for t in ranking(out) if t["state"] == "done"}
        cluster.remove_node(worker, allow_graceful=False)
        output, error = process.communicate(timeout=600)
        assert process.returncode == 0, error
    finally:
        cluster.shutdown()
    after = {t["trial"]: t for t in ranking(out)}
    assert sorted(after) == list(range(5))
    assert all(t["state"] == "done" for t in after.values()), after
    assert {number: after[number] for number in before} == before
    assert sum(t["restarts"] for t in after.values()) == 1
    assert "lost for good" not in output
