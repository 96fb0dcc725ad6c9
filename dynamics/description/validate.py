"""Input checks: each returns the converted value or raises ValueError with one sentence."""

import difflib
import math
import reprlib
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral, Real
from typing import TypeVar

import numpy as np

from dynamics.types import Matrix3, Vector3

K = TypeVar("K")
T = TypeVar("T")

ZEROS: Matrix3 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
IDENTITY: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

_REPR = reprlib.Repr()  # shortens large and nested values
_REPR.maxlist = _REPR.maxtuple = _REPR.maxdict = 12
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 80
_LARGEST = 1e30  # in any SI unit; above it, or for a length below 1 / _LARGEST, floats overflow
_ENTRY_ROUND_OFF = 1e-14  # [-] error of an entry of a rotation that is 0 or +-1
_ORTHONORMAL = 1e-9  # [-] largest entry of R'R - 1 of a mounting rotation
_ROUND_OFF = 1e-15  # [-] error of a quaternion's length that is left as it is
_UNIT = 1e-6  # [-] largest error of a quaternion's length
_TURN = 6.3  # [rad] a turn, rounded up
_SYMMETRIC = 1e-9  # [-] largest asymmetry of an inertia, relative to its largest entry


def number(value: object, name: str, unit: str = "") -> float:
    """Return a finite float; refuse booleans and text."""
    what = f"{name}{f' [{unit}]' if unit else ''}"
    if isinstance(value, str):
        raise ValueError(f"{what} must be a number, got the text {shown(value)} ({_plain(value)}).")
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ValueError(f"{what} must be a number, got {shown(value)}.")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise ValueError(f"{what} must be a finite number, got {shown(value)}.")
    if abs(result) > _LARGEST:
        raise ValueError(f"{what} must be at most {_LARGEST:g} in size, got {result!r}.")
    return result


def _plain(text: str) -> str:
    """Advice on a text where a number belongs."""
    try:
        float(text)
    except ValueError:
        return "write the number alone, such as 0.5 or 3.0e-4"
    return "remove the quotes; YAML reads 3e-4 as text, write 3.0e-4"


def positive(value: object, name: str, unit: str) -> float:
    """Return a finite float above zero."""
    result = number(value, name, unit)
    if not result > 0.0:
        raise ValueError(f"{name} must be positive, got {result!r}. Unit: [{unit}].")
    if result < 1.0 / _LARGEST:
        raise ValueError(f"{name} [{unit}] must be at least {1.0 / _LARGEST:g}, got {result!r}.")
    return result


def nonnegative(value: object, name: str, unit: str) -> float:
    """Return a finite float, zero or above."""
    result = number(value, name, unit)
    if not result >= 0.0:
        raise ValueError(f"{name} must not be negative, got {result!r}. Unit: [{unit}].")
    if 0.0 < result < 1.0 / _LARGEST:
        raise ValueError(
            f"{name} [{unit}] must be 0 or at least {1.0 / _LARGEST:g}, got {result!r}."
        )
    return result


def integer(value: object, name: str, least: int, most: int) -> int:
    """Return an int in least..most; refuse floats such as 2.0."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ValueError(f"{name} must be an int, got {shown(value)}.")
    result = int(value)
    if not least <= result <= most:
        raise ValueError(f"{name} must be between {least} and {most}, got {shown(result)}.")
    return result


def choice(value: object, name: str, known: Collection[str]) -> str:
    """Return a string if it is one of `known`; the message names the field."""
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} must be one of {sorted(known)}, got {shown(value)}.")
    return value


def clean(described: object, **values: object) -> None:
    """Store checked values in a frozen dataclass."""
    for name, value in values.items():
        object.__setattr__(described, name, value)


def instance(value: object, name: str, kind: type[T]) -> T:
    """Return an instance of the class `kind`."""
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be a {kind.__name__}, got {shown(value)}.")
    return value


def known(value: object, noun: str, names: Collection[str]) -> str:
    """Return a name if it is in a table; the message names the kind of entry, and a near name."""
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"{unknown(value, noun, names)} Known: {sorted(names)}.")
    return value


def unknown(value: object, noun: str, names: Collection[str]) -> str:
    """A sentence about a name that is not in a table, with a near one of the table."""
    near = difflib.get_close_matches(str(value)[:80], sorted(names), n=1)
    return f"Unknown {noun} {shown(value)}" + (f"; did you mean {near[0]!r}?" if near else ".")


def unique(pairs: Collection[tuple[K, T]], where: str = "one object") -> dict[K, T]:
    """Return the dict of pairs; refuse a key that stands twice."""
    result = dict(pairs)
    if len(result) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = sorted(str(key) for key in result if keys.count(key) > 1)
        raise ValueError(f"the keys {repeated} stand twice in {where}; keep one of each.")
    return result


def boolean(value: object, name: str) -> bool:
    """Return a bool; refuse 0 and 1."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false, got {shown(value)}.")
    return value


