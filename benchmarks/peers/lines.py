"""Runs of the peers' benchmark, each engine's line of cheapest runs, and the page."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from benchmarks.output import paragraphs, table
from benchmarks.peers.scenes import PeerScene
from dynamics.types import Array

BATCH = 1024
OURS, BATCHED = "ours, one environment", f"ours, per environment in a batch of {BATCH}"
ENGINES = (OURS, "Exudyn, cable", "Exudyn, tree", "MuJoCo")
RATIOS = {  # key in the results: column of the page
    "ratio": "measured",
    "steady": "without luck",
    "foreshortened": "foreshortened",
}

Run = tuple[Array, float]  # (N, 2) [m] tips; [s] processor time of the stepping loop


@dataclass(frozen=True)
class Family:
    """A model and a method of one engine; its runs differ in their step."""

    engine: str
    model: str
    method: str
    run: Callable[[Fraction, bool], Run]  # (steps per row of the truth, record) -> Run


@dataclass(frozen=True)
class Point:
    """Error and cost of one run."""

    family: Family
    rate: Fraction
    error: float  # [-] of the reach
    cost: float  # [s] processor time per simulated second

    def to_dict(self, scene: PeerScene) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "engine": self.family.engine, "model": self.family.model, "method": self.family.method,
            "dt": scene.step(self.rate), "error": self.error, "cpu_seconds_per_second": self.cost,
        }  # fmt: skip


def front(points: list[Point], near: float = 1.0) -> list[Point]:
    """Points at most `near` times as slow as any point of no larger error, sorted by error."""
    finite = sorted((p for p in points if p.error < 0.3), key=lambda p: p.error)
    result, fastest = [], math.inf
    for point in finite:
        if point.cost < near * fastest:
            result.append(point)
        fastest = min(fastest, point.cost)
    return result


def best(points: list[Point], error: float) -> Point | None:
    """The cheapest point within an error."""
    return min((p for p in points if p.error <= error), key=lambda p: p.cost, default=None)


def steady(points: list[Point], error: float) -> list[Point]:
    """Runs within an error that all runs of the same family with smaller steps also meet.

    There must be at least one such run. The error of any other run is small by chance: the error
    of its step cancels that of its model.
    """
    errors: dict[Family, list[tuple[Fraction, float]]] = {}
    for p in points:
        errors.setdefault(p.family, []).append((p.rate, p.error))
    result = []
    for p in points:
        finer = [e for rate, e in errors[p.family] if rate > p.rate]
        if finer and max(p.error, *finer) <= error:
            result.append(p)
    return result


def comparisons(scene: PeerScene, points: dict[str, list[Point]]) -> list[dict[str, Any]]:
    """For every demand of a scene: the cheapest run of flexarm and of the named peer."""
    rows = []
    for error, whose, wanted in scene.demands:
        named = [e for e in ENGINES[1:] if whose == "any" or e.startswith(whose)]
        ours, theirs = points[OURS], [p for engine in named for p in points[engine]]
        reliable = steady(ours, error), steady(theirs, error)
        short = [p for p in reliable[0] if p.family.model.endswith("foreshortened")]
        pairs = {"ratio": (ours, theirs), "steady": reliable, "foreshortened": (short, reliable[1])}
        row: dict[str, Any] = {
            "scene": scene.title, "error": error,
            "beside": "the best peer" if whose == "any" else whose, "wanted": wanted,
        }  # fmt: skip
        for name, sides in pairs.items():
            found = [best(side, error) for side in sides]
            row[name] = found[1].cost / found[0].cost if found[0] and found[1] else None
            row[f"{name}: runs"] = [p and p.to_dict(scene) for p in found]
        enough = {name for name in pairs if (row[name] or 0.0) >= wanted}
        row["reached"] = {name: name in enough for name in pairs}
        rows.append(row)
    return rows


def levels(scene: PeerScene) -> list[float]:
    """Errors 1e-2, 1e-3 ... down to the smallest that the truth resolves."""
    return [10.0**-k for k in range(2, 1 + math.floor(-math.log10(scene.finest)))]


def speeds(scene: PeerScene, points: dict[str, list[Point]]) -> list[dict[str, Any]]:
    """Our cheapest run and the cheapest of all peers at each of the levels of error."""
    theirs = [p for engine in ENGINES[1:] for p in points[engine]]
    rows = []
    for error in levels(scene):
        found = {"ours": best(points[OURS], error), "peer": best(theirs, error)}
        rows.append({"error": error, **{k: p and p.to_dict(scene) for k, p in found.items()}})
    return rows


def ahead(scene: PeerScene, points: dict[str, list[Point]]) -> list[Point]:
    """Peers' runs below and left of our line: no run of ours is as accurate and as cheap.

    Errors below those that the truth resolves count as equal to them.
    """
    result = []
    for engine in ENGINES[1:]:
        for p in front(points[engine]):
            ours = best(points[OURS], max(p.error, scene.finest))
            if ours is None or ours.cost > p.cost:
                result.append(p)
    return result


def statement(scene: dict[str, Any]) -> str:
    """Sentences on the peers' runs below and left of our line, and on the end of the lines."""
    ends = f"The truth resolves errors down to {scene['finest']:.1g}; the smallest error is " + (
        ", ".join(f"{e:.2g} ({engine})" for engine, e in scene["smallest"].items()) + "."
    )
    if not scene["ahead"]:
        return f"No peer's run lies below and left of our line. {ends}"
    worst = ", ".join(
        f"{p['engine']}, {p['model']}, {p['method']}: error {p['error']:.2g} at "
        f"{1e6 * p['cpu_seconds_per_second']:.4g} us/s"
        for p in scene["ahead"]
    )
    return (
        f"**{len(scene['ahead'])} runs of peers lie below and left of our line**: {worst}. {ends}"
    )


