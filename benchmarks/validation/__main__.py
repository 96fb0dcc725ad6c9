"""Published numbers compared with ours: docs/validation.md and its data.

    python -m benchmarks.validation [--quick] [--out docs/validation.md]

Writes the page, `results/validation.json` beside it and the figures. `--quick` runs the short form,
compares its verdicts with the stored ones and writes nothing; it exits with 1 if one differs.
Each source has a module in benchmarks/validation, listed in SOURCES. The module has `tables()` of
its numbers, and `NOTES` that define "theirs" for each of its chapters.
"""

import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.output import ROOT, argument_parser, provenance
from benchmarks.validation import beams, counts, korayem, large_arms, pd, presets, slim
from benchmarks.validation.entries import Table
from benchmarks.validation.page import page

SOURCES = (korayem, slim, pd, large_arms, beams, counts, presets)
PICTURES = (pd, korayem)
PAGE = ROOT / "docs" / "validation.md"


def data_of(page_file: Path) -> Path:
    """File of a page's numbers."""
    return page_file.parent / "results" / "validation.json"


def run(quick: bool = False) -> list[dict[str, Any]]:
    """Results of all tables, or of those in the short form."""
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
    """Verdict of every number, by the number's full name."""
    return {
        " / ".join((table["chapter"], table["title"], str(k), row["quantity"])): row["verdict"]
        for table in tables
        for k, row in enumerate(table["rows"])
        if table["quick"] or not quick
    }


def changed(found: dict[str, str], stored: dict[str, str]) -> list[str]:
    """A line for each verdict that is different, new or missing."""
    return [
        f"{name}: {stored.get(name, 'not stored')} -> {found.get(name, 'gone')}"
        for name in sorted(found.keys() | stored.keys())
        if found.get(name) != stored.get(name)
    ]


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or compare the short form with the stored verdicts."""
    parser = argument_parser("validation", __doc__)
    parser.add_argument(
        "--quick", action="store_true", help="only compare the verdicts of the short form (1 min)"
    )
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