def text(value: object, name: str) -> str:
    """Return a string."""
    if not isinstance(value, str):
        raise ValueError(f"{name} must be text, got {shown(value)}.")
    return value


def numbers(value: object, name: str, size: int | None = None, unit: str = "") -> tuple[float, ...]:
    """Return (size,) finite floats from a list, tuple or array."""
    entries = sequence(value, name)
    if size is not None and len(entries) != size:
        raise ValueError(f"{name} must have {size} numbers, got {len(entries)}: {shown(value)}.")
    return tuple(number(entry, f"{name}[{k}]", unit) for k, entry in enumerate(entries))


def array(
    value: object, name: str, shape: tuple[int | None, ...], most: float = sys.float_info.max
) -> np.ndarray:
    """Return a copy as a float64 array of finite numbers; None in `shape` allows any length."""
    unmasked(value, name)
    try:
        given = np.asarray(value)
        result = np.array(given, dtype=np.float64) if given.dtype.kind in "iufO" else None
    except (TypeError, ValueError, OverflowError):
        result = None
    if result is None:
        raise ValueError(f"{name} must hold numbers, got {shown(value)}.")
    lengths = zip(result.shape, shape, strict=False)
    if result.ndim != len(shape) or any(b not in (None, a) for a, b in lengths):
        wanted = str(shape).replace("None", "N")
        raise ValueError(f"{name} must have shape {wanted}, got {result.shape}.")
    if not (np.abs(result) <= most).all():
        size = f" of at most {most:g} in size" if most < sys.float_info.max else ""
        raise ValueError(f"{name} must hold finite numbers{size}, got {shown(value)}.")
    return result


def unmasked(value: object, name: str) -> None:
    """Refuse a masked array with masked entries, whose hidden numbers would be used."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
        raise ValueError(
            f"{name} must have no masked entries, got {int(np.ma.count_masked(value))} of "
            f"{value.size}; fill them, as with filled(nan), or leave them out."
        )


def finite(values: np.ndarray, name: str) -> np.ndarray:
    """Return results at a state if all are finite."""
    if not np.isfinite(values).all():
        raise ValueError(
            f"{name} at this state must be finite: its deflections or rates are far beyond the "
            "range of the model."
        )
    return values


@contextmanager
def double_precision(what: str) -> Iterator[None]:
    """Raise ValueError if the block overflows, divides by zero or meets a singular matrix."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise ValueError(
            f"{what} cannot be computed in double precision ({error}): lengths, masses, "
            "stiffnesses or times are too far apart."
        ) from None


def vector(value: object, name: str, unit: str) -> Vector3:
    """Return (3,) finite floats."""
    x, y, z = numbers(value, name, 3, unit)
    return (x, y, z)


def matrix(value: object, name: str, unit: str) -> Matrix3:
    """Return (3, 3) finite floats, row by row."""
    rows = sequence(value, name)
    if len(rows) != 3:
        raise ValueError(f"{name} must have 3 rows of 3 numbers, got {len(rows)} rows.")
    a, b, c = (vector(row, f"{name}[{k}]", unit) for k, row in enumerate(rows))
    return (a, b, c)


