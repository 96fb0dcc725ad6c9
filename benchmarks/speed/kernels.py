"""Registers, spills and compile times of the GPU's kernels, which needs no GPU.

    python -m benchmarks.speed.kernels [--variants | --forms NAME ...] [--out FILE.json]

NVRTC (extra `gpu`) compiles the control steps of Reach and their derivatives for an H100; its
assembler reports what they take. `--variants` also compiles other forms of the text; `--forms`
compiles only forms of the control step that it names, and keeps the other stored results. Fills the
tables of docs/gpu.md. Compiles on all processors.
"""

import json
import os
import re
import time
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.signals import workers
from benchmarks.output import (
    ROOT,
    argument_parser,
    fill,
    paragraphs,
    provenance,
    save_results,
    table,
)
from dynamics.backends.cuda.compiler import usage
from dynamics.backends.cuda.kernel_text import PULL_BACK, PUSH_FORWARD, RECORD, START, STEP
from flexarm_env import FlexArmVectorEnv
from flexarm_env.interfaces.tensors.device import kernel_source

PAGE = ROOT / "docs" / "gpu.md"
ARCH = "sm_90"  # of an H100
SCENES = {"OneLink": "one link", "TwoLink": "two links", "SixLink": "six links"}
DTYPES = ("float32", "float64")
Row = dict[str, float]


def text_of(scene: str, dtype: str, names: Collection[str] = (STEP, START)) -> str:
    """Kernels of a scene's Reach."""
    envs = gym.make_vec(f"FlexArm/{scene}-Reach-v0", num_envs=1, dtype=dtype)
    assert isinstance(envs, FlexArmVectorEnv)
    return kernel_source(envs.core, names).text


def called(*names: str) -> Callable[[str], str]:
    """Form whose functions of these names, or all, are called."""
    return lambda text: re.sub(
        rf"__forceinline__ void ({'|'.join(names)})\(real", r"__noinline__ void \1(real", text
    )


def bounded(blocks: int) -> Callable[[str], str]:
    """Form with registers for this many blocks of 128 threads on a multiprocessor."""
    head = f"__global__ void __launch_bounds__(128, {blocks}) {STEP}("
    return lambda text: text.replace(f"__global__ void {STEP}(", head)


def inlined_restart(text: str) -> str:
    """Form whose restart is inlined."""
    return text.replace("__noinline__ void restart(", "__forceinline__ void restart(")


def shared_in_global_memory(text: str) -> str:
    """Form whose shared numbers are read through a pointer."""
    text = text.replace("const __grid_constant__ Numbers numbers", "const Numbers* numbers")
    return text.replace("const Numbers& numbers", "const Numbers* numbers").replace(
        "numbers.at[", "numbers->at["
    )


def spilled_to_shared_memory(text: str) -> str:
    """Form that spills to shared memory first, in blocks of 64 threads."""
    head = f"__global__ void __launch_bounds__(64, 1) {STEP}("
    before, _, after = text.replace(f"__global__ void {STEP}(", head).partition(head)
    arguments, brace, body = after.partition("{")
    pragma = '\n    asm volatile (".pragma \\"enable_smem_spilling\\";");'
    return before + head + arguments + brace + pragma + body


def workspace_in_shared_memory(text: str) -> str:
    """Form whose functions are called, and whose workspace is a part of shared memory."""
    part = "real* w = shared + threadIdx.x * (SLOTS | 1);"
    text = called(r"\w+")(text).replace("real w[SLOTS];", part)
    return text.replace("struct Numbers {", "extern __shared__ real shared[];\nstruct Numbers {")


def quick_reciprocals(text: str) -> str:
    """Form whose reciprocals err by two units in the last place, without a branch."""
    return re.sub(r"= 1\.0f / (x\d+);", r"= __fdividef(1.0f, \1);", text)


def fenced(every: int) -> Callable[[str], str]:
    """Form whose accelerations have a fence after so many lines, across which none moves."""

    def change(text: str) -> str:
        before, lines, after = accelerations(text)
        rows = range(0, len(lines), every)
        parts = ["\n".join(lines[k : k + every]) for k in rows]
        return before + "\n    __syncwarp();\n".join(parts) + after

    return change


