"""Statements of a program as lines of CUDA C, for a thread's environment `i` of `count`."""

from collections.abc import Iterable, Mapping

from dynamics.tracing.statements import (
    Call,
    Clear,
    Copy,
    Load,
    Noise,
    Pop,
    Prefetch,
    Push,
    Rows,
    Statement,
    Statements,
    Store,
    Substeps,
    Uniform,
    WhereEnded,
    WhereLost,
)

RANDOM = """\
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
_RESTARTED = "restart(state, streams, obs, numbers, count, i);"
_ON_STACK = "stack[(long long)(top + k) * count + i]"


def indented(lines: Iterable[str]) -> list[str]:
    """Lines, one level further in."""
    return [f"    {line}" if line else "" for line in lines]


def lines_of(statements: Iterable[Statement], routines: Mapping[str, Statements]) -> list[str]:
    """Lines on the workspace `w`, and of a stack from `top` on."""
    return [line for x in statements for line in _line(x, routines)]


def _line(statement: Statement, routines: Mapping[str, Statements]) -> list[str]:
    match statement:
        case Call(name) if name in routines:
            return lines_of(routines[name], routines)
        case Call(name):
            return [f"{name}(w);"]
        case Clear(slots, 1):
            return [f"w[{slots}] = 0;"]
        case Clear(slots, count):
            return each(str(count), f"w[{slots} + k] = 0;")
        case Prefetch():
            return []
        case Noise(slots, count, key, step):
            return each(str(count), f"w[{slots} + k] = normal(w[{key}], w[{step}], k);")
        case Uniform(slots, count):
            return each(str(count), f"w[{slots} + k] = uniform(streams + i);")
        case Copy(source, target, rows):
            return each(f"N_{rows.name}", f"w[{target} + k] = w[{source} + k];")
        case Load(slots, rows):
            return each(f"N_{rows.name}", f"w[{slots} + k] = {_element(rows)};")
        case Store(slots, rows):
            value = f"w[{slots} + k]" + (" != 0" if rows.array == "flags" else "")
            return each(f"N_{rows.name}", f"{_element(rows)} = {value};")
        case Substeps(body):
            return _block("for (int s = 0; s < substeps; ++s)", lines_of(body, routines))
        case WhereLost(flag, restored, then, given):
            numbers = [line for slots, count in given for line in each(str(count), _number(slots))]
            lines = [*numbers, *lines_of((*restored, *then), routines)]
            return _block(f"if (w[{flag}] > 0)", lines)
        case WhereEnded(flags):
            return _block(f"if (w[{flags}] != 0 || w[{flags} + 1] != 0)", [_RESTARTED])
        case Push(slots, skipped, count):
            move = f"{_ON_STACK} = w[{slots} + {skipped} + k];"
            return [*each(str(count), move), f"top += {count};"]
        case Pop(slots, skipped, count):
            move = f"w[{slots} + {skipped} + k] = {_ON_STACK};"
            return [f"top -= {count};", *each(str(count), move)]
    raise TypeError(f"The CUDA backend prints no {statement}.")


def _number(slots: str) -> str:
    """Zero in place of NaN."""
    return f"if (w[{slots} + k] != w[{slots} + k]) w[{slots} + k] = 0;"


def _block(head: str, lines: Iterable[str]) -> list[str]:
    return [f"{head} {{", *indented(lines), "}"]


def each(count: str, line: str) -> list[str]:
    """Line that is repeated for `k` below a constant count."""
    return ["#pragma unroll", f"for (int k = 0; k < {count}; ++k) {line}"]


def _element(rows: Rows) -> str:
    if rows.array in ("actions", "actions_mirror"):
        return f"{rows.array}[(long long)i * N_{rows.name} + k]"
    return f"{rows.array}[(long long)(FIRST_{rows.name} + k) * count + i]"
