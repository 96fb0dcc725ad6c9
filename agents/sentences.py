"""Error messages for the user, on one line and safe for a terminal."""


def speaker(prog: str) -> str:
    """Name with which a command's messages begin: `prog` as it was typed, without Python."""
    return prog.removeprefix("python ").removeprefix("-m ")


def one_line(error: BaseException) -> str:
    """The message of an error without line breaks and control characters."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(error).split()))
