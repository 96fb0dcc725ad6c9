"""Numbers that threads share without Python's lock: turns at a batch, and words to each other."""

import platform
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable
from numpy.typing import NDArray

from dynamics.runtime.jit import CACHE_LINE, on_disk

TURNS = 8  # per thread at least: one that is held up leaves some to the others
NEXT, STOP, SIZE = range(3)  # of turns
LINE = CACHE_LINE // 8  # numbers in a line of the cache, which only one core can write at a time
LOOKS = 10_000  # about 0.3 ms: as long as waking may take
BREATH = 200  # about 6 us: until who wrote the number has left Python and its lock is free
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
    """What was there before."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        place = _place(context, builder, signature, args)
        return builder.atomic_rmw("add", place, args[2], "monotonic")

    return types.int64(post, at, number), codegen


@intrinsic
def _pause(typingctx):  # type: ignore[no-untyped-def]
    """The processor's own idea of waiting a moment: lighter on others than running in circles."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        if platform.machine() in _PAUSES:
            name, numbers = _PAUSES[platform.machine()]
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(32) for _ in numbers])
            function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
            builder.call(function, [ir.IntType(32)(x) for x in numbers])
        return context.get_dummy_value()

    return types.void(), codegen


def turns(count: int, block: int, threads: int) -> NDArray[np.int64]:
    """What threads take turns at: (threads * LINE,), a share of a batch's rows for each.

    Shares are whole blocks, but for the last: where its next turn starts, where it stops, and how
    many rows a turn takes.
    """
    blocks = -(-count // block)
    rows = np.zeros((threads, LINE), np.int64)
    ends = [min(count, block * (k * blocks // threads)) for k in range(threads + 1)]
    rows[:, NEXT], rows[:, STOP] = ends[:-1], [*ends[1:-1], count]
    rows[:, SIZE] = block * (max(1, blocks // (TURNS * threads)) if threads > 1 else blocks)
    return rows.ravel()


@register_jitable
def take_turn(rows: Any, thread: int) -> Any:
    """The next rows that nobody has taken, from and to; none when both are equal.

    A thread's own first, which are in its core's cache, then what others have left.
    """
    for k in range(0, rows.size, LINE):
        at = (thread * LINE + k) % rows.size
        if rows[at + NEXT] < rows[at + STOP]:
            start = _add(rows, at + NEXT, rows[at + SIZE])
            if start < rows[at + STOP]:
                return np.uint64(start), np.uint64(min(start + rows[at + SIZE], rows[at + STOP]))
    return np.uint64(0), np.uint64(0)


@register_jitable
def first_turn(rows: Any, thread: int) -> Any:
    """The same, of a thread that begins: where it is the only one, all start anew."""
    if rows.size == LINE:
        rows[NEXT] = 0
    return take_turn(rows, thread)


@on_disk(nogil=True)
def watch(post: Any, mine: int, number: int, other: int, wanted: int, looks: int) -> bool:
    """Write a number at `mine`, then look until that at `other` is as large as wanted.

    Waking a thread that sleeps takes 10 to 300 us, as long as many a batch's step; one that looks
    is there in less than one.

    Parameters
    ----------
    post : (size,) int64, what both threads write on.
    looks : how often at most.

    Returns
    -------
    Whether it came.
    """
    _write(post, mine, number)
    for _ in range(looks):
        if _read(post, other) >= wanted:
            for _ in range(BREATH):
                _pause()
            return True
        _pause()
    return False
