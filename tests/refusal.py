"""Values that make no sense, and what may happen when somebody gives them."""

import math
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from tests.paths import ROOT

SOURCES = str(ROOT)

NONSENSE: list[Any] = [
    None, "", "x", "a\0b", "a" * 1500, b"x", 1j, math.nan, math.inf, -math.inf, -1, 0, 10**30,
    1e300, True, [], [None], ["a"], [1, 2], [[1], [1, 2]], {}, {"a": 1}, {1: 2}, object(), type,
    np.zeros((2, 2)), np.array(1.0), np.array(["a"]), np.full(3, np.nan), lambda t: 0,
]  # fmt: skip


@contextmanager
def used_or_refused(*also: type[Exception]) -> Iterator[None]:
    """Pass, or a ValueError of one short sentence that a line of this package raised."""
    refusal = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            warnings.simplefilter("ignore", UserWarning)
            yield
    except ValueError as error:
        refusal = error
    except also:
        pass
    if refusal is not None:
        last = traceback.extract_tb(refusal.__traceback__)[-1]
        assert last.filename.startswith(SOURCES), f"{last}: {refusal}"
        assert "site-packages" not in last.filename, f"{last}: {refusal}"
        assert (last.line or "").startswith("raise "), f"{last}: {refusal}"
        assert len(str(refusal)) < 1000
