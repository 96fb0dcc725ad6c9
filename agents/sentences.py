"""Text for the user: error messages on one line and safe for a terminal, and numbers."""

import sys


def speaker(prog: str) -> str:
    """Name with which a command's messages begin: `prog` as it was typed, without Python."""
    return prog.removeprefix("python ").removeprefix("-m ")


def one_line(error: BaseException | str) -> str:
    """The message of an error without line breaks and control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(error).split()))


def refused(prog: str, error: BaseException | str, status: int = 2) -> int:
    """Print why a command ends, as one sentence; returns its exit status."""
    print(f"{speaker(prog)}: {one_line(error)}", file=sys.stderr)
    return status


class Failures:
    """Errors that were told to the user, each of them once."""

    def __init__(self, prog: str) -> None:
        self.speaker = speaker(prog)
        self.told: set[str] = set()

    def tell(self, error: BaseException) -> None:
        """Print an error that was not told before as one sentence."""
        sentence = f"{self.speaker}: {one_line(error)}"
        if sentence not in self.told:
            self.told.add(sentence)
            print(sentence, file=sys.stderr)


def plain(value: float, style: str) -> str:
    """A number in a format, a large one without a power of ten: 1020 for 1.02e+03."""
    text = f"{value:{style}}"
    return f"{float(text):.0f}" if "e+" in text else text
