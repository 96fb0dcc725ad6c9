"""Controllers without feedback: zero torque and random torque."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.types import AnyArray


@dataclass(frozen=True, kw_only=True)
class Zero:
    """Zero torque, as a baseline."""

    n_torque: int

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Zero actions."""
        return np.zeros((*np.shape(observation)[:-1], self.n_torque)), state


class Random:
    """Uniformly random actions, determined by the seed."""

    def __init__(self, n_torque: int, seed: int = 0) -> None:
        self.n_torque = n_torque
        self.rng = np.random.default_rng(seed)

    def predict(
        self,
        observation: AnyArray,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions drawn from [-1, 1]."""
        return self.rng.uniform(-1.0, 1.0, (*np.shape(observation)[:-1], self.n_torque)), state
