"""What every result says of where it comes from, and how CPU time is measured."""

import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "scipy", "numba", "casadi", "gymnasium")


def provenance(*more: str) -> dict[str, Any]:
    """Machine, versions (of `more` packages too) and commit, for a JSON result."""
    versions = {"python": platform.python_version()}
    for name in (*PACKAGES, *more):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "machine": {"processor": processor(), "cores": os.cpu_count(), "system": platform.system()},
        "versions": versions,
        "commit": commit(),
    }


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def commit() -> str:
    """The commit measured, "-dirty" with changes to it, or "unknown" outside a repository."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    folder = Path(__file__).parent
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def cpu_seconds(call: Callable[[], Any], at_least: float = 0.02, runs: int = 5) -> float:
    """Median CPU time of one call [s] over several runs of many calls, after a first one."""
    call()
    begin = time.process_time()
    call()
    calls = max(1, int(at_least / runs / max(time.process_time() - begin, 1e-7)))
    times = []
    for _ in range(runs):
        begin = time.process_time()
        for _ in range(calls):
            call()
        times.append((time.process_time() - begin) / calls)
    return statistics.median(times)
