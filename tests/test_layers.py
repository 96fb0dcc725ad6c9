"""The house rules that keep the packages apart: who imports whom, and how long a file may be."""

import re
import subprocess
import sys

import pytest

from tests.imports import (
    ROOMS,
    Graph,
    circles,
    imported,
    imports,
    largest_folder,
    module_name,
    room,
    sources,
)
from tests.paths import ROOT

PACKAGES = ("dynamics", "flexarm_env", "agents", "benchmarks")
LONGEST_FILE = 400  # lines
MOST_MODULES = 16  # of a folder
TENSORS = "flexarm_env.interfaces.tensors"
COMPILERS = {
    "numba": ("dynamics.backends.numba_llvm", "dynamics.runtime"),
    "llvmlite": ("dynamics.backends.numba_llvm", "dynamics.runtime"),
    "cuda": ("dynamics.backends.cuda",),
}
FORBIDDEN = {
    "dynamics": {"gymnasium", "stable_baselines3", "torch", "matplotlib"},
    "flexarm_env": {"torch"},
}


def wrong_arrows(graph: Graph) -> list[str]:
    """Imports that point from a room to a later one."""
    order = {name: i for i, name in enumerate(ROOMS)}
    return [
        f"{name} imports {other}"
        for name, others in graph.items()
        for other in others
        if order[room(other)] > order[room(name)]
    ]


def test_imports_between_rooms_run_one_way() -> None:
    assert wrong_arrows(imports(*PACKAGES)) == []


def test_no_modules_import_one_another() -> None:
    """Directly or round a corner, at the top of a file or inside a function."""
    assert circles(imports(*PACKAGES)) == []


def test_an_import_turned_round_is_found() -> None:
    graph = imports(*PACKAGES)
    graph["dynamics.description.link"] = {"dynamics.formulations.link_constants"}
    (arrow,) = wrong_arrows(graph)
    assert arrow == "dynamics.description.link imports dynamics.formulations.link_constants"
    assert any("dynamics.description.link" in group for group in circles(graph))


def test_every_room_is_there() -> None:
    assert {room(name) for name in imports(*PACKAGES)} == set(ROOMS)


@pytest.mark.parametrize("package", FORBIDDEN)
def test_packages_do_not_import_what_they_must_not_know(package: str) -> None:
    for path in sources(package):
        found = {name.split(".")[0] for name in imported(path)} & FORBIDDEN[package]
        if module_name(path).startswith(TENSORS):
            found -= {"torch"}
        assert not found, f"{path.relative_to(ROOT)} imports {sorted(found)}"


def test_folders_are_small() -> None:
    """But for the presets, of which there may be any number."""
    count, folder = largest_folder(PACKAGES, without="dynamics/arms/presets")
    assert count <= MOST_MODULES, folder


def test_files_are_short_and_named_for_what_they_do() -> None:
    """No file above 400 lines, no utils.py."""
    for path in sources(".", *PACKAGES, "examples", "tests"):
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


def test_docstrings_name_their_subject() -> None:
    """First a noun or a verb of the field, not a question word or a reference to another text."""
    riddle = re.compile(r'^ *r?"""(What|How|Where|Who|Whether|The same|That|Those|This) .*', re.M)
    for path in sources(".", *PACKAGES, "examples", "tests"):
        found = riddle.search(path.read_text(encoding="utf-8"))
        assert found is None, f"{path.relative_to(ROOT)}: {found[0]}"


def test_each_compiler_is_known_in_one_place() -> None:
    """Numba to its backend and its runtime, CUDA to its backend; the programs know neither."""
    for path in sources("dynamics", "flexarm_env", "agents"):
        for name in {x.split(".")[0] for x in imported(path)} & set(COMPILERS):
            where = f"{path.relative_to(ROOT)} imports {name}"
            assert module_name(path).startswith(COMPILERS[name]), where


def test_pools_of_processes_end_with_their_parent() -> None:
    """All of them are made by `agents.signals.workers`."""
    made = {
        path.relative_to(ROOT).as_posix()
        for path in sources("agents", "benchmarks")
        if "ProcessPoolExecutor(" in path.read_text(encoding="utf-8")
    }
    assert made == {"agents/signals.py"}
