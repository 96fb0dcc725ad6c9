"""JSON of results."""

import json
import math
from pathlib import Path

import numpy as np

from agents.files import without_infinities, write_json


def test_json_has_a_list_of_numbers_in_one_line(tmp_path: Path) -> None:
    """Texts stay as they are, also those that look like such lists."""
    data = {"curve": [[0.1, math.inf], [2, None], []], "text": ["[\n 1,\n 2\n]"], "of": [{"a": 1}]}
    write_json(tmp_path / "data.json", data)
    text = (tmp_path / "data.json").read_text()
    assert json.loads(text) == without_infinities(data)
    assert [line.strip() for line in text.splitlines()[2:4]] == ["[0.1, null],", "[2, null],"]


def test_trees_without_infinities_are_plain_and_whole() -> None:
    tree = {
        1: [math.inf, 2.0, "inf"],
        "a": (np.float64(1.5), np.float32(np.nan), np.int64(3), None, True),
        "b": np.array([[1.0, -np.inf]]),
    }
    found = without_infinities(tree)
    assert found == {
        "1": [None, 2.0, "inf"], "a": [1.5, None, 3, None, True], "b": [[1.0, None]],
    }  # fmt: skip
    assert [type(x) for x in found["a"]] == [float, type(None), int, type(None), bool]
