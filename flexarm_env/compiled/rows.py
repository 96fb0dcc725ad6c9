"""Named rows of an array."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dynamics.description.validate import shown
from dynamics.tracing.traced_arm import slices
from dynamics.types import Array


@dataclass(frozen=True)
class Rows:
    """Named groups of consecutive rows of an array."""

    sizes: Mapping[str, int]  # rows of each name, in order

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Rows of each name."""
        return slices(self.sizes)

    @cached_property
    def total(self) -> int:
        """Number of rows."""
        return sum(self.sizes.values())

    def packed(self, values: Mapping[str, Any], dtype: str) -> Array:
        """(total,) values in the order of the rows; refuse numbers beyond the range of `dtype`."""
        result = np.concatenate([np.ravel(values[name]) for name in self.sizes])
        for name, rows in self.slices.items():
            if not (np.abs(result[rows]) < np.finfo(dtype).max).all():
                raise ValueError(
                    f"{name} is beyond what {dtype} can hold, got {shown(result[rows])}: "
                    "torque_limit, control_dt or the arm's numbers are too far apart."
                )
        return result
