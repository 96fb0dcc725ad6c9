"""Named scenarios: the motion of each flexible arm (solid) and of its rigid twin (dashed).

    python -m benchmarks.scenarios [NAME ...] [--quick] [--out docs/scenarios.md]

Simulates `configs/scenarios/NAME.yaml`, by default all of them, and writes a picture of each, the
figures (`results/scenarios.json`) and the page. Scenarios that are not named keep their figures.
`--quick` simulates the first twentieth of each motion and writes nothing.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import style
from benchmarks.output import (
    ROOT,
    argument_parser,
    paragraphs,
    provenance,
    save_figure,
    table,
    write_results,
)
from benchmarks.scenarios.file import Scenario, load_scenario
from benchmarks.scenarios.motions import DEGREE, Run, figures, twins
from dynamics.description.rotations import to_euler
from dynamics.types import Array

FOLDER = ROOT / "configs" / "scenarios"
ORDER = (  # of the page; other scenarios come last
    "one-link-step", "one-link-ramp", "one-link-nominal",
    "two-links-one-mode", "two-links-two-modes", "two-links-payload",
    "planar-arm", "planar-arm-100kg",
    "spatial-arm", "spatial-arm-500kg", "spatial-arm-500kg-damped", "six-links",
    "flying-body", "flying-beam", "flying-rigid-links", "flying-long-links",
    "fixed-base", "double-pendulum",
)  # fmt: skip
plt = style.pyplot()
QUICK = 20  # --quick simulates this fraction of a motion: 1 / QUICK
COLUMNS = {  # of the page: name in the results -> format
    "deflection [mm]": ".3g",
    "of its length [%]": ".2g",
    "joints apart [deg]": ".3g",
    "tips apart [mm]": ".3g",
    "energy drift": ".0e",
    "linear momentum drift": ".0e",
    "angular momentum drift": ".0e",
}


def names() -> list[str]:
    """Every committed scenario, in the page's order."""
    found = {path.stem for path in FOLDER.glob("*.yaml")}
    return [name for name in ORDER if name in found] + sorted(found - set(ORDER))


def draw(scenario: Scenario, flexible: Run, rigid: Run, path: Path) -> None:
    """Draw a free base's attitude, joint angles and deflections, each with its rate."""
    arm = scenario.arm
    rows = []
    if arm.base.n:
        rows.append(_draw_attitude)
    if arm.n_joint:
        rows.append(_draw_joints)
    if flexible is not rigid:
        rows.append(_draw_bending)
    figure, axes = plt.subplots(
        len(rows), 2, figsize=(10.0, 0.6 + 2.7 * len(rows)), layout="constrained", squeeze=False,
        sharex=True,
    )  # fmt: skip
    for pair, row in zip(axes, rows, strict=True):
        row(pair, flexible, rigid)
        for axis in pair:
            axis.grid(color="0.9", linewidth=0.6)
            axis.legend(fontsize="small", ncols=3)
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    ending = "" if flexible is rigid else " (solid: flexible, dashed: rigid)"
    figure.suptitle(f"{scenario.title}{ending}", fontsize="medium")
    save_figure(figure, path)


def _draw_attitude(axes: Any, flexible: Run, rigid: Run) -> None:
    for run, dashes in _styles(flexible, rigid):
        t = run.path.t
        assert run.path.base_quaternion is not None
        turned = np.unwrap(np.array([to_euler(x) for x in run.path.base_quaternion]), axis=0)
        _lines(axes[0], t, turned / DEGREE, dashes, ("θ₀", "φ₀", "ψ₀"))
        _lines(axes[1], t, run.path.v[:, 3:6], dashes, ("ω₁", "ω₂", "ω₃"))
    axes[0].set(ylabel="attitude of the base [°]")
    axes[1].set(ylabel="its angular velocity [rad/s]")


def _draw_joints(axes: Any, flexible: Run, rigid: Run) -> None:
    labels = tuple(f"q{k}" for k in range(1, flexible.joints.shape[1] + 1))
    for run, dashes in _styles(flexible, rigid):
        _lines(axes[0], run.path.t, run.joints / DEGREE, dashes, labels)
        _lines(axes[1], run.path.t, run.rates / DEGREE, dashes, labels)
    axes[0].set(ylabel="joint angle [°]")
    axes[1].set(ylabel="joint rate [°/s]")


