"""The stored results: packed JSON, in which an infinite error is the word "diverged"."""

import json
from pathlib import Path
from typing import Any

from agents.files import pack, unpacked
from benchmarks.output import RESULTS

STORED = RESULTS / "work_precision.json.bz2"


def store(results: dict[str, Any], file: Path) -> None:
    """Write results that are plain JSON."""
    pack(json.dumps(results, separators=(",", ":")), file)


def stored_results(file: Path) -> dict[str, Any]:
    """Results that a file holds."""
    found: dict[str, Any] = json.loads(unpacked(file).replace('"diverged"', "Infinity"))
    return found
