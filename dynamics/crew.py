"""Threads that share a list of jobs."""

import os
import weakref
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from threading import Lock, Thread
from typing import Any, TypeVar

T = TypeVar("T")
SHARES = 4  # of a batch per thread: one that is held up leaves some to the others


def shares(count: int, block: int, threads: int) -> list[tuple[int, int]]:
    """Ranges of whole blocks that make up `count` things; the last block may be short."""
    blocks = -(-count // block)
    parts = min(SHARES * threads, blocks) if threads > 1 else 1
    return list(pairwise([*(block * (k * blocks // parts) for k in range(parts)), count]))


class Crew:
    """The caller and `size - 1` threads, each of which takes the next job when it is free.

    So a thread whose core has other work takes fewer. The threads start with the first run and end
    with the crew.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._helpers: list[_Helper] = []
        self._process = os.getpid()
        weakref.finalize(self, _dismiss, self._helpers)

    def run(self, work: Callable[[int, Any], T], jobs: Sequence[Any]) -> list[T]:
        """What `work(thread, job)` says of each job, in any order; threads count from 0."""
        todo = iter(jobs)  # one iterator for all: whoever asks gets the next

        def share(thread: int) -> list[T]:
            return [work(thread, job) for job in todo]

        helpers = self._hired(min(self.size, len(jobs)) - 1)
        for k, helper in enumerate(helpers):
            helper.begin(partial(share, k + 1))
        try:
            results = share(0)
        finally:
            for helper in helpers:
                helper.wait()
        for helper in helpers:
            results += helper.results()
        return results

    def _hired(self, count: int) -> list["_Helper"]:
        if self._process != os.getpid():  # a fork has none of its parent's threads
            self._helpers.clear()
            self._process = os.getpid()
        while len(self._helpers) < count:
            self._helpers.append(_Helper())
        return self._helpers[:count]


class _Helper:
    """A thread that sleeps between tasks."""

    def __init__(self) -> None:
        self._go, self._done = Lock(), Lock()
        self._go.acquire()
        self._done.acquire()
        self._task: Callable[[], list[Any]] | None = None
        self._results: list[Any] = []
        self._error: BaseException | None = None
        Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            self._go.acquire()
            if self._task is None:
                return
            try:
                self._results = self._task()
            except BaseException as error:  # raised again by `results`
                self._error = error
            self._task = None
            self._done.release()

    def begin(self, task: Callable[[], list[Any]]) -> None:
        self._task, self._error = task, None
        self._go.release()

    def wait(self) -> None:
        self._done.acquire()

    def results(self) -> list[Any]:
        """Of the task that was waited for."""
        if self._error is not None:
            raise self._error
        return self._results

    def end(self) -> None:
        """Wake the thread without a task."""
        self._go.release()


def _dismiss(helpers: list[_Helper]) -> None:
    for helper in helpers:
        helper.end()
