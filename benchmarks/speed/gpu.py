"""Control steps on a GPU and their derivatives: rates, bandwidth, multiply-add peak, agreement.

    python -m benchmarks.speed.gpu

Needs an NVIDIA GPU with the extra `gpu`. An estimate of its time is under four minutes: 150 s of
compilation and 30 s of rates. Batches of Reach take random actions, and ended episodes restart.
Agreement is the largest difference from the processor over 40 steps, relative to numbers above 1;
that of the gradient of their rewards is relative to its largest number.
Writes docs/results/gpu_NAME.json and .md, where NAME is that of the GPU.
"""

import argparse
import re
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from benchmarks.output import RESULTS, argument_parser, paragraphs, provenance, save_results, table
from benchmarks.speed import kernels
from benchmarks.speed.kernels import DTYPES, SCENES
from dynamics.backends.cuda.function_text import prelude
from flexarm_env import TorchVecEnv
from flexarm_env.compiled.termination import FLAGS
from flexarm_env.interfaces.tensors.device import DeviceBatch

BATCHES = tuple(2**k for k in (12, 14, 16, 18, 20))
FOLLOWED, STEPS, EPISODE = 20, 40, 15  # environments, steps and steps of an episode, for agreement
RUNS, SECONDS = 5, 0.1  # of one measurement, and the least time of a run
BATCH = 2**16  # environments, for derivatives and forms
FORMS_SCENE = "SixLink"  # the scene that spills
FORMS = {
    form: kernels.FORMS[form]
    for form in (
        "as printed",
        "all functions called",
        "accelerations in 4 pieces",
        "spills in shared memory",
    )
}
SPARED = (("SixLink", "float64"),)  # whose derivatives take minutes to compile
CHAINS, ROUNDS = 16, 4096  # of multiply-adds in a thread
THREADS = 2**18


def seconds(call: Callable[[], Any], device: str) -> float:
    """Median time of a call [s], of runs of many calls."""

    def run(times: int) -> float:
        synchronize(device)
        begin = time.perf_counter()
        for _ in range(times):
            call()
        synchronize(device)
        return (time.perf_counter() - begin) / times

    run(3)
    times = max(1, round(SECONDS / run(3)))
    return statistics.median(run(times) for _ in range(RUNS))


def synchronize(device: str) -> None:
    """Wait for a GPU."""
    if device == "cuda":
        torch.cuda.synchronize()


def env_id(scene: str) -> str:
    """Id of a scene's Reach."""
    return f"FlexArm/{scene}-Reach-v0"


def agreement(scene: str, dtype: str, device: str) -> float:
    """Largest difference from the processor, over the ends of episodes."""
    keywords = {"dtype": dtype, "max_episode_steps": EPISODE}
    batches = [TorchVecEnv(env_id(scene), FOLLOWED, x, **keywords) for x in ("cpu", device)]
    gaps = [gap(*(envs.reset(seed=0)[0] for envs in batches))]
    torch.manual_seed(0)
    for _ in range(STEPS):
        actions = 2.0 * torch.rand(FOLLOWED, batches[0].single_action_space.shape[0]) - 1.0
        results = [envs.step(actions.to(envs.device)) for envs in batches]
        gaps += [gap(*(result[k] for result in results)) for k in (0, 1)]
        gaps.append(gap(*(envs.privileged() for envs in batches)))
    return max(gaps)


def gap(expected: torch.Tensor, found: torch.Tensor) -> float:
    """Largest difference, relative to numbers above 1."""
    found = found.to(expected)
    return float(((found - expected).abs() / (1.0 + expected.abs())).max())


def rate(
    scene: str, dtype: str, device: str, n: int, form: Callable[[str], str] | None = None
) -> dict[str, float]:
    """Control steps per second of a batch of n, and bytes that one moves.

    `form` changes the text of the kernels.
    """
    envs = TorchVecEnv(env_id(scene), n, device, dtype=dtype)
    if form is not None:
        envs._batch = DeviceBatch(envs.core, envs.device, lambda text: kernels_of(form(text)))
    envs.reset()
    actions = 2.0 * torch.rand(n, envs.single_action_space.shape[0], device=device) - 1.0
    found = n / seconds(lambda: envs.step(actions), device)
    return {"steps_per_second": found, "bytes": moved(envs)}


