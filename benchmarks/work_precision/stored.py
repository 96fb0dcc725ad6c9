"""The stored results: packed JSON, in which an infinite error is the word "diverged"."""

import bz2
import json
from pathlib import Path
from typing import Any

from benchmarks.output import RESULTS

STORED = RESULTS / "work_precision.json.bz2"


def store(results: dict[str, Any], file: Path) -> None:
    """Write results that are plain JSON."""
    file.write_bytes(bz2.compress(json.dumps(results, separators=(",", ":")).encode()))


def stored_results(file: Path) -> dict[str, Any]:
    """Results that a file holds."""
    text = bz2.decompress(file.read_bytes()).decode().replace('"diverged"', "Infinity")
    found: dict[str, Any] = json.loads(text)
    return found
