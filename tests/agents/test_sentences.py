"""Numbers in texts."""

import math

import pytest

from agents.sentences import plain


@pytest.mark.parametrize(
    ("value", "style", "text"),
    [
        (1023.4, ".3g", "1020"),
        (99.6, ".2g", "100"),
        (5.2e-5, ".2g", "5.2e-05"),
        (12.34, ".3g", "12.3"),
        (1023.4, ".2f", "1023.40"),
        (math.inf, ".3g", "inf"),
    ],
)
def test_large_numbers_have_no_power_of_ten(value: float, style: str, text: str) -> None:
    assert plain(value, style) == text