def in_pieces(count: int) -> Callable[[str], str]:
    """Form whose accelerations call pieces, which pass values on in the workspace."""

    def change(text: str) -> str:
        before, lines, after = accelerations(text)
        size = -(-len(lines) // count)
        pieces = [lines[k : k + size] for k in range(0, len(lines), size)]
        slots, bodies = passed_on(pieces)
        before, _, head = before.rpartition("static __device__")
        functions = [
            f"static __device__ __noinline__ void piece_{k}(real* w)\n{{\n{body}\n}}\n\n"
            for k, body in enumerate(bodies)
        ]
        before = re.sub(r"SLOTS = (\d+)", lambda m: f"SLOTS = {int(m[1]) + slots}", before)
        calls = "\n".join(f"    piece_{k}(w);" for k in range(len(pieces)))
        return f"{before}{''.join(functions)}static __device__{head}{calls}{after}"

    return change


def passed_on(pieces: list[list[str]]) -> tuple[int, list[str]]:
    """Slots for values that a later piece uses, after those of the workspace; the pieces' text."""
    home = {
        x: k for k, lines in enumerate(pieces) for x in re.findall(r" (x\d+) =", "\n".join(lines))
    }
    used = [
        sorted({x for x in re.findall(r"x\d+", "\n".join(lines)) if home[x] < k})
        for k, lines in enumerate(pieces)
    ]
    slots = {x: k for k, x in enumerate(dict.fromkeys(x for of in used for x in of))}
    bodies = []
    for k, lines in enumerate(pieces):
        loads = [f"    const real {x} = w[SLOTS - 1 - {slots[x]}];" for x in used[k]]
        stores = [f"    w[SLOTS - 1 - {slots[x]}] = {x};" for x in slots if home[x] == k]
        bodies.append("\n".join([*loads, *lines, *stores]))
    return len(slots), bodies


def accelerations(text: str) -> tuple[str, list[str], str]:
    """Text before the lines of the accelerations, those lines, and the text after them."""
    found = re.search(r"(?<=void accelerations\(real\* w\)\n\{\n).*?(?=\n\})", text, re.S)
    assert found is not None
    return text[: found.start()], found[0].splitlines(), text[found.end() :]


DERIVATIVES = (RECORD, PULL_BACK, PUSH_FORWARD)
FORMS: dict[str, Callable[[str], str]] = {
    "as printed": lambda text: text,
    "restart inlined": inlined_restart,
    "shared numbers in global memory": shared_in_global_memory,
    "report called": called("report"),
    "accelerations called": called("accelerations"),
    "accelerations in 4 pieces": in_pieces(4),
    "fence after 200 lines of accelerations": fenced(200),
    "quick reciprocals": quick_reciprocals,
    "all functions called": called(r"\w+"),
    "all called, workspace in shared memory": workspace_in_shared_memory,
    "for at least 4 blocks": bounded(4),
    "for at least 8 blocks": bounded(8),
    "spills in shared memory": spilled_to_shared_memory,
}


BACK_FORMS: dict[str, Callable[[str], str]] = {
    "as printed": lambda text: text,
    "all functions called": called(r"\w+"),
}


def measured(text: str, kernel: str = STEP) -> Row:
    """Registers and spilled bytes of a kernel, and CPU time of the compilation [s]."""
    begin = time.process_time()
    found = usage(text, ARCH)[kernel]
    seconds = time.process_time() - begin
    return {**found._asdict(), "seconds": round(seconds, 1)}


def cells(row: Row) -> list[str]:
    """A row's registers, stack, stored and loaded bytes, and seconds."""
    names = ("registers", "stack", "stores", "loads")
    return [*(f"{row[name]:,.0f}" for name in names), f"{row['seconds']:.1f}"]


def derivatives_table(rows: dict[str, dict[str, dict[str, Row]]]) -> str:
    """Table of scenes, kernels of derivatives and number types."""
    listed = [
        [SCENES[scene], kernel, dtype, *cells(row)]
        for scene, kernels in rows.items()
        for kernel, of in kernels.items()
        for dtype, row in of.items()
    ]
    return table(["", "", "", *HEADER], listed, "lllr")


HEADER = ("registers", "stack [B]", "spill stores [B]", "spill loads [B]", "compile [s of CPU]")


def resolved(tree: Any) -> Any:
    """A tree of dicts with results in place of futures."""
    if isinstance(tree, Future):
        return tree.result()
    return {key: resolved(value) for key, value in tree.items()}


def kernels_table(rows: dict[str, dict[str, Row]]) -> str:
    """Table of scenes and number types."""
    listed = [
        [SCENES[scene], dtype, *cells(row)] for scene in rows for dtype, row in rows[scene].items()
    ]
    return table(["", "", *HEADER], listed, "llr")


def forms_table(title: str, rows: dict[str, dict[str, Row]], order: Iterable[str]) -> str:
    """Table of forms: registers, and bytes of spills where there is a stack, per scene."""

    def cell(row: Row) -> str:
        spills = f"; {row['stores']:,.0f} + {row['loads']:,.0f} B" if row["stack"] else ""
        return f"{row['registers']}{spills}"

    listed = [
        [form, *(cell(rows[form][scene]) for scene in SCENES)] for form in order if form in rows
    ]
    return table([title, *SCENES.values()], listed, "lr")


def forms(
    pool: Executor, changes: dict[str, Callable[[str], str]], kernel: str, names: Collection[str]
) -> dict[str, dict[str, Future[Row]]]:
    """A kernel by form and scene, in float32."""
    texts = {scene: text_of(scene, "float32", names) for scene in SCENES}
    return {
        form: {scene: pool.submit(measured, change(x), kernel) for scene, x in texts.items()}
        for form, change in changes.items()
    }


def all_jobs(pool: Executor, variants: bool) -> dict[str, Any]:
    """Results to come: of all kernels, with the forms of their text where asked for."""
    jobs: dict[str, Any] = {
        "kernels": {
            scene: {d: pool.submit(measured, text_of(scene, d)) for d in DTYPES} for scene in SCENES
        },
        "derivatives": {
            scene: {
                kernel: {
                    d: pool.submit(measured, text_of(scene, d, (kernel,)), kernel) for d in DTYPES
                }
                for kernel in DERIVATIVES
            }
            for scene in SCENES
        },
    }
    if variants:
        jobs["forms"] = forms(pool, FORMS, STEP, (STEP, START))
        jobs["back_forms"] = forms(pool, BACK_FORMS, PULL_BACK, (PULL_BACK,))
    return jobs


def stored(path: Path, versions: dict[str, str]) -> dict[str, Any]:
    """Results of an earlier run with all forms.

    Raises
    ------
    ValueError : they do not exist, or are of other versions.
    """
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if "forms" not in found or found["versions"] != versions:
        raise ValueError(f"{path} has no forms of {versions}; run with --variants instead.")
    return dict(found)


def main(arguments: list[str] | None = None) -> None:
    """Compile, write the results and fill the page."""
    parser = argument_parser("speed.kernels", __doc__, "kernels.json")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--variants", action="store_true", help="compile other forms too")
    chosen.add_argument("--forms", nargs="+", choices=FORMS, help="only these; keep other results")
    options = parser.parse_args(arguments)
    results: dict[str, Any] = provenance("cuda-core", "nvidia-cuda-nvrtc") | {"arch": ARCH}
    try:
        kept = stored(options.out, results["versions"]) if options.forms else {}
    except ValueError as error:
        parser.exit(2, f"benchmarks.speed.kernels: {error}\n")
    with workers(os.cpu_count() or 1) as pool:
        if options.forms:
            asked = {form: FORMS[form] for form in options.forms}
            rows = kept["forms"] | resolved(forms(pool, asked, STEP, (STEP, START)))
            results = kept | {"forms": rows, "forms_by": results["command"]}
        else:
            results |= resolved(all_jobs(pool, options.variants))
    blocks = {
        "kernels": kernels_table(results["kernels"]),
        "derivatives": derivatives_table(results["derivatives"]),
    }
    if "forms" in results:
        blocks["forms"] = forms_table("control step, float32", results["forms"], FORMS)
        blocks["back_forms"] = forms_table(
            "`pull_back`, float32", results["back_forms"], BACK_FORMS
        )
    save_results(results, paragraphs("# Kernels", *blocks.values()), options.out)
    if options.out == parser.get_default("out"):
        fill(PAGE, blocks)


if __name__ == "__main__":
    main()
