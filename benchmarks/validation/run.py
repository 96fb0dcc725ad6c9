"""Every published number that can be checked, beside ours: docs/validation.md and its data.

    python -m benchmarks.validation [--quick] [--out docs/validation.md]

Writes the page, `results/validation.json` beside it and the figures. `--quick` runs the short form
and only compares its verdicts with the stored ones; it exits with 1 where one differs.
Each source has a module validation_*.py, listed in SOURCES: tables() of its numbers, and NOTES that
say for each of its chapters what "theirs" are.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.output import ROOT, provenance
from benchmarks.validation import beams as validation_beams
from benchmarks.validation import counts as validation_counts
from benchmarks.validation import korayem as validation_korayem
from benchmarks.validation import large_arms as validation_large_arms
from benchmarks.validation import pd as validation_pd
from benchmarks.validation import presets as validation_presets
from benchmarks.validation import slim as validation_slim
from benchmarks.validation.entries import Table
from benchmarks.validation.page import page

SOURCES = (
    validation_korayem, validation_slim, validation_pd, validation_large_arms, validation_beams,
    validation_counts, validation_presets,
)  # fmt: skip
PICTURES = (validation_pd, validation_korayem)
PAGE = ROOT / "docs" / "validation.md"


def data_of(page_file: Path) -> Path:
    """Where the numbers of a page lie."""
    return page_file.parent / "results" / "validation.json"


def run(quick: bool = False) -> list[dict[str, Any]]:
    """All tables, or those of the short form, with their results."""
    result = []
    for table in _tables(quick):
        print(f"{table.chapter}: {table.title}", file=sys.stderr, flush=True)
        result.append({
            "chapter": table.chapter,
            "title": table.title,
            "demand": table.demand,
            "quick": table.quick,
            "rows": table.results(),
        })  # fmt: skip
    return result


def _tables(quick: bool) -> list[Table]:
    tables = [table for source in SOURCES for table in source.tables()]
    return [table for table in tables if table.quick or not quick]


def verdicts(tables: list[dict[str, Any]], quick: bool = False) -> dict[str, str]:
    """Every number's full name -> its verdict."""
    return {
        " / ".join((table["chapter"], table["title"], str(k), row["quantity"])): row["verdict"]
        for table in tables
        for k, row in enumerate(table["rows"])
        if table["quick"] or not quick
    }


def changed(found: dict[str, str], stored: dict[str, str]) -> list[str]:
    """One line per verdict that differs, is new, or has gone."""
    return [
        f"{name}: {stored.get(name, 'not stored')} -> {found.get(name, 'gone')}"
        for name in sorted(found.keys() | stored.keys())
        if found.get(name) != stored.get(name)
    ]


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or check the short form against the stored verdicts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="compare verdicts only, a minute")
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args(arguments)
    tables = run(options.quick)
    stored = data_of(options.out)
    if options.quick:
        known = verdicts(json.loads(stored.read_text(encoding="utf-8"))["tables"], quick=True)
        differences = changed(verdicts(tables), known)
        print("\n".join(differences) or f"{len(known)} verdicts as stored")
        return 1 if differences else 0
    stored.parent.mkdir(parents=True, exist_ok=True)
    for source in PICTURES:
        source.draw(stored.parent)
    notes = {chapter: note for source in SOURCES for chapter, note in source.NOTES.items()}
    results = {**provenance("numpy", "scipy", "casadi", "numba"), "notes": notes, "tables": tables}
    results["command"] = "python -m benchmarks.validation"
    stored.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    options.out.write_text(page(results) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