def kernels_of(text: str) -> Any:
    """Kernels of a text on the present GPU."""
    from dynamics.backends.cuda.compiler import Kernels

    return Kernels(text, torch.cuda.current_device())


def gradient_agreement(scene: str, dtype: str, device: str) -> float:
    """Largest difference of the gradient of rewards by actions, relative to its largest number."""
    found = []
    for on in ("cpu", device):
        torch.manual_seed(0)
        envs = TorchVecEnv(
            env_id(scene), FOLLOWED, on, True, dtype=dtype, max_episode_steps=EPISODE
        )
        size = (STEPS, FOLLOWED, envs.single_action_space.shape[0])
        actions = (2.0 * torch.rand(size) - 1.0).to(on).requires_grad_()
        envs.reset(seed=0)
        total = torch.stack([envs.step(action)[1].sum() for action in actions]).sum()
        found.append(torch.autograd.grad(total, actions)[0].cpu())
    return float((found[1] - found[0]).abs().max() / found[0].abs().max())


def derivatives(scene: str, dtype: str, device: str, n: int) -> dict[str, float]:
    """Recorded steps and steps taken back per second of a batch of n, and agreement."""
    envs: Any = TorchVecEnv(env_id(scene), n, device, True, dtype=dtype)
    envs.reset(seed=0)
    made, state = envs._batch._derivatives, envs.detach().detach()
    actions = 2.0 * torch.rand(n, envs.single_action_space.shape[0], device=device) - 1.0
    after, obs, info, flags, stack = made.record(state, actions)
    given = (flags[0], state, actions, stack, *(torch.ones_like(x) for x in (after, obs, info)))
    return {
        "record": n / seconds(lambda: made.record(state, actions), device),
        "pull_back": n / seconds(lambda: made.pull_back(*given), device),
        "agreement": gradient_agreement(scene, dtype, device),
    }


def forms(device: str, n: int = BATCH) -> dict[str, float]:
    """Control steps per second of the scene of FORMS_SCENE by form of the text, in float32."""
    found = {form: rate(FORMS_SCENE, "float32", device, n, f) for form, f in FORMS.items()}
    return {form: row["steps_per_second"] for form, row in found.items()}


def moved(envs: TorchVecEnv) -> int:
    """Bytes that the step of one environment reads and writes: state, actions and all results."""
    core = envs.core
    numbers = 2 * core.signals.state.total + core.signals.info.total
    singles = core.arm.n_torque + 2 * core.layout.size
    return int(numbers * np.dtype(core.model.dtype).itemsize + 4 * singles + len(FLAGS))


def bandwidth(device: str, size: int = 2**28) -> float:
    """Bytes per second that a copy reads and writes."""
    a, b = (torch.zeros(size, device=device) for _ in range(2))
    return 2.0 * a.nbytes / seconds(lambda: a.copy_(b), device)


def peak_text(dtype: str) -> str:
    """Kernel `chains` of independent multiply-adds."""
    names = [f"x{k}" for k in range(CHAINS)]
    starts = ", ".join(f"{name} = real(i + {k})" for k, name in enumerate(names))
    lines = [f"{name} = {name} * a + b;" for name in names]
    return "\n".join([
        prelude(dtype),
        'extern "C" __global__ void chains(real* out, real a, real b, int rounds)',
        "{",
        "    const int i = blockIdx.x * blockDim.x + threadIdx.x;",
        f"    real {starts};",
        "    #pragma unroll 8",
        f"    for (int r = 0; r < rounds; ++r) {{ {' '.join(lines)} }}",
        f"    out[i] = {' + '.join(names)};",
        "}",
    ]) + "\n"  # fmt: skip


def multiply_adds(dtype: str) -> float:
    """Operations per second of the GPU's multiply-adds, two each."""
    compiled = kernels_of(peak_text(dtype))
    out = torch.zeros(THREADS, dtype=getattr(torch, dtype), device="cuda")
    factors = np.array([0.999, 0.001], dtype)
    given = [np.uint64(out.data_ptr()), *factors, np.int32(ROUNDS)]
    stream = int(torch.cuda.current_stream().cuda_stream)
    taken = seconds(lambda: compiled.launch("chains", stream, THREADS, given), "cuda")
    return 2.0 * THREADS * CHAINS * ROUNDS / taken


