"""Checks of single values at the boundary: each returns the clean value or raises one sentence."""

import difflib
import math
from collections.abc import Collection, Mapping
from numbers import Integral, Real

import numpy as np

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

ZEROS: Matrix = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

_LARGEST = 1e30  # in any SI unit; beyond it, and for a length below its inverse, floats overflow
_ORTHONORMAL = 1e-9  # [-] largest entry of R'R - 1 of a mounting rotation
_ROUND_OFF = 1e-15  # [-] of a length that is one
_UNIT = 1e-6  # [-] largest error of a quaternion's length
_SYMMETRIC = 1e-9  # [-] largest asymmetry of an inertia, relative to its largest entry


def number(value: object, name: str, unit: str = "") -> float:
    """A finite float; booleans and text are not numbers."""
    what = f"{name}{f' [{unit}]' if unit else ''}"
    if isinstance(value, str):
        remedy = "remove the quotes; YAML reads 3e-4 as text, write 3.0e-4"
        raise ValueError(f"{what} must be a number, got the text {value!r} ({remedy}).")
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ValueError(f"{what} must be a number, got {_short(value)}.")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise ValueError(f"{what} must be a finite number, got {_short(value)}.")
    if abs(result) > _LARGEST:
        raise ValueError(f"{what} must be at most {_LARGEST:g} in size, got {result!r}.")
    return result


def positive(value: object, name: str, unit: str) -> float:
    """A finite float above zero."""
    result = number(value, name, unit)
    if not result > 0.0:
        raise ValueError(f"{name} must be positive, got {result!r}. Unit: [{unit}].")
    if result < 1.0 / _LARGEST:
        raise ValueError(f"{name} [{unit}] must be at least {1.0 / _LARGEST:g}, got {result!r}.")
    return result


def nonnegative(value: object, name: str, unit: str) -> float:
    """A finite float, zero or above."""
    result = number(value, name, unit)
    if not result >= 0.0:
        raise ValueError(f"{name} must not be negative, got {result!r}. Unit: [{unit}].")
    return result


def integer(value: object, name: str, least: int, most: int) -> int:
    """An int between two bounds, both allowed; 2.0 is not an int."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ValueError(f"{name} must be an int, got {_short(value)}.")
    result = int(value)
    if not least <= result <= most:
        raise ValueError(f"{name} must be between {least} and {most}, got {_short(result)}.")
    return result


def choice(value: object, name: str, known: Collection[str]) -> str:
    """One of a few words."""
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} must be one of {sorted(known)}, got {_short(value)}.")
    return value


def text(value: object, name: str) -> str:
    """A string."""
    if not isinstance(value, str):
        raise ValueError(f"{name} must be text, got {_short(value)}.")
    return value


def numbers(value: object, name: str, size: int | None = None, unit: str = "") -> tuple[float, ...]:
    """(size,) finite floats from a list, tuple or array."""
    entries = sequence(value, name)
    if size is not None and len(entries) != size:
        raise ValueError(f"{name} must have {size} numbers, got {len(entries)}: {_short(value)}.")
    return tuple(number(entry, f"{name}[{k}]", unit) for k, entry in enumerate(entries))


def vector(value: object, name: str, unit: str) -> Vector:
    """(3,) finite floats."""
    x, y, z = numbers(value, name, 3, unit)
    return (x, y, z)


def matrix(value: object, name: str, unit: str) -> Matrix:
    """(3, 3) finite floats, row by row."""
    rows = sequence(value, name)
    if len(rows) != 3:
        raise ValueError(f"{name} must have 3 rows of 3 numbers, got {len(rows)} rows.")
    a, b, c = (vector(row, f"{name}[{k}]", unit) for k, row in enumerate(rows))
    return (a, b, c)


def inertia(value: object, name: str) -> Matrix:
    """A symmetric, positive semidefinite inertia matrix (3, 3) [kg m^2]; zero is allowed."""
    result = matrix(value, name, "kg m^2")
    entries = np.array(result)
    largest = float(np.abs(entries).max())
    if np.abs(entries - entries.T).max() > _SYMMETRIC * largest:
        raise ValueError(f"{name} must be symmetric, got {_short(value)}.")
    least = float(np.linalg.eigvalsh(entries)[0])
    if least < -_SYMMETRIC * largest:
        raise ValueError(
            f"{name} must have no negative principal moment, got {least:.6g} in {_short(value)}."
        )
    return result


def solid(value: Matrix, name: str) -> None:
    """Refuse an inertia (3, 3) that no body with extent has."""
    least, middle, most = (float(x) for x in np.linalg.eigvalsh(np.array(value)))
    if not least > _SYMMETRIC * most or most > (1.0 + _SYMMETRIC) * (least + middle):
        raise ValueError(
            f"{name} must be positive definite, no principal moment above the sum of the others, "
            f"got the moments {least:.6g}, {middle:.6g}, {most:.6g}. Unit: [kg m^2]."
        )


def quaternion(value: object, name: str) -> tuple[float, float, float, float]:
    """A unit quaternion [w, x, y, z]; rounding is taken back."""
    w, x, y, z = numbers(value, name, 4)
    size = math.hypot(w, x, y, z)
    if abs(size - 1.0) > _UNIT:
        raise ValueError(
            f"{name} must have length 1 [w, x, y, z], got length {size:.6g} in {_short(value)}; "
            "divide by it."
        )
    if abs(size - 1.0) < _ROUND_OFF:  # normalised before: leave it
        return (w, x, y, z)
    return (w / size, x / size, y / size, z / size)


def rotation(value: object, name: str) -> Matrix:
    """A proper rotation matrix (3, 3): orthonormal, determinant +1."""
    result = matrix(value, name, "-")
    entries = np.array(result)
    determinant = float(np.linalg.det(entries))
    if np.abs(entries.T @ entries - np.eye(3)).max() > _ORTHONORMAL or determinant < 0.0:
        raise ValueError(
            f"{name} must be a rotation (orthonormal, determinant +1), got determinant "
            f"{determinant:.6g} in {_short(value)}."
        )
    return result


def sequence(value: object, name: str) -> list[object]:
    """The entries of a list, tuple or array."""
    if not isinstance(value, list | tuple | np.ndarray):
        raise ValueError(f"{name} must be a list, got {_short(value)}.")
    return list(value)


def mapping(value: object, name: str, known: Collection[str]) -> dict[str, object]:
    """A mapping whose keys are all known."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping of keys to values, got {_short(value)}.")
    for key in value:
        if key not in known:
            near = difflib.get_close_matches(str(key), sorted(known), n=1, cutoff=0.0)
            raise ValueError(f"Unknown key {_short(key)} in {name}; nearest known: {near[0]!r}.")
    return dict(value)


def _short(value: object) -> str:
    """A value as it looks in an error sentence: one line, not too long."""
    plain = value.tolist() if isinstance(value, np.ndarray) else value
    shown = " ".join(repr(plain).split())
    return shown if len(shown) <= 80 else f"{shown[:77]}..."
