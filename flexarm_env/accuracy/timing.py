"""How CPU time is measured where the machine has other work."""

import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

K = TypeVar("K")

ROUNDS = 12
LONG_ENOUGH = 2e-3  # [s] of calls at a time


def cpu_seconds(calls: Mapping[K, Callable[[], Any]], rounds: int = ROUNDS) -> dict[K, float]:
    """CPU time of each call [s]: the least of many rounds through all of them.

    The work is the same in every round, so that whatever takes longer was disturbed; and a
    disturbance of a second does not fall on all rounds of one call.
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
