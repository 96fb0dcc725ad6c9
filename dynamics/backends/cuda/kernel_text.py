"""Control steps as kernels in CUDA C: one thread per environment.

All arrays lie column by column, an environment a column, so that neighbouring threads read
neighbouring numbers; only `actions` has a row per environment. The workspace is a local array whose
indices are constants. Slots that all environments share are an argument of the kernel, which lies
in constant memory and takes no registers. A restart is a function with a workspace of its own, so
that the step keeps nothing for it.
"""

from collections.abc import Iterable, Iterator, Mapping

from dynamics.backends.cuda.function_text import function_text, prelude
from dynamics.tracing.assembly import Program
from dynamics.tracing.statements import (
    Call,
    Clear,
    ControlStep,
    Copy,
    Load,
    Noise,
    Prefetch,
    Rows,
    Statement,
    Statements,
    Store,
    Substeps,
    Uniform,
    WhereEnded,
    WhereLost,
)

STEP, START = "control_step", "first_report"  # a control step; the report on new episodes
KERNELS = (STEP, START)
_RANDOM = """\
static __device__ __forceinline__ whole mixed(whole z)
{
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return z ^ (z >> 31);
}

static __device__ __forceinline__ real uniform(whole* stream)
{
    *stream += 0x9E3779B97F4A7C15ULL;
    return real((double)(mixed(*stream) >> 11) * 1.1102230246251565e-16);
}

static __device__ __forceinline__ real normal(real key, real step, whole k)
{
    whole z = whole(key) * 0x9E3779B97F4A7C15ULL;
    z ^= (whole(step) * 256ULL + k) * 0xD1342543DE82EF95ULL;
    z = mixed(z);
    whole low = 0;
    for (int shift = 0; shift < 64; shift += 16)
        low += (z >> shift) & 0xFFFFULL;
    return (real(low) - real(131070)) * real(1.7320508075688772 / 65536.0);
}
"""
_ARRAYS = """\
    real* __restrict__ state, whole* __restrict__ streams, const float* __restrict__ actions,
    float* __restrict__ obs, float* __restrict__ final_obs, real* __restrict__ info,
    unsigned char* __restrict__ flags"""
_KERNEL = """\
extern "C" __global__ void {name}(
{arrays}, const __grid_constant__ Numbers numbers,
    int count, int substeps)
{{
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count) return;
{body}
}}
"""
_RESTART = """\
static __device__ __noinline__ void restart(
{arrays}, const Numbers& numbers,
    int count, int i)
{{
{body}
}}
"""
_RESTARTED = "restart(state, streams, actions, obs, final_obs, info, flags, numbers, count, i);"
_WORKSPACE = """\
    real w[SLOTS];
    #pragma unroll
    for (int k = 0; k < SLOTS; ++k) w[k] = 0;
"""


def kernel_text(program: Program, dtype: str) -> str:
    """All kernels of a program.

    Raises
    ------
    ValueError : the program has no control step, or its integrator needs a Jacobian.
    """
    entry = program.entry
    if not isinstance(entry, ControlStep):
        raise ValueError(
            "The CUDA backend prints the control steps of environments; add --env ID, or take "
            "backend='llvm'."
        )
    if any(function.name == "AID" for function in program.functions):
        raise ValueError(
            f"integrator {program.method.integrator!r} needs a Jacobian, whose loops only the LLVM "
            "backend compiles; leave integrator out or take 'midpoint'."
        )
    functions = [function_text(function, dtype) for function in program.functions]
    restarts = [
        _RESTART.format(arrays=_ARRAYS, body=_body(program, statement.body))
        for statement in entry.step
        if isinstance(statement, WhereEnded)
    ]
    kernels = [
        _KERNEL.format(arrays=_ARRAYS, name=name, body=_body(program, statements))
        for name, statements in ((STEP, entry.step), (START, entry.start))
    ]
    parts = [prelude(dtype), _names(program, entry), _RANDOM, *functions, *restarts, *kernels]
    return "\n".join(parts)


