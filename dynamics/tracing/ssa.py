"""Straight-line code in static single assignment (SSA) form.

The code works on one workspace `w` of slots; a slot holds one number per lane. It does not depend
on the compiler: see `dynamics.backends`.
"""

import math
from typing import Any

Statement = tuple[str, tuple[int, ...]]  # operation, operand numbers


class Code:
    """Straight-line code in SSA form; equal operations are emitted once and share a number."""

    def __init__(self) -> None:
        self.statements: list[Statement] = []
        self.names: dict[int, str] = {}  # number -> literal, for constants
        self._numbers: dict[tuple[Any, ...], int] = {}

    def emit(self, op: str, *args: int) -> int:
        """Number of the value `op(args)`."""
        key = (op, *(sorted(args) if op in "+*" else args))
        if key not in self._numbers:
            self._numbers[key] = len(self.statements)
            self.statements.append((op, args))
        return self._numbers[key]

    def constant(self, value: float) -> int:
        """Number of a literal."""
        if not math.isfinite(value):
            raise ValueError(
                f"The arm's equations hold a number that is not finite ({value!r}): its lengths, "
                "masses and stiffnesses are too far apart for double precision."
            )
        number = self.emit(f"const {value!r}")
        self.names[number] = f"({value!r})" if value < 0.0 else repr(value)
        return number

    def text(self, number: int) -> str:
        """Operand text of a value: a literal or the name of a variable."""
        return self.names.get(number, f"x{number}")

    def load(self, slot: int) -> int:
        """Number of the value loaded from a slot of the workspace."""
        return self.emit(f"load {slot}")
