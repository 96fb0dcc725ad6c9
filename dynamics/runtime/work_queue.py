"""Lock-free chunk counters and wake-up flags, shared by threads that do not hold Python's lock."""

from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from dynamics.runtime.jit import CACHE_LINE, exact, on_disk
from dynamics.runtime.numba_internals import USABLE

if USABLE:
    from dynamics.runtime.atomics import fetch_and_add, load, pause, store
else:

    @register_jitable
    def fetch_and_add(array: Any, at: int, number: int) -> int:
        """Addition by a single thread; returns the old value."""
        old: int = array[at]
        array[at] += number
        return old


# per thread at least, so that others can take over from a delayed thread: docs/results/tricks.md
CHUNKS = 8
NEXT, STOP, SIZE = range(3)  # columns of a share: its next row, its end, rows per chunk
LINE = CACHE_LINE // 8  # numbers of a cache line: one line per thread avoids false sharing
SPINS = 10_000  # about 0.3 ms, as long as waking a thread may take
RELEASE = 200  # spins, about 6 us, in which the thread that wrote a flag releases Python's lock


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


@exact
def take_chunk(rows: Any, thread: int) -> Any:
    """Claim the next chunk: its first row and its end; both are equal when none is left.

    A thread empties its own share first, whose rows are in its core's cache, then the others'.
    """
    for k in range(0, rows.size, LINE):
        at = (thread * LINE + k) % rows.size
        if rows[at + NEXT] < rows[at + STOP]:
            start = fetch_and_add(rows, at + NEXT, rows[at + SIZE])
            if start < rows[at + STOP]:
                return np.uint64(start), np.uint64(min(start + rows[at + SIZE], rows[at + STOP]))
    return np.uint64(0), np.uint64(0)


@exact
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
    store(post, mine, number)
    for _ in range(spins):
        if load(post, other) >= wanted:
            for _ in range(RELEASE):
                pause()
            return True
        pause()
    return False