def shared_slots(program: Program) -> list[int]:
    """Slots that all environments share, in the order of the kernels' argument `numbers`."""
    return [program.at[name] + k for name in program.shared for k in range(program.sizes[name])]


def _names(program: Program, entry: ControlStep) -> str:
    """Slots, and numbers and first rows, as an enumeration; the type of shared numbers."""
    names = {"SLOTS": program.slots, "SHARED": len(shared_slots(program)), **program.at}
    for rows in entry.rows.values():
        names |= {f"N_{rows.name}": rows.count, f"FIRST_{rows.name}": rows.first}
    lines = [f"    {name} = {number}," for name, number in names.items()]
    return "\n".join(["enum {", *lines, "};", "", "struct Numbers { real at[SHARED]; };", ""])


def _body(program: Program, statements: Statements) -> str:
    """Statements on a workspace of their own, which begins with the shared numbers."""
    lines = [*_shared(program), "", *_lines(statements, program.routines)]
    return _WORKSPACE + "\n".join(_indented(lines))


def _shared(program: Program) -> Iterator[str]:
    """Lines that copy the slots that all environments share."""
    first = 0
    for name in program.shared:
        if count := program.sizes[name]:
            yield from _each(str(count), f"w[{name} + k] = numbers.at[{first} + k];")
        first += count


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" if line else "" for line in lines]


def _lines(statements: Iterable[Statement], routines: Mapping[str, Statements]) -> list[str]:
    return [line for x in statements for line in _line(x, routines)]


def _line(statement: Statement, routines: Mapping[str, Statements]) -> list[str]:
    match statement:
        case Call(name) if name in routines:
            return _lines(routines[name], routines)
        case Call(name):
            return [f"{name}(w);"]
        case Clear(slots, 1):
            return [f"w[{slots}] = 0;"]
        case Clear(slots, count):
            return _each(str(count), f"w[{slots} + k] = 0;")
        case Prefetch():
            return []
        case Noise(slots, count, key, step):
            return _each(str(count), f"w[{slots} + k] = normal(w[{key}], w[{step}], k);")
        case Uniform(slots, count):
            return _each(str(count), f"w[{slots} + k] = uniform(streams + i);")
        case Copy(source, target, rows):
            return _each(f"N_{rows.name}", f"w[{target} + k] = w[{source} + k];")
        case Load(slots, rows):
            return _each(f"N_{rows.name}", f"w[{slots} + k] = {_element(rows)};")
        case Store(slots, rows):
            value = f"w[{slots} + k]" + (" != 0" if rows.array == "flags" else "")
            return _each(f"N_{rows.name}", f"{_element(rows)} = {value};")
        case Substeps(body):
            return _block("for (int s = 0; s < substeps; ++s)", _lines(body, routines))
        case WhereLost(flag, restored, then, given):
            numbers = [line for slots, count in given for line in _each(str(count), _number(slots))]
            lines = [*numbers, *_lines((*restored, *then), routines)]
            return _block(f"if (w[{flag}] > 0)", lines)
        case WhereEnded(flags):
            return _block(f"if (w[{flags}] != 0 || w[{flags} + 1] != 0)", [_RESTARTED])
    raise TypeError(f"The CUDA backend has no kernels of derivatives, so no {statement}.")


def _number(slots: str) -> str:
    """Zero in place of NaN."""
    return f"if (w[{slots} + k] != w[{slots} + k]) w[{slots} + k] = 0;"


def _block(head: str, lines: Iterable[str]) -> list[str]:
    return [f"{head} {{", *_indented(lines), "}"]


def _each(count: str, line: str) -> list[str]:
    return ["#pragma unroll", f"for (int k = 0; k < {count}; ++k) {line}"]


def _element(rows: Rows) -> str:
    if rows.array == "actions":
        return f"actions[(long long)i * N_{rows.name} + k]"
    return f"{rows.array}[(long long)(FIRST_{rows.name} + k) * count + i]"
