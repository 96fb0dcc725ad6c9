"""Error over whole episodes against CPU time of every method, and a second path to the same error.

    python -m benchmarks.accuracy.episode_errors

For each registered scene the episodes of its certificate are played on the default model by every
method with more and more substeps. Some of them are also solved by SciPy with error control, on
links in other segments with other shapes. Writes docs/results/episode_errors.json, .md and .png.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.output import argument_parser, count, provenance, save_results, table
from benchmarks.style import pyplot, series
from dynamics import Arm, compile_arm, load_arm, simulate
from dynamics.accuracy.fidelity import everything, rigid
from dynamics.accuracy.model_choice import MOST_FROZEN
from dynamics.integrators.table import INTEGRATORS
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from dynamics.types import Array
from flexarm_env.accuracy.motions import KINDS
from flexarm_env.certify.certificate import Certifier
from flexarm_env.certify.episodes import Distances, Episodes, Trace
from flexarm_env.certify.search import METHODS, timed
from flexarm_env.registration import SCENES
from flexarm_env.task.scales import SAFE, scales

SUBSTEPS = (1, 2, 3, 4, 6, 8, 10, 12, 16, 24)
DRAWN = tuple(name for name, kind in KINDS.items() if kind.actions)
OF_KIND = 4  # episodes of each kind that are solved on the second path
LONGEST = {"SixLink": 15}  # control steps of them, where SciPy is slow
SHORT = LONGEST["SixLink"] * SCENES["SixLink"][1]  # [s]
TOLERANCE = 1e-8  # of SciPy's steps


def independent(arm: Arm) -> Arm:
    """The arm in other segments than the reference, with powers of x as shapes."""
    segments, modes = (5, 3) if arm.n_joint <= 2 else (3, 2)
    fine = rigid(arm, foreshortening=True, polynomial=True)
    counts = everything(arm, modes, 1)
    fine = replace(fine, counts=counts, segments=(segments,) * arm.n_joint)
    cut = fine.arm(arm)
    links = tuple(
        replace(link, modes=tuple(replace(mode, kind="poly") for mode in link.modes))
        for link in cut.links
    )
    return replace(cut, links=links)


def solved(arm: Arm, episodes: Episodes, limit: Array, control_dt: float) -> Array:
    """(T, N, 3) [m] tips of episodes from rest, by SciPy on the `independent` arm."""
    model, tips = compile_arm(independent(arm)), []
    times = control_dt * np.arange(len(episodes.actions) + 1)
    joints = list(episodes.arm.joint_index)
    for row in range(len(episodes.kinds)):
        torques = episodes.actions[:, row].astype(np.float32).astype(float) * limit
        starts = tuple(times[:-1].tolist())
        signals = tuple(
            PiecewiseConstant(times=starts, values=tuple(values.tolist())) for values in torques.T
        )
        rest = np.zeros(model.n)
        q = model.rigid(rest)
        q[: arm.base.n] = episodes.q[row, : arm.base.n]
        q[list(model.arm.joint_index)] = episodes.q[row, joints]
        torque = Torque(signals=signals)
        tips.append(simulate(model, q, rest, torque, times, rtol=TOLERANCE).tip[1:])
    return np.stack(tips, axis=1)


def second_path(scene: str) -> dict[str, Any]:
    """Errors of the default in the same episodes from the reference and from `independent`."""
    name, dt, steps = SCENES[scene]
    arm = load_arm(name)
    steps = LONGEST.get(scene, steps)
    kinds = tuple(kind for kind in DRAWN if not KINDS[kind].shaken)
    certifier = Certifier(arm, {"control_dt": dt}, steps, kinds=kinds, count=OF_KIND + 1)
    core = certifier.default()
    own = certifier.trace(core.integrator, core.substeps)
    truth = solved(arm, certifier.episodes, core.torque_limit, dt)
    other = Trace(truth, own.valid, own.diverged)
    pair = [
        Distances.between(own, trace, certifier.episodes.kinds).per_episode / arm.reach
        for trace in (certifier.reference, other)
    ]
    apart = np.abs(pair[1] / pair[0] - 1.0)
    return {"episodes": len(apart), "steps": steps, "reference": pair[0].tolist(),
            "second": pair[1].tolist(), "apart": float(apart.max())}  # fmt: skip


def runs(scene: str, count: int) -> dict[str, Any]:
    """Error and CPU time of every method and substeps on the default model of a scene."""
    name, dt, steps = SCENES[scene]
    certifier = Certifier(load_arm(name), {"control_dt": dt}, steps, kinds=DRAWN, count=count)
    core, found = certifier.default(), []
    for method in METHODS:
        known = INTEGRATORS[method]
        if known.aid == "modes" and certifier.model.n > MOST_FROZEN:
            continue
        least = int(dt * scales(certifier.model).fastest / (SAFE * known.limit)) + 1
        tried = {*SUBSTEPS, core.substeps} if method == core.integrator else SUBSTEPS
        for substeps in sorted(n for n in tried if n >= least):
            error = certifier.error(method, substeps).worst_share / certifier.reach
            if np.isfinite(error):
                found.append({"integrator": method, "substeps": substeps, "error": error})
    return {
        "model": certifier.model_error().worst_share / certifier.reach,
        "runs": timed(certifier, found),
        "default": [core.integrator, core.substeps],
    }


def page(data: dict[str, Any]) -> str:
    """Markdown page of the tables."""
    rows = [
        [scene, *x["default"][:1], str(x["default"][1]), f"{default_of(x)['error']:.1e}",
         f"{x['model']:.1e}", f"{1e9 * default_of(x)['seconds']:.0f}", cheaper(x)]
        for scene, x in data["scenes"].items()
    ]  # fmt: skip
    paths = [
        [scene, str(x["episodes"]), f"{np.median(x['reference']):.1e}",
         f"{np.median(x['second']):.1e}", f"{x['apart']:.0%}"]
        for scene, x in data["second path"].items()
    ]  # fmt: skip
    head = ("scene", "default", "substeps", "error", "its model", "CPU time [ns]", "cheaper at it")
    return f"""# Error over whole episodes

