"""Published numbers that a preset must reproduce.

Every preset lists them as CHECKS; the tests and the validation page evaluate them.
"""

from collections.abc import Callable
from dataclasses import dataclass

from dynamics.description.arm import Arm


@dataclass(frozen=True, kw_only=True)
class Check:
    """Published or independently computed value, and the function that measures it on the arm."""

    quantity: str
    unit: str
    expected: float
    tolerance: float  # [-] relative
    source: str
    measure: Callable[[Arm], float]

    def passes(self, arm: Arm) -> bool:
        """True if the arm's value is within the tolerance."""
        return abs(self.measure(arm) - self.expected) <= self.tolerance * abs(self.expected)
