"""How CPU time is measured."""

import time
from collections.abc import Callable
from typing import Any


def cpu_seconds(call: Callable[[], Any], at_least: float = 0.03, runs: int = 9) -> float:
    """CPU time of one call [s]: the least of several runs of many calls, after a first one.

    The work is the same every time, so that whatever takes longer was disturbed.
    """
    call()
    begin = time.process_time()
    call()
    calls = max(1, int(at_least / runs / max(time.process_time() - begin, 1e-7)))
    times = []
    for _ in range(runs):
        begin = time.process_time()
        for _ in range(calls):
            call()
        times.append((time.process_time() - begin) / calls)
    return min(times)
