"""Named rows of an array."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dynamics.description.validate import shown
from dynamics.types import Array


@dataclass(frozen=True)
class Rows:
    """Named runs of rows in an array."""

    sizes: Mapping[str, int]

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where each name is."""
        result, start = {}, 0
        for name, size in self.sizes.items():
            result[name] = slice(start, start + size)
            start += size
        return result

    @cached_property
    def total(self) -> int:
        """How many rows."""
        return sum(self.sizes.values())

    def packed(self, values: Mapping[str, Any], dtype: str) -> Array:
        """(total,) values by name, in the order of the rows."""
        result = np.concatenate([np.ravel(values[name]) for name in self.sizes])
        for name, rows in self.slices.items():
            if not (np.abs(result[rows]) < np.finfo(dtype).max).all():
                raise ValueError(
                    f"{name} is beyond what {dtype} can hold, got {shown(result[rows])}: "
                    "torque_limit, control_dt or the arm's numbers are too far apart."
                )
        return result
