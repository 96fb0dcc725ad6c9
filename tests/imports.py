"""The house as a graph of imports: `python -m tests.imports` prints its size.

All imports count, also those inside functions and type checks.
"""

import ast
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from tests.paths import ROOT

Graph = dict[str, set[str]]  # module or room -> those that it imports

# Every module belongs to the longest of these names that it begins with. Imports point from later
# rooms to earlier ones.
ROOMS = (
    "dynamics.types",
    "dynamics.extras",
    "dynamics.cache",
    "dynamics.progress",
    "dynamics.description",
    "dynamics.integrators",
    "dynamics.formulations",
    "dynamics.tracing",
    "dynamics.validity",
    "dynamics.arms",
    "dynamics.load",
    "dynamics.runtime",
    "dynamics.backends",
    "dynamics.model",
    "dynamics.simulation",
    "dynamics.measured",
    "dynamics.accuracy",
    "dynamics",
    "flexarm_env.arguments",
    "flexarm_env.task",
    "flexarm_env.hardware",
    "flexarm_env.registration",
    "flexarm_env.compiled",
    "flexarm_env.accuracy",
    "flexarm_env.plant",
    "flexarm_env.core",
    "flexarm_env.derivatives",
    "flexarm_env.certify",
    "flexarm_env.rendering",
    "flexarm_env.interfaces",
    "flexarm_env.pages",
    "flexarm_env",
    "agents.sentences",
    "agents.signals",
    "agents.arrays",
    "agents.environments",
    "agents.files",
    "agents.policy",
    "agents.learners",
    "agents.config",
    "agents.metrics",
    "agents.run_folder",
    "agents",
    "benchmarks.output",
    "benchmarks.style",
    "benchmarks.arms",
    "benchmarks.speed",
    "benchmarks.accuracy",
    "benchmarks.work_precision",
    "benchmarks.peers",
    "benchmarks.validation",
    "benchmarks.scenarios",
    "benchmarks.training",
    "benchmarks.ranking",
    "benchmarks",
)


def sources(*folders: str) -> list[Path]:
    """Every Python file of the folders, and of the root where a folder is '.'."""
    found: list[Path] = []
    for folder in folders:
        files = ROOT.glob("*.py") if folder == "." else (ROOT / folder).rglob("*.py")
        found += [f for f in files if "__pycache__" not in f.parts]
    return sorted(found)


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


@cache
def imported(path: Path) -> frozenset[str]:
    """Dotted names of all absolute imports of a file, each as far as it may be a module."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def imports(*folders: str) -> Graph:
    """Modules of the folders, each with those modules of the folders that it imports."""
    files = {module_name(path): path for path in sources(*folders)}
    graph: Graph = {}
    for name, path in files.items():
        modules = {x if x in files else x.rpartition(".")[0] for x in imported(path)}
        graph[name] = {x for x in modules if x in files and x != name}
    return graph


def room(module: str) -> str:
    fitting = [name for name in ROOMS if f"{module}.".startswith(f"{name}.")]
    return max(fitting, key=len)


def rooms_of(graph: Graph) -> Graph:
    """The graph between rooms."""
    result: Graph = {room(name): set() for name in graph}
    for name, others in graph.items():
        result[room(name)] |= {room(other) for other in others} - {room(name)}
    return result


def circles(graph: Graph) -> list[set[str]]:
    """Groups of nodes that import one another, directly or not."""

    def reach(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            name = waiting.pop()
            if name not in seen:
                seen.add(name)
                waiting += graph[name]
        return seen

    reached = {name: reach(name) for name in graph}
    groups: list[set[str]] = []
    for name in graph:
        if name in reached[name] and not any(name in group for group in groups):
            groups.append({other for other in reached[name] if name in reached[other]})
    return groups


def floors(graph: Graph) -> int:
    """Length of the longest chain of imports, circles left out."""
    known: dict[str, int] = {}

    def height(name: str, above: frozenset[str]) -> int:
        if name not in known:
            below = graph[name] - above - {name}
            known[name] = 1 + max((height(x, above | {name}) for x in below), default=0)
        return known[name]

    return max(height(name, frozenset()) for name in graph)


def arrows(graph: Graph) -> int:
    return sum(map(len, graph.values()))


def report(title: str, graph: Graph) -> str:
    return (
        f"{title}: {len(graph)} nodes, {floors(graph)} floors, {arrows(graph)} arrows, "
        f"{len(circles(graph))} circles"
    )


def largest_folder(folders: Iterable[str], without: str = "") -> tuple[int, str]:
    """Most modules in one folder, packages' own files left out."""
    counts: dict[str, int] = {}
    for path in sources(*folders):
        if not path.name.startswith("__"):
            name = str(path.parent.relative_to(ROOT))
            counts[name] = counts.get(name, 0) + 1
    return max((count, name) for name, count in counts.items() if name != without)


if __name__ == "__main__":
    packages = ("dynamics", "flexarm_env", "agents", "benchmarks")
    whole = imports(*packages)
    print(report("rooms", rooms_of(whole)))
    for package in packages:
        print(report(f"modules of {package}", imports(package)))
    print("largest folder:", *largest_folder(packages))
