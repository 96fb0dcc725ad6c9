"""Progress of a choice, a certificate or a fit, on a terminal or if asked.

The number of motions to come is not known, so one line on standard error shows the stage, the
motions so far, the time taken and the last result.
"""

import sys
from types import TracebackType

from tqdm import tqdm

LINE = "{desc}: {n_fmt} motions, {elapsed}{postfix}"


class Progress:
    """A line of progress; `shown` is True, False, or None: only on a terminal."""

    def __init__(self, shown: bool | None) -> None:
        hidden = not (sys.stderr.isatty() if shown is None else shown)
        self._bar = tqdm(disable=hidden, bar_format=LINE, file=sys.stderr, leave=False)

    def stage(self, name: str) -> None:
        """Begin a stage, such as "reference", "models" or "steps"."""
        self._bar.set_description_str(name)

    def motion(self, count: int = 1) -> None:
        """Count motions, measured or simulated."""
        self._bar.update(count)

    def result(self, text: str) -> None:
        """Show the last result."""
        self._bar.set_postfix_str(text)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()
