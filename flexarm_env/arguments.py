"""Checks of an environment's keywords: each returns the clean value or raises one sentence."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.free_parameters import FREE_PARAMETERS

Array = NDArray[np.float64]


def torque_limits(given: float | Sequence[float] | None, default: tuple[float, ...]) -> Array:
    """(n_joint,) [N m] one number for all joints or one per joint; `default` for None."""
    if given is None:
        return np.array(default)
    limit = np.asarray(given, dtype=np.float64)
    if limit.shape not in ((), (len(default),)):
        raise ValueError(
            f"torque_limit must be one number or {len(default)} (one per joint), "
            f"got {given!r}. Unit: [N m]."
        )
    if not (np.isfinite(limit).all() and (limit > 0.0).all()):
        raise ValueError(f"torque_limit must be positive, got {given!r}. Unit: [N m].")
    return np.full(len(default), limit) if limit.shape == () else limit.copy()


def ranges(given: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Ranges (low, high) of free parameters by name."""
    unknown = sorted(set(map(str, given)) - set(FREE_PARAMETERS))
    if unknown:
        raise ValueError(f"Unknown randomize {unknown}. Known: {sorted(FREE_PARAMETERS)}.")
    for name, pair in given.items():
        low, high = checked(f"randomize[{name!r}]", pair, 2, 1)
        if not 0.0 <= low <= high:
            raise ValueError(
                f"randomize[{name!r}] must be (low, high) with 0 <= low <= high, got {pair!r}."
            )
    return {name: (float(low), float(high)) for name, (low, high) in given.items()}


def require_whole(name: str, value: Any, least: int) -> None:
    """Refuse what is not a whole number, or too small."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}, got {value!r}.")


def checked(name: str, values: Any, size: int, n_row: int) -> Array:
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
