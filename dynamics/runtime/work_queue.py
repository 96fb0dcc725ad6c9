"""Lock-free chunk counters and wake-up flags, shared by threads that do not hold Python's lock."""

import platform
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable
from numpy.typing import NDArray

from dynamics.runtime.jit import CACHE_LINE, on_disk

CHUNKS = 8  # per thread at least, so that others can take over from a thread that is delayed
NEXT, STOP, SIZE = range(3)  # columns of a share: its next row, its end, rows per chunk
LINE = CACHE_LINE // 8  # numbers of a cache line: one line per thread avoids false sharing
SPINS = 10_000  # about 0.3 ms, as long as waking a thread may take
RELEASE = 200  # spins, about 6 us, in which the thread that wrote a flag releases Python's lock
_X86: tuple[str, list[int]] = ("llvm.x86.sse2.pause", [])
_ARM: tuple[str, list[int]] = ("llvm.aarch64.hint", [1])
_PAUSES = {"x86_64": _X86, "AMD64": _X86, "aarch64": _ARM, "arm64": _ARM}


def _place(context, builder, signature, args):  # type: ignore[no-untyped-def]
    data = context.make_array(signature.args[0])(context, builder, args[0]).data
    return builder.gep(data, [args[1]])


@intrinsic
def _read(typingctx, post, at):  # type: ignore[no-untyped-def]
    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.load_atomic(_place(context, builder, signature, args), "acquire", 8)

    return types.int64(post, at), codegen


@intrinsic
def _write(typingctx, post, at, number):  # type: ignore[no-untyped-def]
    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        builder.store_atomic(args[2], _place(context, builder, signature, args), "release", 8)
        return context.get_dummy_value()

    return types.void(post, at, number), codegen


@intrinsic
def _add(typingctx, post, at, number):  # type: ignore[no-untyped-def]
    """Atomic fetch-and-add; returns the old value."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        place = _place(context, builder, signature, args)
        return builder.atomic_rmw("add", place, args[2], "monotonic")

    return types.int64(post, at, number), codegen


@intrinsic
def _pause(typingctx):  # type: ignore[no-untyped-def]
    """The processor's spin-wait hint, which leaves resources to its other hardware thread."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        if platform.machine() in _PAUSES:
            name, numbers = _PAUSES[platform.machine()]
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(32) for _ in numbers])
            function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
            builder.call(function, [ir.IntType(32)(x) for x in numbers])
        return context.get_dummy_value()

    return types.void(), codegen


def shares(count: int, block: int, threads: int) -> NDArray[np.int64]:
    """(threads * LINE,) chunk counters: a share of a batch's rows for each thread.

    Shares are whole blocks, except the last. Columns of a share: NEXT, STOP, SIZE.
    """
    blocks = -(-count // block)
    rows = np.zeros((threads, LINE), np.int64)
    ends = [min(count, block * (k * blocks // threads)) for k in range(threads + 1)]
    rows[:, NEXT], rows[:, STOP] = ends[:-1], [*ends[1:-1], count]
    rows[:, SIZE] = block * (max(1, blocks // (CHUNKS * threads)) if threads > 1 else blocks)
    return rows.ravel()


@register_jitable
def take_chunk(rows: Any, thread: int) -> Any:
    """Claim the next chunk: its first row and its end; both are equal when none is left.

    A thread empties its own share first, whose rows are in its core's cache, then the others'.
    """
    for k in range(0, rows.size, LINE):
        at = (thread * LINE + k) % rows.size
        if rows[at + NEXT] < rows[at + STOP]:
            start = _add(rows, at + NEXT, rows[at + SIZE])
            if start < rows[at + STOP]:
                return np.uint64(start), np.uint64(min(start + rows[at + SIZE], rows[at + STOP]))
    return np.uint64(0), np.uint64(0)


@register_jitable
def first_chunk(rows: Any, thread: int) -> Any:
    """`take_chunk` at the start of a call: a single thread resets its share itself."""
    if rows.size == LINE:
        rows[NEXT] = 0
    return take_chunk(rows, thread)


@on_disk(nogil=True)
def post_and_wait(post: Any, mine: int, number: int, other: int, wanted: int, spins: int) -> bool:
    """Write a flag, then spin until another flag has reached a value.

    Waking a sleeping thread takes 10 to 300 us, as long as many a batch's step; a spinning thread
    answers in less than one.

    Parameters
    ----------
    post : (size,) int64, flags that two threads share.
    mine, number : place and new value of the caller's flag.
    other, wanted : place and least value of the flag to wait for.
    spins : polls at most.

    Returns
    -------
    Whether the flag reached the value.
    """
    _write(post, mine, number)
    for _ in range(spins):
        if _read(post, other) >= wanted:
            for _ in range(RELEASE):
                _pause()
            return True
        _pause()
    return False
