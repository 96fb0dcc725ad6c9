"""Threads that work together."""

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

from dynamics.runtime.jit import aligned_zeros, direct
from dynamics.runtime.work_queue import LINE, LOOKS, watch

T = TypeVar("T")
GIVEN, DONE = 0, LINE  # where a post holds numbers of tasks
NAP = 1e-4  # [s]
OPERATIONS_PER_SECOND = 1.5e10  # of one thread, roughly
WORTH_A_THREAD = 5e-5  # [s] of work, of which dividing it takes a fifth


def worth(threads: int, blocks: int, operations: float) -> int:
    """How many threads a call is worth that does so many operations on so many blocks of rows."""
    work = operations / OPERATIONS_PER_SECOND  # [s]
    return max(1, min(threads, blocks, int(work / WORTH_A_THREAD)))


class Crew:
    """The caller and `size - 1` threads, which start with the first run and end with the crew."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._helpers: list[_Helper] = []
        self._process = os.getpid()
        weakref.finalize(self, _dismiss, self._helpers)

    def run(self, work: Callable[[int], T]) -> list[T]:
        """What `work(thread)` says in every thread that came in time; threads count from 0.

        It is to take parts of something until none is left. Who is so late that the caller has
        finished does not begin, so a thread whose core is busy holds up nobody.
        """
        helpers = self._hired(self.size - 1)
        for k, helper in enumerate(helpers):
            helper.begin(partial(work, k + 1))
        try:
            results = [work(0)]
        finally:
            outcomes = [helper.outcome() for helper in helpers]
        for result, error in outcomes:
            if error is not None:
                raise error
            results += result
        return results

    def _hired(self, count: int) -> list["_Helper"]:
        if self._process != os.getpid():  # a fork has none of its parent's threads
            self._helpers.clear()
            self._process = os.getpid()
        for helper in [helper for helper in self._helpers if helper.failure]:
            warnings.warn(
                f"A worker thread ended ({helper.failure!r}); another takes its place.",
                RuntimeWarning,
                stacklevel=4,
            )
            self._helpers.remove(helper)
        while len(self._helpers) < count:
            self._helpers.append(_Helper())
        return self._helpers[:count]


def in_use() -> RuntimeError:
    """Error of a batch that two threads would step at once."""
    return RuntimeError(
        "This batch is in use by another thread; give every thread a batch of its own, or hold a "
        "lock while one steps."
    )


class _Helper:
    """A thread that looks for tasks, and sleeps when none comes for a while.

    A task is given under its number, and done when that number is. Each side says what it is about
    to do before it looks whether the other has: so no call is missed, and no task that was
    withdrawn is begun.
    """

    def __init__(self) -> None:
        self._post = aligned_zeros(2 * LINE, "int64")
        self._task: tuple[int, Callable[[], Any] | None] = (0, None)
        self._begun = 0
        self._asleep, self._calls = False, SimpleQueue[None]()
        self._outcome: tuple[list[Any], BaseException | None] = [], None
        self.failure: BaseException | None = None  # what ended the thread itself
        direct(watch, self._post, DONE, 0, GIVEN, 1, LOOKS)  # compiled before two threads need it
        Thread(target=self._live, daemon=True).start()

    def _live(self) -> None:
        try:
            self._serve()
        except BaseException as error:
            self.failure = error

    def _serve(self) -> None:
        number = 0
        while number >= 0:
            if not watch(self._post, DONE, number, GIVEN, number + 1, LOOKS):
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
        while self._post[GIVEN] <= number:  # looked at after saying so: no call is missed
            self._calls.get()
        self._asleep = False

    def begin(self, task: Callable[[], Any]) -> None:
        number = self._task[0] + 1
        self._give(number, number, task)

    def _give(self, number: int, shown: int, task: Callable[[], Any] | None) -> None:
        self._task = number, task
        self._post[GIVEN] = shown
        if self._asleep:
            self._calls.put(None)

    def outcome(self) -> tuple[list[Any], BaseException | None]:
        """What the task said, or what it raised; nothing if it has not begun, and it will not."""
        number = self._task[0]
        self._task = number, None
        if self._begun != number:
            return [], None
        if not watch(self._post, GIVEN, number, DONE, number, LOOKS):
            while self._post[DONE] < number:
                if self.failure:
                    raise RuntimeError(
                        f"A worker thread ended within a step ({self.failure!r}); reset the batch."
                    ) from self.failure
                time.sleep(NAP)
        return self._outcome

    def end(self) -> None:
        """No task comes any more."""
        self._give(-1, sys.maxsize, None)


def _dismiss(helpers: list[_Helper]) -> None:
    for helper in helpers:
        helper.end()
