"""CPU times of calls, measured beside other work on the machine."""

import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

K = TypeVar("K")

ROUNDS = 12
LONG_ENOUGH = 2e-3  # [s] of calls per time measurement


def cpu_seconds(calls: Mapping[K, Callable[[], Any]], rounds: int = ROUNDS) -> dict[K, float]:
    """CPU time [s] of each call: the smallest of many rounds through all calls.

    Every round does the same work, so a longer time is a disturbance. A disturbance of a second
    does not affect all rounds of one call, because the calls alternate.
    """
    least = {}
    for key, call in calls.items():
        call()
        least[key] = _timed(call, 1)
    often = {key: max(1, int(LONG_ENOUGH / max(t, 1e-7))) for key, t in least.items()}
    for _ in range(rounds):
        for key, call in calls.items():
            least[key] = min(least[key], _timed(call, often[key]))
    return least


def _timed(call: Callable[[], Any], times: int) -> float:
    begin = time.process_time()
    for _ in range(times):
        call()
    return (time.process_time() - begin) / times
