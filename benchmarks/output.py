"""What every benchmark writes beside its numbers: where they come from, and pictures."""

import json
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

from agents.run_folder.folder import revision

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
REFERENCE = ROOT / "tests" / "reference"


def provenance(*packages: str) -> dict[str, Any]:
    """Machine, versions of Python and of the packages, commit and command."""
    return {
        "machine": {"processor": processor(), "cores": os.cpu_count()},
        "versions": {"python": platform.python_version(), **{p: version(p) for p in packages}},
        "commit": revision(),
        "command": " ".join(["python", "-m", _module(), *sys.argv[1:]]),
    }


def _module() -> str:
    """The name after `python -m`."""
    spec = sys.modules["__main__"].__spec__
    return spec.name.removesuffix(".__main__") if spec else Path(sys.argv[0]).name


def processor() -> str:
    """The processor's name where the system tells, else its kind; what code is compiled for."""
    told = Path("/proc/cpuinfo")  # Linux
    lines = told.read_text(encoding="utf-8").splitlines() if told.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = next(iter(names), platform.processor() or platform.machine())
    return f"{name}, {get_host_cpu_name()}"


def save_results(results: dict[str, Any], text: str, path: Path) -> None:
    """JSON, and the same as a page beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    path.with_suffix(".md").write_text(text, encoding="utf-8")


def save_figure(figure: Any, path: Path) -> None:
    """PNG of a figure, which is closed."""
    import matplotlib.pyplot as plt

    figure.savefig(path.with_suffix(".png"), dpi=110)
    plt.close(figure)
