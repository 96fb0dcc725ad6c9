"""Rigid arms: operations of inverse dynamics, and motions recovered from their own torques.

    python -m benchmarks.accuracy.rigid_arms [--quick | --charts] [--out FILE]

The Newton-Euler torques of a cycloidal motion, as functions of time, drive the forward dynamics.
The error is the largest deviation of a joint from the planned motion. Where the planned motion is
unstable, the error grows at the rate of the linearised arm, whatever the integrator.
`--charts` draws the stored results.
"""

import json
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks import style
from benchmarks.output import (
    argument_parser,
    paragraphs,
    provenance,
    save_figure,
    save_results,
    table,
)
from dynamics import ARMS, Arm, compile_arm, simulate
from dynamics.description import denavit_hartenberg
from dynamics.description.denavit_hartenberg import Row
from dynamics.formulations.newton_euler import inverse_dynamics, rigid_links
from dynamics.simulation.nominal_motion import Cycloidal, NominalTorque
from dynamics.tracing.operation_counts import operations

plt = style.pyplot()
SIXTY = np.pi / 3.0
DURATION = 10.0  # [s] printed for both arms
MOTIONS = {  # the Stanford arm's motion is printed (2.14); the PUMA's is lost and chosen here
    "puma-600": Cycloidal(start=(0.0,) * 6, goal=(SIXTY,) * 6, duration=DURATION),
    "stanford": Cycloidal(
        start=(0.0, np.pi / 2.0, 0.0, 0.0, 0.0, 0.0),
        goal=(SIXTY, SIXTY, 0.1, SIXTY, SIXTY, SIXTY),
        duration=DURATION,
    ),
}
FOLLOWED = {"puma-600": 10.0, "stanford": 4.0}  # [s] until which the motion is followed
RTOL = 1e-12
Rows = list[dict[str, Any]]


def general(n_joint: int) -> Arm:
    """Revolute arm with no zero in its rows: only the resting base of joint 1 folds away."""
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(n_joint):
        a, d, alpha, mass = rng.uniform(0.1, 1.0, 4).tolist()
        root = rng.normal(size=(3, 3))
        body: dict[str, Any] = {"com": tuple(rng.normal(size=3)), "inertia": root @ root.T}
        rows.append(Row(a=a, d=d, alpha=alpha, mass=mass, **body))
    return denavit_hartenberg.arm(rows, gravity=(1.3, 2.7, -9.81))


def counted(arm: Arm) -> dict[str, int]:
    """Operations of inverse dynamics with a wrench at the tip, of one traced arm."""
    n = arm.n_joint
    q, v, a, w = (ca.SX.sym(name, size) for name, size in (("q", n), ("v", n), ("a", n), ("w", 6)))
    x, rates, rises, load = (ca.vertsplit(symbol) for symbol in (q, v, a, w))
    torques = inverse_dynamics(
        rigid_links(arm), x, rates, rises, gravity=arm.gravity, wrench=(load[:3], load[3:])
    )
    return operations(ca.Function("torques", [q, v, a, w], [ca.cse(ca.vertcat(*torques))]))


def counts() -> Rows:
    """Operations of general arms, with those of the thesis's formulas, and of the presets."""
    rows: Rows = []
    for n in range(2, 8):
        found = counted(general(n))
        rows.append({
            "arm": f"general, N = {n}", "M": found["multiplications"], "A": found["additions"],
            "thesis M": 100 * n - 107, "thesis A": 88 * n - 96,
        })  # fmt: skip
    for name in MOTIONS:
        found = counted(ARMS[name])
        rows.append({"arm": name, "M": found["multiplications"], "A": found["additions"]})
    return rows