def _draw_bending(axes: Any, flexible: Run, rigid: Run) -> None:
    """Draw deflections along y (solid) and z (dotted); the rigid arm's are zero (dashed)."""
    t = flexible.path.t
    for values, axis in ((flexible.bend, axes[0]), (flexible.bend_rates, axes[1])):
        axis.axhline(0.0, color="0.3", linestyle="--", linewidth=1.0)
        for k, link in enumerate(flexible.model.arm.links):
            for plane, direction in enumerate("yz"):
                if link.in_direction(direction):
                    axis.plot(
                        t, 1e3 * values[:, k, plane], "-:"[plane], linewidth=1.0, markersize=5,
                        label=f"link {k + 1}, {direction}", **style.marked(k, t.size),
                    )  # fmt: skip
    axes[0].set(ylabel="tip deflection [mm]")
    axes[1].set(ylabel="its rate [mm/s]")


def _styles(flexible: Run, rigid: Run) -> list[tuple[Run, str]]:
    return [(flexible, "-")] if flexible is rigid else [(flexible, "-"), (rigid, "--")]


def _lines(axis: Any, t: Array, values: Array, dashes: str, labels: tuple[str, ...]) -> None:
    """Draw the flexible arm's lines coloured and marked, the rigid arm's thin and black."""
    for k, (column, label) in enumerate(zip(values.T, labels, strict=True)):
        if dashes == "-":
            look = style.marked(k, t.size)
            axis.plot(t, column, dashes, linewidth=1.4, markersize=5, label=label, **look)
        else:
            axis.plot(t, column, dashes, color="k", linewidth=0.7)


def page(results: dict[str, Any]) -> str:
    """The page as Markdown."""
    stored, scenarios = results["scenarios"], {name: load(name) for name in results["scenarios"]}
    rows = [
        [f"[{name}](#{name})", str(row["coordinates"]), row["integrator"]]
        + [format(row[key], form) if key in row else "" for key, form in COLUMNS.items()]
        for name, row in stored.items()
    ]
    parts = [
        "# Scenarios",
        "Motions of named arms. Each scenario is simulated with the flexible arm and with its "
        "rigid twin: the same arm without modes and joint springs, under the same torque. Made by",
        "```\npython -m benchmarks.scenarios\n```",
        "from `configs/scenarios` ([data](results/scenarios.json)); names as arguments select "
        "single scenarios. They are the systems of Cyril's FLEXLINK thesis (first three groups) "
        "and the special cases of Zohoor and Khorsandijou's flying arm. The tables and "
        "trajectories of the thesis are illegible and the second paper has no numbers, so no "
        "number below is from either source; each scenario lists the parameters chosen here.",
        "*Deflection* is the largest distance of a link's tip from its undeflected position. "
        "*Apart* is the largest distance between the flexible and the rigid motion; the angle of a "
        "joint with a spring includes the spring's deflection. Drifts are relative: energy drift, "
        "given without torque and damping, to the largest kinetic energy; momentum drift to the "
        "initial momentum.",
        table(["scenario", "coordinates", "integrator", *COLUMNS], rows, "lr"),
    ]
    for name, row in stored.items():
        scenario = scenarios[name]
        parts += [f"## {name}", f"{scenario.title}. {scenario.about.strip()}"]
        parts += [f"Warning of `simulate`: {text}" for text in row["warnings"]]
        parts.append(f"![{scenario.title}](results/scenario_{name}.png)")
    return paragraphs(*parts)


def load(name: str) -> Scenario:
    """A committed scenario."""
    path = FOLDER / f"{name}.yaml"
    if not path.exists():
        raise ValueError(f"Unknown scenario {name!r}. Known: {names()}.")
    return load_scenario(path)


def shortened(scenario: Scenario) -> Scenario:
    """The first part of a scenario, for --quick."""
    return replace(scenario, t_end=scenario.t_end / QUICK, n_out=21)


def main(arguments: list[str] | None = None) -> int:
    """Simulate the named scenarios; returns the exit status."""
    parser = argument_parser("scenarios", __doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenarios (default: all)")
    parser.add_argument(
        "--quick", action="store_true", help="simulate the beginnings and write nothing"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "scenarios.md")
    options = parser.parse_args(arguments)
    try:
        chosen = {name: load(name) for name in options.names or names()}
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    folder = options.out.parent / "results"
    target = folder / "scenarios.json"
    stored = json.loads(target.read_text(encoding="utf-8"))["scenarios"] if target.exists() else {}
    for name, scenario in chosen.items():
        flexible, rigid = twins(shortened(scenario) if options.quick else scenario)
        stored[name] = figures(scenario, flexible, rigid)
        print(name, stored[name], flush=True)
        if not options.quick:
            folder.mkdir(parents=True, exist_ok=True)
            draw(scenario, flexible, rigid, folder / f"scenario_{name}.png")
    if options.quick:
        return 0
    rows = {name: stored[name] for name in names() if name in stored}
    results = {**provenance("numpy", "scipy", "casadi", "numba"), "scenarios": rows}
    options.out.write_text(page(write_results(target, results)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