def inertia(value: object, name: str) -> Matrix3:
    """Return a symmetric, positive semidefinite inertia (3, 3) [kg m^2]; zero is allowed."""
    result = matrix(value, name, "kg m^2")
    entries = np.array(result)
    largest = float(np.abs(entries).max())
    if np.abs(entries - entries.T).max() > _SYMMETRIC * largest:
        raise ValueError(f"{name} must be symmetric, got {shown(value)}.")
    least = float(np.linalg.eigvalsh(entries)[0])
    if least < -_SYMMETRIC * largest:
        raise ValueError(
            f"{name} must have no negative principal moment, got {least:.6g} in {shown(value)}."
        )
    return result


def solid(value: Matrix3, name: str) -> None:
    """Raise ValueError unless the inertia (3, 3) is that of a body with volume."""
    least, middle, most = (float(x) for x in np.linalg.eigvalsh(np.array(value)))
    if not least > _SYMMETRIC * most or most > (1.0 + _SYMMETRIC) * (least + middle):
        raise ValueError(
            f"{name} must be positive definite, no principal moment above the sum of the others, "
            f"got the moments {least:.6g}, {middle:.6g}, {most:.6g}. Unit: [kg m^2]."
        )


def radians(angles: Iterable[float], name: str) -> None:
    """Refuse angles of more than a turn, which are degrees."""
    for angle in angles:
        if abs(angle) > _TURN:
            raise ValueError(
                f"{name} must be in radians, at most a turn, got {angle:g}; {angle:g} degrees are "
                f"{math.radians(angle):.6g}."
            )


def quaternion(value: object, name: str) -> tuple[float, float, float, float]:
    """Return a unit quaternion [w, x, y, z], normalised; refuse other lengths."""
    w, x, y, z = numbers(value, name, 4)
    size = math.hypot(w, x, y, z)
    if abs(size - 1.0) > _UNIT:
        raise ValueError(
            f"{name} must have length 1 [w, x, y, z], got length {size:.6g} in {shown(value)}; "
            "divide by it."
        )
    if abs(size - 1.0) < _ROUND_OFF:  # already normalised
        return (w, x, y, z)
    return (w / size, x / size, y / size, z / size)


def rotation(value: object, name: str) -> Matrix3:
    """Return a proper rotation matrix (3, 3): orthonormal, determinant +1.

    Entries within round-off of 0 or +-1 become exact, so that a turn about an axis is recognised.
    """
    result = matrix(value, name, "-")
    entries = np.array(result)
    determinant = float(np.linalg.det(entries))
    if np.abs(entries.T @ entries - np.eye(3)).max() > _ORTHONORMAL or determinant < 0.0:
        raise ValueError(
            f"{name} must be a rotation (orthonormal, determinant +1), got determinant "
            f"{determinant:.6g} in {shown(value)}."
        )
    whole = np.round(entries)
    x, y, z = np.where(np.abs(entries - whole) < _ENTRY_ROUND_OFF, whole + 0.0, entries).tolist()
    return (tuple(x), tuple(y), tuple(z))


def sequence(value: object, name: str, most: int | None = None) -> list[object]:
    """Return the entries of a list, tuple or array, at most `most`."""
    if not isinstance(value, list | tuple | np.ndarray) or getattr(value, "ndim", 1) == 0:
        raise ValueError(f"{name} must be a list, got {shown(value)}.")
    if most is not None and len(value) > most:
        raise ValueError(f"{name} must have at most {most} entries, got {len(value)}.")
    return list(value)


def mapping(value: object, name: str, known: Collection[str]) -> dict[str, object]:
    """Return a mapping as a dict; refuse unknown keys."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping of keys to values, got {shown(value)}.")
    for key in value:
        if key not in known:
            near = difflib.get_close_matches(str(key), sorted(known), n=1, cutoff=0.0)
            remedy = f"nearest known: {near[0]!r}." if near else "it takes none."
            raise ValueError(f"Unknown key {shown(key)} in {name}; {remedy}")
    return dict(value)


def shown(value: object) -> str:
    """Format a value for an error message: one line of at most 80 characters."""
    plain = value.tolist() if isinstance(value, np.ndarray) and value.size < 20 else value
    try:
        if isinstance(plain, int):
            str(plain)  # too long for Python to print: an error, of which _REPR makes an address
        text = " ".join(_REPR.repr(plain).split())
    except Exception:  # an object whose repr fails
        text = f"a {type(value).__name__}"
    return text if len(text) <= 80 else f"{text[:77]}..."
