"""A pool of threads that work through one batch together."""

import os
import sys
import time
import warnings
import weakref
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from dynamics.runtime.jit import aligned_zeros
from dynamics.runtime.numba_internals import USABLE, compiled_for
from dynamics.runtime.work_queue import LINE, SPINS, post_and_wait

T = TypeVar("T")
GIVEN, DONE = 0, LINE  # places of a worker's two flags: numbers of tasks
NAP = 1e-4  # [s]
OPERATIONS_PER_SECOND = 1.5e10  # of one thread, roughly
LEAST_WORK = 5e-5  # [s] of a thread's part of a call; starting it costs a fifth of that


def useful_threads(threads: int, blocks: int, operations: float) -> int:
    """Number of threads that a call of so many operations on so many blocks of rows can use."""
    if not USABLE:
        return 1
    work = operations / OPERATIONS_PER_SECOND  # [s]
    return max(1, min(threads, blocks, int(work / LEAST_WORK)))


class ThreadPool:
    """The caller and `size - 1` worker threads, started by the first run, ended with the pool."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        weakref.finalize(self, _dismiss, self._workers)

    def run(self, work: Callable[[int], T]) -> list[T]:
        """Results of `work(thread)`, threads counted from 0.

        `work` pulls chunks until none remain. A thread that wakes after the caller has finished
        skips the task, so a thread whose core is busy delays nobody.
        """
        workers = self._running(self.size - 1)
        for k, worker in enumerate(workers):
            worker.begin(partial(work, k + 1))
        try:
            results = [work(0)]
        finally:
            outcomes = [worker.outcome() for worker in workers]
        for result, error in outcomes:
            if error is not None:
                raise error
            results += result
        return results

    def _running(self, count: int) -> list["_Worker"]:
        """Live workers; missing and ended ones are started."""
        if self._process != os.getpid():  # a fork has none of its parent's threads
            self._workers.clear()
            self._process = os.getpid()
        for worker in [worker for worker in self._workers if worker.failure]:
            warnings.warn(
                f"A worker thread ended ({worker.failure!r}); another takes its place.",
                RuntimeWarning,
                stacklevel=4,
            )
            self._workers.remove(worker)
        while len(self._workers) < count:
            self._workers.append(_Worker())
        return self._workers[:count]


def in_use() -> RuntimeError:
    """Error of a batch that two threads would step at once."""
    return RuntimeError(
        "This batch is in use by another thread; give every thread a batch of its own, or hold a "
        "lock while one steps."
    )


class _Worker:
    """A thread that polls for tasks, and sleeps when none comes for a while.

    Tasks are numbered: GIVEN is the number of the latest task, DONE that of the latest finished
    one. Each side announces what it is about to do before it checks what the other has announced,
    so no wake-up is missed and no withdrawn task is begun. Gain of polling: docs/results/tricks.md.
    """

    def __init__(self) -> None:
        self._post = aligned_zeros(2 * LINE, "int64")
        self._task: tuple[int, Callable[[], Any] | None] = (0, None)
        self._begun = 0
        self._asleep, self._calls = False, SimpleQueue[None]()
        self._outcome: tuple[list[Any], BaseException | None] = [], None
        self.failure: BaseException | None = None  # what ended the thread itself
        # compiled by one thread, before two need it
        compiled_for(post_and_wait, self._post, DONE, 0, GIVEN, 1, SPINS)
        Thread(target=self._live, daemon=True).start()

    def _live(self) -> None:
        try:
            self._serve()
        except BaseException as error:
            self.failure = error

    def _serve(self) -> None:
        number = 0
        while number >= 0:
            if not post_and_wait(self._post, DONE, number, GIVEN, number + 1, SPINS):
                self._sleep(number)
            task, self._outcome = self._task, ([], None)
            number = self._begun = task[0]
            if self._task is task and task[1] is not None:
                try:
                    self._outcome = [task[1]()], None
                except BaseException as error:
                    self._outcome = [], error
            del task

    def _sleep(self, number: int) -> None:
        self._asleep = True
        while self._post[GIVEN] <= number:  # checked after the announcement: no call is missed
            self._calls.get()
        self._asleep = False

    def begin(self, task: Callable[[], Any]) -> None:
        """Hand a task to the thread."""
        number = self._task[0] + 1
        self._give(number, number, task)

    def _give(self, number: int, shown: int, task: Callable[[], Any] | None) -> None:
        self._task = number, task
        self._post[GIVEN] = shown
        if self._asleep:
            self._calls.put(None)

    def outcome(self) -> tuple[list[Any], BaseException | None]:
        """Result of the task, or its error; a task that has not begun is withdrawn."""
        number = self._task[0]
        self._task = number, None
        if self._begun != number:
            return [], None
        if not post_and_wait(self._post, GIVEN, number, DONE, number, SPINS):
            while self._post[DONE] < number:
                if self.failure:
                    raise RuntimeError(
                        f"A worker thread ended within a step ({self.failure!r}); reset the batch."
                    ) from self.failure
                time.sleep(NAP)
        return self._outcome

    def end(self) -> None:
        """End the thread."""
        self._give(-1, sys.maxsize, None)


def _dismiss(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.end()
