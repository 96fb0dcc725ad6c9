"""Sentences for the user, on one line and harmless to a terminal."""


def one_line(error: BaseException) -> str:
    """The sentence of an error, without line breaks and control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(error).split()))
