"""`flexarm fit`: table, files and refusals; the page and its picture."""

import json
from pathlib import Path

import pytest

from agents.fit import EXAMPLE, main
from benchmarks.measured_data import COMMAND, page_table
from benchmarks.output import RESULTS
from tests.paths import ROOT

LOG = str(RESULTS / "measured_data.csv")
STORED = json.loads((RESULTS / "measured_data.json").read_text(encoding="utf-8"))
PAGE = (ROOT / "docs" / "measured_data.md").read_text(encoding="utf-8")


def test_the_stored_log_gives_the_stored_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([LOG, *COMMAND, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    found = json.loads((tmp_path / "fit.json").read_text())
    for name, stored in STORED["fit"]["parameters"].items():
        assert found["parameters"][name]["value"] == pytest.approx(stored["value"], rel=1e-6)
    assert (tmp_path / "overlay.png").stat().st_size > 10_000
    for line in said.splitlines()[:-1]:
        assert line in PAGE, line


def test_the_page_shows_the_stored_coverage() -> None:
    assert page_table(STORED["cases"]) in PAGE
    assert EXAMPLE.split()[0] == "flexarm"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"--arm": ["slimm"]}, "Unknown arm 'slimm'"),
        ({"--time": ["time"]}, "holds no column 'time'; it holds"),
        ({"--gauge-at": ["1"]}, "--gauge-at takes LINK:X[:DISTANCE], got '1'"),
        ({"--gauge-at": ["0:0.02:0.001"]}, "counts links from 1"),
        ({"--gauge-at": ["1:0.02"]}, "needs LINK:X:DISTANCE for microstrain"),
        ({"--gauge-at": ["2:0.02:0.001"]}, "link must be"),
        ({"--gauge-at": ["1:2.0:0.001"]}, "x must be within the link"),
        ({"--units": ["gauge=1/m"]}, "give the unit: --units gauge=strain"),
        ({"--units": ["ms"]}, "--units takes NAME=VALUE"),
        ({"--fit": ["stiffness"]}, "--fit takes NAME=VALUE"),
        ({"--fit": ["stiffness=1"]}, "--fit takes NAME=LOW:HIGH"),
        ({"--fit": ["mass=0:1"]}, "mass"),
    ],
)
def test_bad_command_lines_end_with_one_sentence(
    change: dict[str, list[str]],
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (option, values) = next(iter(change.items()))
    given = [LOG, *COMMAND]
    if option in given:
        start = given.index(option) + 1
        stop = next((k for k in range(start, len(given)) if given[k].startswith("--")), len(given))
        given[start:stop] = values
    else:
        given += [option, *values]
    out = tmp_path / "out"
    assert main([*given, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1
    assert not out.exists()
