"""Times of calls on a machine that others use too: medians and bests of many short runs."""

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

RUNS, SECONDS = 150, 1.5  # per measurement; short runs find moments without other load


class Timing(NamedTuple):
    """Median time of a call [s], and the best, which has no other load on the machine."""

    median: float
    best: float

    def per(self, amount: float) -> dict[str, float]:
        """Amounts per second."""
        return {"median": amount / self.median, "best": amount / self.best}

    def each(self, amount: float) -> dict[str, float]:
        """Time per amount."""
        return {"median": self.median / amount, "best": self.best / amount}


def timed(call: Callable[[], Any]) -> Timing:
    """Time one call over many runs."""
    return timed_in_turn({"": call})[""]


def timed_in_turn(calls: Mapping[str, Callable[[], Any]]) -> dict[str, Timing]:
    """Time the calls in turn, many times, so that a disturbance of seconds affects all."""
    repeats: dict[str, int] = {}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for name, call in calls.items():
        call()
        repeats[name] = max(1, int(SECONDS / RUNS / max(_seconds(call, 1), 1e-7)))
    for _ in range(RUNS):
        for name, call in calls.items():
            times[name].append(_seconds(call, repeats[name]))
    return {name: Timing(statistics.median(found), min(found)) for name, found in times.items()}


def _seconds(call: Callable[[], Any], times: int) -> float:
    begin = time.perf_counter()
    for _ in range(times):
        call()
    return (time.perf_counter() - begin) / times
