"""Published numbers that a preset is held to.

Every preset lists its own as CHECKS; the tests and the validation page run them.
"""

from collections.abc import Callable
from dataclasses import dataclass

from dynamics.description.arm import Arm


@dataclass(frozen=True, kw_only=True)
class Check:
    """A published or independent number beside a preset, and what the preset says."""

    quantity: str
    unit: str
    expected: float
    tolerance: float  # [-] relative
    source: str
    measure: Callable[[Arm], float]

    def passes(self, arm: Arm) -> bool:
        """Whether the arm meets the number."""
        return abs(self.measure(arm) - self.expected) <= self.tolerance * abs(self.expected)
