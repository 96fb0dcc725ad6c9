"""Straight-line functions of the workspace as CUDA C."""

from dynamics.tracing.function import Function
from dynamics.tracing.ssa import Code

SUFFIX = {"float64": "", "float32": "f"}  # of literals and library functions, by number type
LONG = 20_000  # statements of a function that is called, since it spills most values either way
_TEXT = {
    "+": "{0} + {1}", "-": "{0} - {1}", "*": "{0} * {1}", "/": "{0} / {1}", "neg": "-{0}",
    "min": "least({0}, {1})", "max": "greatest({0}, {1})", "less": "less({0}, {1})",
    "at_most": "at_most({0}, {1})",
}  # fmt: skip
_LIBRARY = {"floor": "floor", "rounded": "floor", "sqrt": "sqrt", "abs": "fabs"}
# comparisons as in the LLVM code: a NaN in the first argument survives
PRELUDE = """\
typedef {real} real;
typedef unsigned long long whole;

static __device__ __forceinline__ real least(real a, real b) {{ return a > b ? b : a; }}
static __device__ __forceinline__ real greatest(real a, real b) {{ return a < b ? b : a; }}
static __device__ __forceinline__ real less(real a, real b) {{ return a < b ? real(1) : real(0); }}
static __device__ __forceinline__ real at_most(real a, real b)
{{
    return a <= b ? real(1) : real(0);
}}
"""


def prelude(dtype: str) -> str:
    """Number types and comparisons that all functions use."""
    return PRELUDE.format(real={"float64": "double", "float32": "float"}[dtype])


def function_text(function: Function, dtype: str) -> str:
    """Definition of a function `name(w)`.

    Slots are constants, so the workspace lies in registers where the function is inlined. One that
    is called is compiled once (docs/gpu.md).
    """
    suffix, code, lines = SUFFIX[dtype], function.code, []
    for v, (op, args) in enumerate(code.statements):
        if op.startswith("load"):
            lines.append(f"const real x{v} = w[{op[5:]}];")
        elif v not in code.names:
            operands = [_operand(code, a, suffix) for a in args]
            lines.append(f"const real x{v} = {_value(op, operands, suffix)};")
        for slot, value in function.stores.get(v, ()):
            lines.append(f"w[{slot}] = {_operand(code, value, suffix)};")
    body = "\n".join(f"    {line}" for line in lines)
    how = "__noinline__" if len(code.statements) > LONG else "__forceinline__"
    head = f"static __device__ {how} void {function.name}(real* w)"
    return f"{head}\n{{\n{body}\n}}\n"


def _value(op: str, operands: list[str], suffix: str) -> str:
    if op in _LIBRARY:
        return f"{_LIBRARY[op]}{suffix}({operands[0]})"
    return _TEXT[op].format(*operands)


def _operand(code: Code, number: int, suffix: str) -> str:
    """Literal or name of a value; without the suffix a literal would make all double."""
    text = code.text(number)
    if number not in code.names:
        return text
    return f"{text[:-1]}{suffix})" if text.endswith(")") else text + suffix