def verdict(reached: dict[str, bool]) -> str:
    """Verdict on a demand: met, met under conditions, or not met."""
    if all(reached.values()):
        return "yes"
    if reached["ratio"] and reached["steady"]:
        return "only without foreshortening"
    return "only by luck" if reached["ratio"] else "**no**"


def speed(run: dict[str, Any] | None) -> str:
    """Simulated seconds per processor second."""
    return f"{1.0 / run['cpu_seconds_per_second']:.3g}" if run else "-"


def gain(row: dict[str, Any]) -> str:
    """Our speed over the best peer's."""
    if row["ours"] is None or row["peer"] is None:
        return "-"
    return f"{row['peer']['cpu_seconds_per_second'] / row['ours']['cpu_seconds_per_second']:.3g}"


def page(results: dict[str, Any]) -> str:
    """The results as Markdown."""
    machine = results["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in results["versions"].items())
    parts = [
        "# Beside the peers",
        f"Made by `{results['command']}` on {machine['processor']} ({versions}), one thread. Cost "
        "is processor time per simulated second, error the largest distance of the tip from the "
        "truth over the reach.",
        "Without luck: only runs whose error all smaller steps of the same model keep. Of those, "
        "the last column but one takes our foreshortened models alone.",
        table(
            ["scene", "error at most", "beside", "wanted", *RATIOS.values(), "reached"],
            [
                [
                    row["scene"],
                    f"{row['error']:g}",
                    row["beside"],
                    f"{row['wanted']:g}",
                    *("-" if row[name] is None else f"{row[name]:.3g}" for name in RATIOS),
                    verdict(row["reached"]),
                ]
                for row in results["comparisons"]
            ],
            "lllrrrrl",
        ),
        "## Simulated seconds per processor second\n",  # a blank line more before the first scene
    ]
    for scene in results["scenes"].values():
        rows = [
            [f"{row['error']:g}", *(speed(row[side]) for side in ("ours", "peer")), gain(row)]
            + [f"{p['engine']}, {p['model']}, {p['method']}" if p else "-" for p in (row["peer"],)]
            for row in scene["speeds"]
        ]
        heads = ["error at most", "ours", "best peer", "ratio", "its model and method"]
        parts += [f"{scene['title']}. {statement(scene)}", table(heads, rows, "lrrrl")]
    header = ["error at most", "which", "engine", "model", "method", "step", "error", "cost"]
    for scene in results["scenes"].values():
        rows = [
            [
                f"{row['at_most']:g}",
                *(row[key] for key in ("which", "engine", "model", "method")),
                f"{1e3 * row['dt']:.3g} ms",
                f"{row['error']:.2g}",
                f"{1e6 * row['cpu_seconds_per_second']:.4g} us/s",
            ]
            for row in scene["best"]
        ]
        parts += [f"## {scene['title']}", table(header, rows, "lllllr")]
    return paragraphs(*parts)


def summary(scene: PeerScene, points: dict[str, list[Point]]) -> dict[str, Any]:
    """Results of a scene: cheapest runs at demanded and at round errors, lines, runs ahead."""
    return {
        "title": scene.title,
        "finest": scene.finest,
        "smallest": {e: min(p.error for p in points[e]) for e in ENGINES if points[e]},
        "best": bests(scene, points),
        "speeds": speeds(scene, points),
        "ahead": [p.to_dict(scene) for p in ahead(scene, points)],
        "lines": {
            engine: [p.to_dict(scene) for p in front(runs)] for engine, runs in points.items()
        },
    }


def bests(scene: PeerScene, points: dict[str, list[Point]]) -> list[dict[str, Any]]:
    """The cheapest run of every engine within each demanded error."""
    rows = []
    for error in sorted({error for error, _, _ in scene.demands}, reverse=True):
        for engine in (*ENGINES, BATCHED):
            sides = {"cheapest": points[engine]}
            if engine != BATCHED:
                sides["without luck"] = steady(points[engine], error)
            for which, runs in sides.items():
                found = best(runs, error)
                if found:
                    rows.append({"at_most": error, "which": which, **found.to_dict(scene)})
    return rows
