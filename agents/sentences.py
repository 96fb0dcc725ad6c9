"""Error messages for the user, on one line and safe for a terminal."""


def one_line(error: BaseException) -> str:
    """The message of an error without line breaks and control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(error).split()))
