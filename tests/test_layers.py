"""The house rules that keep the packages apart: who imports whom, and how long a file may be."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import ROOT

LAYERS = ("dynamics", "flexarm_env", "agents")  # each may import those before it, never those after
LONGEST_FILE = 400  # lines
FORBIDDEN = {
    "dynamics": {"gymnasium", "stable_baselines3", "torch", "matplotlib"},
    "flexarm_env": {"torch"},
    "agents": set(),
}


def sources(*folders: str) -> list[Path]:
    """Every Python file of the folders, and of the root where a folder is '.'."""
    found: list[Path] = []
    for folder in folders:
        files = ROOT.glob("*.py") if folder == "." else (ROOT / folder).rglob("*.py")
        found += [f for f in files if "__pycache__" not in f.parts]
    return sorted(found)


def imported_packages(tree: ast.AST) -> set[str]:
    """Top-level names of all absolute imports, also those inside functions and type checks."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("layer", LAYERS)
def test_imports_point_down_only(layer: str) -> None:
    """agents -> flexarm_env -> dynamics, and no layer imports what it must not know."""
    above = set(LAYERS[LAYERS.index(layer) + 1 :])
    assert sources(layer), f"no source found in {layer}/"
    for path in sources(layer):
        names = imported_packages(ast.parse(path.read_text(encoding="utf-8")))
        assert not names & above, f"{path.relative_to(ROOT)} imports {sorted(names & above)}"
        forbidden = names & FORBIDDEN[layer]
        assert not forbidden, f"{path.relative_to(ROOT)} imports {sorted(forbidden)}"


def test_files_are_short_and_named_for_what_they_do() -> None:
    """No file above 400 lines, no utils.py."""
    for path in sources(".", *LAYERS, "tests", "benchmarks"):
        length = len(path.read_text(encoding="utf-8").splitlines())
        assert length <= LONGEST_FILE, f"{path.relative_to(ROOT)} has {length} lines"
        assert path.name != "utils.py", f"{path.relative_to(ROOT)}: name it for what it does"


@pytest.mark.parametrize("package", ["dynamics", "flexarm_env"])
def test_importing_the_lower_layers_loads_no_learning_library(package: str) -> None:
    """A simulation-only user pays for neither torch nor stable-baselines3."""
    code = (
        f"import sys, {package}; "
        "print(*sorted({m.split('.')[0] for m in sys.modules} & {'torch', 'stable_baselines3'}))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == []
