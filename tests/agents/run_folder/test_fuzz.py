"""Random damages, kills and full disks, by fuzz.py in a separate process."""

import json
import subprocess
import sys
from typing import Any

import pytest

from tests.agents.tiny import ROOT


def fuzz(**numbers: int) -> dict[str, Any]:
    """Report of the fuzzer for the given numbers of cases."""
    options = [f"--{name}={number}" for name, number in numbers.items()]
    command = [sys.executable, "-m", "tests.agents.run_folder.fuzz", *options]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert process.returncode in (0, 1), process.stderr[-2000:]
    report: dict[str, Any] = json.loads(process.stdout.splitlines()[-1])
    print(json.dumps(report["counts"], indent=1))
    return report


def test_a_few_damages_kills_and_full_disks_lose_nothing() -> None:
    assert fuzz(damages=10, kills=5, starts=2, full=2, seed=0)["faults"] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_many_damages_kills_and_full_disks_lose_nothing(seed: int) -> None:
    """`pytest -s` shows the counts."""
    report = fuzz(damages=200, kills=100, starts=30, full=40, seed=seed)
    assert report["faults"] == []
    counts = report["counts"]
    assert sum(n for name, n in counts.items() if name.startswith("killed")) == 130
    assert sum(n for name, n in counts.items() if name.startswith("damaged, status")) == 200
