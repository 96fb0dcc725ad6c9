"""Physical quantities from the observations of an environment."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.types import AnyArray, Array


@dataclass(frozen=True)
class Reading:
    """Parts of an observation in physical units; observations are (size,) or (N, size)."""

    slices: dict[str, slice]
    scales: dict[str, Array]

    @classmethod
    def of(cls, env: Any) -> "Reading":
        """Reading of an environment or a batch."""
        base = env.unwrapped
        return cls(base.observation_slices, base.observation_scales)

    def __contains__(self, name: str) -> bool:
        return name in self.slices

    def __call__(self, observation: AnyArray, name: str) -> Array:
        """(..., k) values of a part."""
        x = np.asarray(observation, dtype=np.float64)
        return np.asarray(x[..., self.slices[name]] * self.scales[name])

    def require(self, controller: str, *names: str) -> None:
        """Refuse an environment whose observations lack a part."""
        missing = [name for name in names if name not in self]
        if missing:
            kind = "state" if "modal_amplitude" in names else "sensors"
            raise ValueError(
                f"{controller} needs obs={kind!r}: the observation has no {', '.join(missing)}."
            )
