"""PPO on a GPU, all but the calls of a device: trained on the processor."""

from pathlib import Path

import pytest
import torch

from agents.run_folder.folder import RunFolder
from benchmarks.training import gpu

TASK = "FlexArm/OneLink-Reach-v0"


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpu, "RESULTS", tmp_path)
    with pytest.raises(SystemExit) as ended:
        gpu.main(["--only", TASK])
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        "benchmarks.training.gpu: needs an NVIDIA GPU and a torch with CUDA, which sees none here; "
        "python train.py configs/one_link_reach_ppo.yaml trains without one.\n"
    )
    assert not list(tmp_path.iterdir())


def test_a_training_of_no_time_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        gpu.main(["--seconds", "nan"])
    assert ended.value.code == 2
    assert "--seconds [s] must be a finite number, got nan" in capsys.readouterr().err


def test_a_task_is_trained_judged_and_shown_on_a_page(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl")
    results = gpu.measure([TASK], 1e-3, "cpu", tmp_path, parallel=8)
    (row,) = results["rows"]
    assert row["steps"] == 32 * 8  # a rollout at least
    assert 0.0 <= row["score"] < row["classical_score"]
    config = RunFolder(tmp_path / "OneLink-Reach-v0" / "seed0").read_config()
    assert config.env.kwargs == {"hardware": "laboratory"}
    again = gpu.measure([TASK], 1e3, "cpu", tmp_path, parallel=8)
    assert again["rows"] == [row]  # an ended run stays, whatever a new one could afford
    results |= {"gpu": "Name", "provenance": {"command": "python -m benchmarks.training.gpu"}}
    assert f"| {TASK} | 256 |" in gpu.page(results)


def test_a_training_lasts_as_long_as_its_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rsl_rl")
    clock = iter([10.0, 10.0 + 0.5 * gpu.PROBE])  # [s] before and after the rollouts that count
    monkeypatch.setattr(gpu.time, "perf_counter", lambda: next(clock))
    assert gpu.affordable(TASK, 3.0, "cpu", 8) == 6 * 32 * 8
