"""Conditions under which errors of an environment were measured, and those of one to be made."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from dynamics.formulations.free_parameters import FREE_PARAMETERS

Range = tuple[float, float]
ROUND_OFF = 1e-9  # [-] of a limit


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Torques, drawn parameters, actuators, bending and events of an environment's episodes."""

    torque_limit: tuple[float, ...]  # [N m] of each action
    deflection_limit: float  # [-]
    ranges: Mapping[str, Range] = field(default_factory=dict)  # of parameters drawn at a reset
    actuators: str = ""  # their description; empty for ideal torque sources
    push: float = 0.0  # [N s] largest impulse at the tip
    drop: bool = False  # whether a payload is let go of in mid-episode

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> "Conditions":
        """Conditions from JSON numbers and text."""
        ranges = {name: tuple(pair) for name, pair in stored["ranges"].items()}
        return cls(
            torque_limit=tuple(stored["torque_limit"]),
            deflection_limit=stored["deflection_limit"],
            ranges=ranges,
            actuators=stored["actuators"],
            push=stored.get("push", 0.0),
            drop=stored.get("drop", False),
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON numbers and text; an event that there is."""
        found = asdict(self) | {"ranges": {name: list(x) for name, x in self.ranges.items()}}
        return {key: x for key, x in found.items() if x or key not in ("push", "drop")}

    def beyond(self, measured: "Conditions") -> str | None:
        """Words for a part of these conditions that measured ones do not cover, or None."""
        if self.actuators != measured.actuators:
            return "these actuators" if self.actuators else "ideal torque sources"
        if len(self.torque_limit) != len(measured.torque_limit):
            return "base_torque"
        for own, most in zip(self.torque_limit, measured.torque_limit, strict=True):
            if own > most * (1.0 + ROUND_OFF):
                return f"torques above {', '.join(f'{x:g}' for x in measured.torque_limit)} N m"
        if self.push > measured.push * (1.0 + ROUND_OFF):
            return f"pushes at the tip of up to {self.push:.3g} N s"
        if self.drop and not measured.drop:
            return "a payload that is dropped in mid-episode"
        for name, (low, high) in self.ranges.items():
            known = measured.ranges.get(name)
            if known is None or low < known[0] - ROUND_OFF or high > known[1] + ROUND_OFF:
                return f"{name} drawn from {low:g} to {high:g} at resets"
        for name in sorted(measured.ranges.keys() - self.ranges.keys()):
            low, high = measured.ranges[name]
            if not low - ROUND_OFF <= FREE_PARAMETERS[name].nominal <= high + ROUND_OFF:
                return f"the described {name}"
        if self.deflection_limit > measured.deflection_limit * (1.0 + ROUND_OFF):
            return f"deflections above {measured.deflection_limit:g} of a link's length"
        return None

    def part(self, measured: "Conditions") -> str | None:
        """Words for a parameter drawn otherwise than under conditions that cover these, or None.

        What 95 of 100 plants keep, the 95 of 100 of a part of them need not.
        """
        for name in sorted({*self.ranges, *measured.ranges}):
            nominal = (FREE_PARAMETERS[name].nominal,) * 2
            own, known = (np.array(x.ranges.get(name, nominal)) for x in (self, measured))
            if np.abs(own - known).max() > ROUND_OFF:
                return f"{name} drawn from {own[0]:g} to {own[1]:g} at resets"
        return None
