"""Kernels in CUDA C of control steps and of their derivatives: one thread per environment.

All arrays lie column by column, an environment a column, so that neighbouring threads read
neighbouring numbers; only actions have a row per environment. The workspace is a local array whose
indices are constants. Slots that all environments share are an argument of the kernel, which lies
in constant memory and takes no registers. A restart is a function with a workspace of its own, so
that the step keeps nothing for it.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping

from dynamics.backends.cuda.function_text import function_text, prelude
from dynamics.backends.cuda.statement_text import RANDOM, each, indented, lines_of
from dynamics.tracing.assembly import Program
from dynamics.tracing.statements import (
    Call,
    ControlStep,
    Derivatives,
    Load,
    Statement,
    Statements,
    Store,
    WhereEnded,
    rows_of,
    walked,
)

# a control step, which restarts ended episodes; the report on new episodes; restarts alone
STEP, START, RESTART = "control_step", "first_report", "restart_ended"
RECORD, PULL_BACK, PUSH_FORWARD = "record", "pull_back", "push_forward"
DERIVATIVES = {RECORD, PULL_BACK, PUSH_FORWARD}  # kernels of `statements.Derivatives`
_BEGUN = ("state", "streams", "obs")  # what a restart writes
_OF_STEP = ("state", "streams", "actions", "obs", "final_obs", "info", "flags")
_STORED = ("state", "actions", "obs", "info", "flags")
_MIRRORS = ("actions_mirror", "state_mirror", "obs_mirror", "info_mirror")
ARRAYS = {  # arguments of each kernel, before the shared numbers
    STEP: _OF_STEP,
    START: _OF_STEP,
    RESTART: (*_BEGUN, "flags"),
    RECORD: (*_STORED, "stack"),
    PULL_BACK: ("state", "actions", "stack", *_MIRRORS),
    PUSH_FORWARD: (*_STORED, *_MIRRORS),
}
_TYPES = {
    "streams": "whole*",
    "actions": "const float*",
    **dict.fromkeys(("obs", "final_obs", "actions_mirror", "obs_mirror"), "float*"),
    "flags": "unsigned char*",
}  # of arrays; of all others `real*`
_TOPS = {RECORD: "0", PULL_BACK: "STACK_FIXED + STACK_PER_SUBSTEP * substeps"}  # of the stack
_KERNEL = """\
extern "C" __global__ void {name}(
    {arrays},
    const __grid_constant__ Numbers numbers, int count, int substeps)
{{
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count) return;
{body}
}}
"""
_RESTART = """\
static __device__ __noinline__ void restart(
    {arrays},
    const Numbers& numbers, int count, int i)
{{
{body}
}}
"""
_WORKSPACE = """\
    real w[SLOTS];
    #pragma unroll
    for (int k = 0; k < SLOTS; ++k) w[k] = 0;
"""


def kernel_text(program: Program, dtype: str, names: Collection[str]) -> str:
    """Kernels of a program that `names` lists.

    Raises
    ------
    ValueError : the program has no control step, or its integrator needs a Jacobian.
    """
    if any(function.name == "AID" for function in program.functions):
        raise ValueError(
            f"integrator {program.method.integrator!r} needs a Jacobian, whose loops only the LLVM "
            "backend compiles; leave integrator out or take 'midpoint'."
        )
    kernels = {name: body for name, body in _kernels(program).items() if name in names}
    statements = [x for body in kernels.values() for x in body]
    called = _called(statements, program.routines)
    functions = [x for x in program.functions if x.name in called]
    ended = [x for x in walked(statements) if isinstance(x, WhereEnded)]
    parts = [
        prelude(dtype),
        _names(program, statements),
        RANDOM,
        *(function_text(function, dtype) for function in functions),
        *(_restart(program, x) for x in ended[:1]),
        *(_kernel(program, name, body) for name, body in kernels.items()),
    ]
    return "\n".join(parts)


def shared_slots(program: Program) -> list[int]:
    """Slots that all environments share, in the order of the kernels' argument `numbers`."""
    return [program.at[name] + k for name in program.shared for k in range(program.sizes[name])]


def _kernels(program: Program) -> dict[str, Statements]:
    """Statements of all kernels of a program."""
    match program.entry:
        case ControlStep(step=step, start=start):
            ended = [x for x in step if isinstance(x, WhereEnded)]
            flags = [
                Load(x.slots, x.rows)
                for x in step
                if isinstance(x, Store) and x.rows.array == "flags"
            ]
            return {STEP: step, START: start, RESTART: (*flags, *ended)}
        case Derivatives(record=record, pull_back=back, push_forward=forward):
            return {RECORD: record, PULL_BACK: back, PUSH_FORWARD: forward}
    raise ValueError(
        "The CUDA backend prints the control steps of environments; add --env ID, or take "
        "backend='llvm'."
    )


def _called(statements: Iterable[Statement], routines: Mapping[str, Statements]) -> set[str]:
    """Names of the functions that statements call, also in routines."""
    found: set[str] = set()
    for statement in walked(statements):
        if isinstance(statement, Call):
            inside = routines.get(statement.name)
            found |= {statement.name} if inside is None else _called(inside, routines)
    return found


def _names(program: Program, statements: Iterable[Statement]) -> str:
    """Slots, and numbers and first rows, as an enumeration; the type of shared numbers."""
    names = {"SLOTS": program.slots, "SHARED": len(shared_slots(program)), **program.at}
    if isinstance(program.entry, Derivatives):
        names |= {
            "STACK_FIXED": program.entry.fixed,
            "STACK_PER_SUBSTEP": program.entry.per_substep,
        }
    for rows in rows_of(statements).values():
        names |= {f"N_{rows.name}": rows.count, f"FIRST_{rows.name}": rows.first}
    lines = [f"    {name} = {number}," for name, number in names.items()]
    return "\n".join(["enum {", *lines, "};", "", "struct Numbers { real at[SHARED]; };", ""])


def _kernel(program: Program, name: str, statements: Statements) -> str:
    body = _body(program, statements)
    if name in _TOPS:
        body = f"    int top = {_TOPS[name]};\n{body}"
    return _KERNEL.format(name=name, arrays=_arrays(ARRAYS[name]), body=body)


def _restart(program: Program, ended: WhereEnded) -> str:
    return _RESTART.format(arrays=_arrays(_BEGUN), body=_body(program, ended.body))


def _arrays(names: Iterable[str]) -> str:
    """Parameters of a function."""
    return ", ".join(f"{_TYPES.get(name, 'real*')} __restrict__ {name}" for name in names)


def _body(program: Program, statements: Statements) -> str:
    """Statements on a workspace of their own, which begins with the shared numbers."""
    lines = [*_shared(program), "", *lines_of(statements, program.routines)]
    return _WORKSPACE + "\n".join(indented(lines))


def _shared(program: Program) -> Iterator[str]:
    """Lines that copy the slots that all environments share."""
    first = 0
    for name in program.shared:
        if count := program.sizes[name]:
            yield from each(str(count), f"w[{name} + k] = numbers.at[{first} + k];")
        first += count
