"""The short paper: its figures are those of docs/results, and it has no others."""

import re

from benchmarks.output import filled
from benchmarks.paper import PAGE, blocks
from tests.paths import ROOT


def test_the_figures_of_the_paper_are_those_of_the_results() -> None:
    """If not: python -m benchmarks.paper"""
    page = PAGE.read_text(encoding="utf-8")
    assert filled(page, blocks()) == page


def test_optimal_torques_are_no_controller() -> None:
    assert "optimal" not in blocks()["control"]


def test_the_text_between_the_blocks_has_no_figures() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in blocks():
        text, count = re.subn(f"<!-- {name} -->.*?<!-- /{name} -->", "", text, flags=re.S)
        assert count == 1, name
    assert re.findall(r"[^\n]*\d[^\n]*", text) == []


def test_a_changed_figure_is_noticed() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for text in blocks().values():
        other = re.sub(r"\d", lambda found: str((int(found[0]) + 1) % 10), text, count=1)
        changed = page.replace(text, other)
        assert changed != page
        assert filled(changed, blocks()) == page


def test_the_links_of_the_paper_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)", PAGE.read_text(encoding="utf-8")):
        assert (PAGE.parent / target).resolve().is_relative_to(ROOT)
        assert (PAGE.parent / target).exists(), target
