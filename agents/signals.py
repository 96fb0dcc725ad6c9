"""Ctrl-C and the SIGTERM of a cluster: work ends where it can go on later."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
NOTICE = b"\nStopping after this update; once more stops at once.\n"

Handler = Callable[[int, FrameType | None], None]


class Interrupted(KeyboardInterrupt):
    """A signal ended the work; `status` is the exit status that says so."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.status = 128 + number


def stop_at_once(number: int, frame: FrameType | None) -> None:
    """Handler of signals where there is nothing to finish."""
    raise Interrupted(number)


class StopLater:
    """Handler of signals where something is to be finished first; the second one stops at once."""

    number: int | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.number is not None:
            raise Interrupted(number)
        self.number = number
        with suppress(OSError):
            os.write(2, NOTICE)  # print() may be what the signal has interrupted

    def now(self) -> None:
        """Stop if a signal has come: here is nothing to finish."""
        if self.number is not None:
            raise Interrupted(self.number)


@contextmanager
def signals_to(handler: Handler) -> Iterator[None]:
    """SIGINT and SIGTERM call the handler; other threads than the first cannot arrange this.

    A signal that is ignored, as by nohup, stays so.
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
