"""Text of error sentences: short, on one line, harmless to a terminal."""

from typing import Any

LONGEST = 80  # characters of a value in a sentence


def shown(value: Any) -> str:
    """A value as it stands in a sentence."""
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def one_line(error: BaseException) -> str:
    """The sentence of an error, without line breaks and control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(error).split()))
