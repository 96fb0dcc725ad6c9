"""Handling of Ctrl-C and SIGTERM, so that work ends where it can be resumed, with its workers."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
NOTICE = b"\nStopping after this update; a second signal stops at once.\n"

Handler = Callable[[int, FrameType | None], None]


class Interrupted(KeyboardInterrupt):
    """A signal ended the work; `status` is the exit status 128 + signal number."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


def stop_at_once(number: int, frame: FrameType | None) -> None:
    """Signal handler for work that needs no orderly end."""
    raise Interrupted(number)


class StopLater:
    """Signal handler that records the first signal and stops at once on the second."""

    number: int | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.number is not None:
            raise Interrupted(number)
        self.number = number
        with suppress(OSError):
            os.write(2, NOTICE)  # the signal may have interrupted print()

    def now(self) -> None:
        """Stop here if a signal was received."""
        if self.number is not None:
            raise Interrupted(self.number)


@contextmanager
def signals_to(handler: Handler) -> Iterator[None]:
    """Let SIGINT and SIGTERM call the handler; without effect outside the main thread.

    A signal that is ignored, as by nohup, stays ignored.
    """
    before = {number: signal.getsignal(number) for number in SIGNALS}
    if threading.current_thread() is not threading.main_thread():
        before = {}
    before = {number: old for number, old in before.items() if old is not signal.SIG_IGN}
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def workers(count: int, tasks_each: int | None = None) -> ProcessPoolExecutor:
    """Pool of new processes, which end with this one however it ends, or after their tasks."""
    return ProcessPoolExecutor(
        count, get_context("spawn"), end_with_parent, max_tasks_per_child=tasks_each
    )


def end_with_parent() -> None:
    """Let a worker end without a word at Ctrl-C, and when the process that started it has ended."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
