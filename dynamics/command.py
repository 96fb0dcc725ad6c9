"""Ends of commands whose output cannot be written."""

import os
import sys
from collections.abc import Callable

UNWRITTEN = 1  # exit status: the output cannot be written
UNREAD = 141  # exit status, as a shell has it: nobody reads the output any more


def completed(name: str, run: Callable[[], int]) -> int:
    """Exit status of a command, `run`, once all that it prints is written.

    A reader of a pipe that has gone, such as `head`, ends it without a word.
    """
    try:
        try:
            return run()
        finally:
            if sys.stdout is not None:  # as where the shell has closed it
                sys.stdout.flush()
    except OSError as error:
        if sys.stdout is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return UNREAD
        place = error.filename or "standard output"
        print(f"{name}: {place}: {error.strerror}.", file=sys.stderr)
        return UNWRITTEN
