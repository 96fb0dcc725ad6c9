"""A chosen model with its ladder: all models and steps that were measured."""

import math
from dataclasses import dataclass
from typing import Any

from dynamics.description.arm import Arm


class NoModel(RuntimeError):
    """A search has ended without a model, a step or a reference that keeps the tolerance."""


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One measured model or step; errors are the largest distance of the tip [m]."""

    description: str
    error: float  # from the reference, a step's integration error added; infinite if diverged
    truncation: float | None = None  # from the model of the same kind with all modes
    nonlinear: float | None = None  # of the model of the same kind with all modes
    integration: float | None = None  # of this step alone
    operations: int  # per evaluation of the accelerations
    cost: float | None = None  # operations per simulated second


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Model, integrator and step that `choose_model` found, with all measured alternatives."""

    arm: Arm
    integrator: str
    dt: float  # [s]
    tolerance: float  # [m]
    error: float  # [m] model error plus integration error
    residual: float  # [m] tip displacement by the last refinement of the reference
    cost: float  # operations per simulated second
    reason: str
    reference: str
    scene: str
    ladder: tuple[Rung, ...]

    def to_dict(self) -> dict[str, Any]:
        """Fields as JSON lists, numbers and text; an infinite error becomes "diverged"."""
        values = {**vars(self), "arm": self.arm.to_dict()}
        values["ladder"] = [
            {k: "diverged" if v == math.inf else v for k, v in vars(rung).items()}
            for rung in self.ladder
        ]
        return values

    def table(self) -> str:
        """The ladder as a Markdown table."""
        head = "| model | error [m] | modes | nonlinear | integration | operations | per second |"
        rows = [head, "|---|---|---|---|---|---|---|"]
        for rung in self.ladder:
            errors = (rung.error, rung.truncation, rung.nonlinear, rung.integration)
            cells = [rung.description, *map(metres, errors), str(rung.operations)]
            cells.append("" if rung.cost is None else f"{rung.cost:.3g}")
            rows.append(f"| {' | '.join(cells)} |")
        return "\n".join(rows)


def metres(value: float | None) -> str:
    """Length [m] with two digits; "diverged" if infinite, nothing for None."""
    if value is None:
        return ""
    return "diverged" if value == math.inf else f"{value:.2g}"