def round_trip(name: str, samples: int) -> dict[str, Any]:
    """Torques, errors and fastest error growth of one arm along its motion."""
    arm, motion = ARMS[name], MOTIONS[name]
    model, torque = compile_arm(arm), NominalTorque(arm, motion)
    times = np.linspace(0.0, FOLLOWED[name], samples)
    planned = np.array([motion(t)[:2] for t in times])
    path = simulate(
        model, planned[0, 0], planned[0, 1], torque, times, integrator="dop853", rtol=RTOL
    )
    whole = np.linspace(0.0, DURATION, samples)
    growth = [
        np.linalg.eigvals(model.linearize(*motion(t)[:2], torque(t))[0]).real.max()
        for t in np.linspace(0.0, DURATION, 11)
    ]
    return {
        "t": times.tolist(),
        "error": np.abs(path.q - planned[:, 0]).max(axis=1).tolist(),
        "fastest growth [1/s]": float(max(growth)),
        "torque t": whole.tolist(),
        "torque": [torque(t).tolist() for t in whole],
    }


def page(rows: Rows, trips: dict[str, dict[str, Any]]) -> str:
    """The results as Markdown."""
    counted = [
        [x["arm"], str(x["M"]), str(x["A"]),
         f"{x['thesis M']}, {x['thesis A']}" if "thesis M" in x else ""]
        for x in rows
    ]  # fmt: skip
    followed = [
        [name, f"{x['t'][-1]:g} s", f"{max(x['error']):.1e} rad or m",
         f"{x['fastest growth [1/s]']:.2f} /s"]
        for name, x in trips.items()
    ]  # fmt: skip
    return paragraphs(
        "# Rigid arms",
        "Made by `python -m benchmarks.accuracy.rigid_arms`.",
        table(["inverse dynamics of", "multiplications", "additions", "thesis"], counted),
        table(["round trip", "followed", "largest error", "fastest growth"], followed),
        "![round trips](rigid_arms.png)",
    )


def draw(trips: dict[str, dict[str, Any]], path: Path) -> None:
    """Draw the nominal torques of both arms, and the errors of their recovered motions."""
    figure, axes = plt.subplots(1, 3, figsize=(13.0, 4.4), layout="constrained")
    for axis, (name, trip) in zip(axes, trips.items(), strict=False):
        for k, torque in enumerate(np.transpose(trip["torque"])):
            slides = ARMS[name].links[k].joint.type == "prismatic"
            axis.plot(
                trip["torque t"], torque, **style.marked(k, len(torque)), linewidth=1.8,
                label=f"f{k + 1} [N]" if slides else f"τ{k + 1}",
            )  # fmt: skip
        axis.set(title=f"{name}: nominal torques", xlabel="t [s]", ylabel="[N m]")
        axis.legend(fontsize="small", ncols=2)
    for k, (name, trip) in enumerate(trips.items()):
        error = np.maximum(trip["error"], 1e-17)
        axes[2].semilogy(trip["t"], error, **style.marked(k, len(error)), linewidth=1.8, label=name)
    axes[2].axhline(1e-9, color="0.6", linewidth=0.8, linestyle="--")
    axes[2].set(title="error of the return", xlabel="t [s]", ylabel="largest joint error [rad, m]")
    axes[2].legend(fontsize="small")
    save_figure(figure, path)


def main() -> None:
    """Write JSON, page and picture."""
    parser = argument_parser("accuracy.rigid_arms", __doc__, "rigid_arms.json")
    parser.add_argument("--quick", action="store_true", help="fewer points in the picture")
    parser.add_argument("--charts", action="store_true", help="only draw the stored results")
    options = parser.parse_args()
    if options.charts:
        draw(json.loads(options.out.read_text(encoding="utf-8"))["trips"], options.out)
        return
    rows = counts()
    trips = {name: round_trip(name, 21 if options.quick else 201) for name in MOTIONS}
    data = {**provenance("numpy", "scipy", "casadi", "numba"), "counts": rows, "trips": trips}
    save_results(data, page(rows, trips), options.out)
    draw(trips, options.out)


if __name__ == "__main__":
    main()
