"""Columns of MAT files up to version 7.2: vectors, matrices, structs and Simulink's logs.

| name | column |
|------|--------|
| `speed` | a vector |
| `data:2` | the second column of a matrix; its second row where the samples run along the rows |
| `run.speed` | a field of a struct |
| `run.Y:2.Data` | a field of the second struct of an array |
| `cells:2` | the second vector of a cell array |
| `scope.time` | of a structure with time, the time |
| `scope.LABEL`, `scope.signals:2` | of a structure with time, a signal by label or number |

A colon and a number may follow each of them whose values are a matrix.
"""

import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.measured.columns import require
from dynamics.types import AnyArray, Array


def read_mat(paths: Sequence[Path], names: Sequence[str]) -> dict[str, Array]:
    """Columns of the MAT files of one run by name.

    Raises
    ------
    ValueError : for a file that cannot be read, a column that it does not hold, and a variable that
        is no vector of numbers.
    """
    columns: list[tuple[str, AnyArray | str]] = []
    opaque = False
    for path in paths:
        variables = _variables(path)
        opaque |= "__function_workspace__" in variables
        for name, value in variables.items():
            columns += [] if name.startswith("__") else _columns(name, value)
    vectors = [(name, value) for name, value in columns if not isinstance(value, str)]
    others = {name: value for name, value in columns if isinstance(value, str)}
    for name in names:
        if name in others:
            raise ValueError(f"variable {name!r} must be a vector of numbers, got {others[name]}.")
        if opaque and name not in dict(vectors):
            raise ValueError(
                f"holds no column {name!r} that can be read, but an object, such as a timeseries "
                "or a table; save its parts: time = ts.Time; data = ts.Data."
            )
    require(names, [name for name, _ in vectors])
    return {name: dict(vectors)[name].astype(np.float64) for name in names}


def _variables(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found: dict[str, Any] = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise ValueError("is a MAT file of version 7.3; save it with -v7.") from None
    except (MatReadError, OSError, TypeError, LookupError, ValueError, zlib.error) as error:
        raise ValueError(f"cannot be read as a MAT file ({error}).") from None
    return found


def _columns(name: str, value: Any) -> Iterator[tuple[str, AnyArray | str]]:
    """Vectors of a variable by name; in place of other values, words that describe them."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = value.ravel("F").tolist()  # the cells of an array, in MATLAB's order
    if isinstance(value, list):
        for k, one in enumerate(value, 1):
            yield from _columns(f"{name}:{k}", one)
    elif isinstance(value, dict):
        for key, one in value.items():
            signals = _signals(one) if key == "signals" else []
            for k, signal in enumerate(signals, 1):
                for title in (f"signals:{k}", signal.get("label")):
                    if isinstance(title, str) and title:
                        yield from _columns(f"{name}.{title}", signal["values"])
            if not signals:
                yield from _columns(f"{name}.{key}", one)
    else:
        yield from _vectors(name, value)


def _signals(value: Any) -> list[dict[str, Any]]:
    """Signals of a structure with time; none of any other field."""
    found = value if isinstance(value, list) else [value]
    return found if all(isinstance(one, dict) and "values" in one for one in found) else []


def _vectors(name: str, value: Any) -> Iterator[tuple[str, AnyArray | str]]:
    array = np.asarray(value) if isinstance(value, int | float | np.ndarray) else None
    if array is None or array.dtype.kind not in "buif" or array.ndim > 2:
        words = type(value).__name__ if array is None else f"{array.dtype} of shape {array.shape}"
        yield name, words
    elif array.ndim < 2:
        yield name, array.ravel()
    else:
        table = array if len(array) >= array.shape[1] else array.T
        yield name, f"a matrix of shape {array.shape}: name {name}:1 to {name}:{table.shape[1]}"
        for k, column in enumerate(table.T, 1):
            yield f"{name}:{k}", column