Made by `{data["command"]}`.

The error is that of 95 of 100 episodes of the worst kind, over the reach, on {data["count"]}
episodes of each kind; CPU time is per control step of one environment in a batch. "Cheaper at it"
is the cheapest run of another method with at most the default's error, over its time.

![Error over episodes against CPU time](episode_errors.png)

{table(head, rows, "llr")}

## A second path

Links in other segments, with powers of x as shapes, under SciPy's error control: the largest error
of an episode from there and from the reference, medians and the largest relative difference.
Episodes are whole, but those of six links end after {SHORT:g} s, since SciPy is slow there.

{table(("scene", "episodes", "from the reference", "from SciPy", "apart at most"), paths, "lr")}
"""


def default_of(found: dict[str, Any]) -> dict[str, Any]:
    """The run of the default."""
    return next(
        x for x in found["runs"] if [x["integrator"], x["substeps"]] == found["default"]
    )  # fmt: skip


def cheaper(found: dict[str, Any]) -> str:
    """The cheapest run of at most the default's error, if it is not the default."""
    own = default_of(found)
    best = min((x for x in found["runs"] if x["error"] <= own["error"]), key=lambda x: x["seconds"])
    if best is own:
        return "none"
    ratio = best["seconds"] / own["seconds"]
    return f"{best['integrator']} x {best['substeps']}: {ratio:.2f}"


def chart(data: dict[str, Any]) -> Any:
    """A panel per scene, a line per method."""
    scenes = data["scenes"]
    figure, axes = pyplot().subplots(1, len(scenes), figsize=(max(7.6, 3.4 * len(scenes)), 3.9))
    for axis, (scene, found) in zip(np.atleast_1d(axes), scenes.items(), strict=True):
        for k, method in enumerate(METHODS):
            own = [x for x in found["runs"] if x["integrator"] == method]
            axis.loglog([1e9 * x["seconds"] for x in own], [x["error"] for x in own],
                        label=method, markersize=4, linewidth=1.0, **series(k))  # fmt: skip
        star = default_of(found)
        axis.loglog(1e9 * star["seconds"], star["error"], marker="*", color="black", markersize=13,
                    linestyle="none", label="default", zorder=5)  # fmt: skip
        axis.axhline(found["model"], color="grey", linewidth=0.8, linestyle="--")
        axis.set_title(scene, fontsize=10)
        axis.set_xlabel("CPU time of a control step [ns]")
        axis.tick_params(axis="x", which="minor", labelbottom=False)
        axis.grid(alpha=0.3, which="major")
    np.atleast_1d(axes)[0].set_ylabel("tip error, 95 % of episodes [reach]")
    handles, labels = np.atleast_1d(axes)[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=5, fontsize=8, frameon=False, loc="upper center")
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.88))
    return figure


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argument_parser("accuracy.episode_errors", __doc__, ".")
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--episodes", type=count, default=32, help="of each kind")
    options = parser.parse_args(arguments)
    scenes, paths = {}, {}
    for scene in options.scenes:
        scenes[scene] = runs(scene, options.episodes)
        print(scene, default_of(scenes[scene]), flush=True)
        paths[scene] = second_path(scene)
        print(scene, "apart", paths[scene]["apart"], flush=True)
    data = {
        **provenance("scipy"), "count": options.episodes, "scenes": scenes, "second path": paths,
    }  # fmt: skip
    save_results(data, page, options.out / "episode_errors.json", chart(data))


if __name__ == "__main__":
    main()