def measure(device: str, batches: Sequence[int] = BATCHES, batch: int = BATCH) -> dict[str, Any]:
    """Everything but the multiply-add peak, on a device."""
    return {
        "bandwidth": bandwidth(device),
        "scenes": {
            scene: {
                dtype: {
                    "agreement": agreement(scene, dtype, device),
                    "rates": {str(n): rate(scene, dtype, device, n) for n in batches},
                }
                for dtype in DTYPES
            }
            for scene in SCENES
        },
        "derivatives": [
            {
                "scene": scene,
                "dtype": dtype,
                "step": rate(scene, dtype, device, batch)["steps_per_second"],
                **derivatives(scene, dtype, device, batch),
            }
            for scene in SCENES
            for dtype in DTYPES
            if (scene, dtype) not in SPARED
        ],
    }


def derivative_cells(row: dict[str, Any]) -> list[str]:
    """Scene, number type, rates and agreement."""
    rates = [f"{row[name]:.2g}" for name in ("step", "record", "pull_back")]
    return [SCENES[row["scene"]], row["dtype"], *rates, f"{row['agreement']:.1g}"]


def page(results: dict[str, Any]) -> str:
    """The results as a page."""
    each = [(s, d, found) for s, of in results["scenes"].items() for d, found in of.items()]
    batches = list(each[0][2]["rates"])

    def rates(found: dict[str, Any]) -> list[str]:
        rates = [found["rates"][n] for n in batches]
        share = rates[-1]["steps_per_second"] * rates[-1]["bytes"] / results["bandwidth"]
        listed = [f"{x['steps_per_second']:.2g}" for x in rates]
        return [*listed, f"{100.0 * share:.0f} %", f"{found['agreement']:.1g}"]

    peaks = ", ".join(f"{x:.3g} in {dtype}" for dtype, x in results["multiply_adds"].items())
    return paragraphs(
        f"# Control steps on an {results['gpu']}",
        f"`{results['command']}`, of Reach with random actions and restarts.",
        f"Copies move {results['bandwidth']:.3g} bytes/s; multiply-adds reach {peaks} "
        "operations/s.",
        table(
            ["steps/s by environments", "", *batches, "share of bandwidth", "agreement"],
            [[SCENES[s], d, *rates(found)] for s, d, found in each],
            "llr",
        ),
        "The share is that of the largest batch. Agreement is the largest difference from the "
        f"processor over {STEPS} steps, relative to numbers above 1.",
        table(
            [f"steps/s, {BATCH} environments", "", "step", "record", "pull_back", "agreement"],
            [derivative_cells(row) for row in results["derivatives"]],
            "llr",
        ),
        table(
            [f"{SCENES[FORMS_SCENE]}, float32, {BATCH} environments", "steps/s"],
            [[form, f"{x:.2g}"] for form, x in results["forms"].items()],
            "lr",
        ),
    )


def require_gpu(parser: argparse.ArgumentParser, instead: str) -> None:
    """End a command with one sentence where torch sees no GPU."""
    if not torch.cuda.is_available():
        name = parser.prog.removeprefix("python -m ")
        parser.exit(
            2,
            f"{name}: needs an NVIDIA GPU and a torch with CUDA, which sees none here; "
            f"{instead}.\n",
        )


def slug(name: str) -> str:
    """Name of a GPU in the names of files."""
    return re.sub(r"\W+", "_", name).strip("_").lower()


def main(arguments: list[str] | None = None) -> None:
    """Measure and write; without a GPU, say so."""
    parser = argument_parser("speed.gpu", __doc__)
    parser.parse_args(arguments)
    require_gpu(parser, "python -m benchmarks.speed.kernels compiles the kernels without one")
    name = torch.cuda.get_device_name()
    results = provenance("torch", "cuda-core") | {"gpu": name} | measure("cuda")
    results["multiply_adds"] = {dtype: multiply_adds(dtype) for dtype in DTYPES}
    results["forms"] = forms("cuda")
    save_results(results, page, RESULTS / f"gpu_{slug(name)}.json")


if __name__ == "__main__":
    main()
