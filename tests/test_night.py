"""Lists of tests name tests that exist."""

import re
from collections import defaultdict

import pytest

from tests.conftest import NIGHT, QUICK, name_of
from tests.paths import ROOT


def test_what_waits_for_the_night_is_a_test() -> None:
    for file, tests in NIGHT.items():
        functions = re.findall(r"^def (\w+)", (ROOT / "tests" / file).read_text("utf-8"), re.M)
        assert tests.keys() <= set(functions), file


def test_what_stays_by_day_is_a_parameter(request: pytest.FixtureRequest) -> None:
    """Of the whole suite alone: of a part of it, not all parameters are known."""
    names = defaultdict(list)
    for item in request.session.items:
        names[name_of(item)].append(item.name)
    asked = {file for file, tests in NIGHT.items() if any(tests.values())}
    if not asked <= names.keys() or request.config.option.keyword:
        pytest.skip("a part of the suite")
    for file in asked:
        for test, parts in NIGHT[file].items():
            named = [name for name in names[file] if name.split("[")[0] == test]
            assert all(any(part in name for name in named) for part in parts), (file, test)


def test_quick_files_are_there() -> None:
    assert [file for file in sorted(QUICK) if not (ROOT / "tests" / file).is_file()] == []
