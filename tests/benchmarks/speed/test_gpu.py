"""The benchmark of a GPU, all but the calls of a device: measured on the processor."""

from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks.speed import gpu, kernels
from dynamics.backends.cuda.kernel_text import STEP
from flexarm_env import TorchVecEnv
from flexarm_env.interfaces.tensors.device import DeviceBatch, kernel_source
from tests.host_kernels import COMPILER, HostKernels


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpu, "RESULTS", tmp_path / "results")
    with pytest.raises(SystemExit) as ended:
        gpu.main([])
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith(
        "benchmarks.speed.gpu: needs an NVIDIA GPU and a torch"
    )
    assert not list(tmp_path.iterdir())


def test_a_device_is_measured_and_its_page_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "SCENES", {"OneLink": "one link"})
    monkeypatch.setattr(gpu, "FORMS_SCENE", "OneLink")
    monkeypatch.setattr(gpu, "DTYPES", ("float64",))
    monkeypatch.setattr(gpu, "SECONDS", 1e-3)
    monkeypatch.setattr(gpu, "bandwidth", lambda device: 1e12)
    results: dict[str, Any] = gpu.measure("cpu", batches=(4, 8), batch=4)
    found = results["scenes"]["OneLink"]["float64"]
    assert found["agreement"] == 0.0  # the processor beside itself
    assert all(row["steps_per_second"] > 0.0 for row in found["rates"].values())
    (row,) = results["derivatives"]
    assert row["agreement"] == 0.0
    assert min(row[name] for name in ("step", "record", "pull_back")) > 0.0
    row |= {"step": 3e9, "record": 2e9, "pull_back": 1e9, "agreement": 2e-7}
    found["rates"]["8"] = {"steps_per_second": 2e9, "bytes": 250}
    results |= {
        "gpu": "Name",
        "command": "python -m benchmarks.speed.gpu",
        "multiply_adds": {"x": 1.0},
    }
    results["forms"] = {"as printed": 1.5e8}
    text = gpu.page(results)
    assert "| 2e+09 | 50 % | 0 |" in text
    assert "| as printed | 1.5e+08 |" in text
    assert "| one link | float64 | 3e+09 | 2e+09 | 1e+09 | 2e-07 |" in text


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
def test_forms_of_the_text_are_what_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[str] = []
    changes = {form: kernels.FORMS[form] for form in ("as printed", "restart inlined")}
    monkeypatch.setattr(gpu, "FORMS_SCENE", "OneLink")
    monkeypatch.setattr(gpu, "FORMS", changes)
    monkeypatch.setattr(gpu, "SECONDS", 1e-3)
    monkeypatch.setattr(gpu, "kernels_of", lambda x: compiled.append(x) or HostKernels(x))
    found = gpu.forms("cpu", n=4)
    assert all(rate > 0.0 for rate in found.values())
    assert [changes["restart inlined"](compiled[0])] == compiled[1:]


def test_a_copy_moves_twice_its_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "seconds", lambda call, device: 2.0)
    assert gpu.bandwidth("cpu", size=100) == pytest.approx(400.0)


def test_differences_are_relative_to_numbers_above_one() -> None:
    small, large = torch.tensor([0.0, 0.5]), torch.tensor([0.0, 99.0])
    assert gpu.gap(small, small + 0.3) == pytest.approx(0.3)
    assert gpu.gap(large, large + torch.tensor([0.0, 2.0])) == pytest.approx(0.02)


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
def test_bytes_of_a_step_are_those_of_its_arrays() -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 4)
    batch = DeviceBatch(envs.core, torch.device("cpu"), HostKernels)
    actions = torch.zeros(4, 1)
    moved = [batch.state, batch.state, actions, *batch._run(STEP, actions)]
    assert sum(x.nbytes for x in moved) == 4 * gpu.moved(envs)


def test_every_form_changes_the_text_of_a_kernel() -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 1, dtype="float32")
    text = kernel_source(envs.core).text
    forms = {form: changed(text) for form, changed in kernels.FORMS.items()}
    assert forms.pop("as printed") == text
    assert len({text, *forms.values()}) == len(kernels.FORMS)


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
def test_accelerations_in_pieces_make_the_same_step() -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 4, dtype="float32")
    in_pieces = kernels.FORMS["accelerations in 4 pieces"]
    found = []
    for form in (str, in_pieces):
        batch = DeviceBatch(
            envs.core, torch.device("cpu"), lambda text, form=form: HostKernels(form(text))
        )
        results = batch._run(STEP, torch.full((4, 1), 0.5))
        found.append([batch.state.clone(), *(x.clone() for x in results)])
    assert all(torch.equal(*pair) for pair in zip(*found, strict=True))
    assert found[0][0].abs().max() > 1e-3  # the arm moves
