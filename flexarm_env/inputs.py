"""Checks of what an environment is given beside its arm."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.free_parameters import FREE_PARAMETERS

Array = NDArray[np.float64]


def ranges(given: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Checked ranges of free parameters."""
    unknown = sorted(set(map(str, given)) - set(FREE_PARAMETERS))
    if unknown:
        raise ValueError(f"Unknown randomize {unknown}. Known: {sorted(FREE_PARAMETERS)}.")
    for name, pair in given.items():
        low, high = per_row(f"randomize[{name!r}]", pair, 2, 1)
        if not 0.0 <= low <= high:
            raise ValueError(
                f"randomize[{name!r}] must be (low, high) with 0 <= low <= high, got {pair!r}."
            )
    return {name: (float(low), float(high)) for name, (low, high) in given.items()}


def whole(name: str, value: Any, least: int) -> None:
    """An int, `least` or more."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}, got {value!r}.")


def per_row(name: str, values: Any, size: int, n_row: int) -> Array:
    """Numbers for each of `n_row` environments, or a sentence; None means zeros."""
    if values is None:
        return np.zeros(size)
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be {size} numbers, got {values!r}.") from None
    if array.shape not in ((size,), (n_row, size)) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be {size} finite numbers, got {values!r}.")
    return array
