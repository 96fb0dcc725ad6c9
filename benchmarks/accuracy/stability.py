"""Stability maps of methods and models: predicted and observed boundaries.

    python -m benchmarks.accuracy.stability [--quick | --charts] [--out FILE] [--images FOLDER]

Every map is a grid of environments stepped in one batch; failed cells are kept in the results.
`--quick` uses a coarser grid. `--charts` only draws the stored results.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.linalg import expm

from agents.files import pack, unpacked
from benchmarks import style
from benchmarks.output import RESULTS, argument_parser, provenance, save_figure
from dynamics import Arm, Joint, Link, Mode, Model, Payload, Stepper, compile_arm
from dynamics.formulations.linearized import linear_arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.simulation.step_limits import GROWS, amplification
from dynamics.types import Array

GROWTH = 10.0  # [-] an amplitude that grows by more than this factor is unstable
EVERY = 4  # points of a line from one marker to the next
plt = style.pyplot()
NOMINAL = 0.01  # [-] damping ratio of the arm whose modes the exponential step freezes
HEAVY = 1e6  # [kg m^2] a rotor that no link can move: the joint keeps its rate


def beam(
    count: int = 1, *, kind: str = "clamped-free", rotor: float = HEAVY, **changes: Any
) -> Arm:
    """One planar link of unit length, mass per length and stiffness."""
    modes = tuple(Mode(kind=kind, index=k + 1, direction="y") for k in range(count))
    link = Link(
        **{"length": 1.0, "rho_A": 1.0, "EIz": 1.0, "modes": modes, **changes},
        joint=Joint(rotor_inertia=rotor),
    )
    return Arm(links=(link,), name="unit beam")


def method_map(integrator: str, cells: int) -> dict[str, Any]:
    """Stability over step times frequency and damping ratio, for one mode of a clamped beam.

    Stiffness and damping are free parameters. The exponential step freezes the nominal mode, so it
    is exact only where step times frequency is one and the damping ratio is NOMINAL.
    """
    model = compile_arm(beam(damping_ratio=NOMINAL), free_parameters=("stiffness", "damping"))
    omega = float(model.frequencies()[0])
    steps = np.linspace(0.2, 4.0, cells)  # omega h
    ratios = np.linspace(0.0, 1.5, cells)
    grid_step, grid_ratio = np.meshgrid(steps, ratios)
    h = 1.0 / omega
    # stiffness s makes the frequency omega sqrt(s); damping is a factor on 2 NOMINAL omega m
    stiffness = grid_step**2
    damping = grid_ratio * grid_step / NOMINAL
    stepper = Stepper(model, stiffness.size, dt=h, substeps=400, integrator=integrator)
    stepper.parameters[:, 0], stepper.parameters[:, 1] = stiffness.ravel(), damping.ravel()
    stepper.q[:, 1] = 1e-6
    failed = grows(stepper, calls=5).reshape(grid_step.shape)
    arm = linear_arm(model.chain, np.zeros(model.n))
    radius = [
        amplification(replace(arm, K=s * arm.K, C=d * arm.C), integrator, h)
        for s, d in zip(stiffness.ravel(), damping.ravel(), strict=True)
    ]
    predicted = np.reshape(radius, grid_step.shape) > 1.0 + GROWS
    return {
        "x": steps.tolist(), "y": ratios.tolist(), "failed": failed.tolist(),
        "predicted": predicted.tolist(), "x_label": "step x frequency [-]",
        "y_label": "damping ratio [-]", "title": f"{integrator}: step against damping",
    }  # fmt: skip


def spin_map(foreshortening: bool, cells: int) -> dict[str, Any]:
    """Stability over spin rate and stiffness: the linear model fails from Omega = omega_1 on."""
    arm = beam()
    arm = Arm(links=arm.links, foreshortening=foreshortening)
    model = compile_arm(arm, free_parameters=("stiffness",))
    omega = float(model.frequencies()[0])
    spins = np.linspace(0.0, 2.0 * omega, cells)
    scales = np.linspace(0.1, 2.0, cells)
    grid_spin, grid_scale = np.meshgrid(spins, scales)
    stepper = Stepper(model, grid_spin.size, dt=0.1 / omega, substeps=500)
    stepper.parameters[:, 0] = grid_scale.ravel()
    stepper.q[:, 1], stepper.v[:, 0] = 1e-6, grid_spin.ravel()
    failed = grows(stepper, calls=4, limit=100.0 * GROWTH).reshape(grid_spin.shape)
    predicted = (grid_spin > omega * np.sqrt(grid_scale)) & (not foreshortening)
    name = "foreshortened" if foreshortening else "linear"
    return {
        "x": (spins / omega).tolist(), "y": scales.tolist(), "failed": failed.tolist(),
        "predicted": predicted.tolist(), "x_label": "spin rate over first frequency [-]",
        "y_label": "stiffness over nominal [-]", "title": f"{name} link: spin against stiffness",
    }  # fmt: skip


def grows(stepper: Stepper, calls: int, limit: float = GROWTH) -> NDArray[np.bool_]:
    """(n_env,) whether the first modal amplitude exceeds `limit` times its start, or diverges."""
    start = np.abs(stepper.q[:, 1])
    failed = np.zeros(stepper.n_env, dtype=bool)
    for _ in range(calls):
        stepper.advance()
        failed |= (stepper.status != 0) | (np.abs(stepper.q[:, 1]) > limit * start)
    return failed


def shape_map() -> dict[str, Any]:
    """Error of the first joint-free frequency over hub inertia, by kind and number of shapes."""
    hubs = np.logspace(-4, 1, 26)  # rotor inertia over the beam's inertia about its joint
    kinds = ("clamped-free", "pinned-free", "poly")
    counts = range(1, 5)
    errors = {}
    for kind in kinds:
        for count in counts:
            row = []
            for hub in hubs:
                exact = first_free(beam(6, kind="poly", rotor=hub / 3.0))
                row.append(first_free(beam(count, kind=kind, rotor=hub / 3.0)) / exact - 1.0)
            errors[f"{kind}, {count}"] = row
    return {"hub": hubs.tolist(), "error": errors, "title": "first joint-free frequency"}


def first_free(arm: Arm) -> float:
    """First natural frequency with the joint free [rad/s]."""
    return float(Model(arm).frequencies(joints="free")[0])


TORQUES: dict[str, Callable[[Array], Array]] = {  # of time over duration; all have mean one
    "step": lambda x: np.where(x < 1.0, 1.0, 0.0),
    "ramp": lambda x: np.where(x < 1.0, 2.0 * x, 0.0),
    "cycloid": lambda x: np.where(x < 1.0, 1.0 - np.cos(2.0 * np.pi * x), 0.0),
}


def torque_map(cells: int) -> dict[str, Any]:
    """Tip error over step for every method and torque signal, to show if the signal matters."""
    model = compile_arm(beam(3, rotor=0.05))
    fastest = float(model.frequencies(joints="free").max())
    duration = 4.0 * np.pi / float(model.frequencies(joints="free")[0])
    steps = np.logspace(-1.5, 0.7, cells)  # omega_max h
    curves = {}
    for name, signal in TORQUES.items():
        exact = driven(model, signal, duration, 0.02 / fastest, "rk4")
        for method in INTEGRATORS:
            errors = [
                float(np.linalg.norm(driven(model, signal, duration, h / fastest, method) - exact))
                for h in steps
            ]
            curves[f"{method}, {name}"] = errors
    return {"step": steps.tolist(), "error": curves, "title": "torque type against method"}


def driven(
    model: Model, signal: Callable[[Array], Array], duration: float, dt: float, integrator: str
) -> Array:
    """Tip at twice the torque's duration (3,) [m]; NaN if the motion diverged."""
    count = 2 * int(np.ceil(duration / dt))  # even: a step ends where the torque does
    stepper = Stepper(model, 1, dt=2.0 * duration / count, substeps=1, integrator=integrator)
    middles = np.linspace(0.0, 2.0, count, endpoint=False) + 1.0 / count
    for torque in 0.02 * signal(middles):
        stepper.torque[0] = torque
        stepper.advance()
        if stepper.status[0] or stepper.measured[0, model.measurements["deflection"]][0] > 1.0:
            return np.full(3, np.nan)
    return stepper.measured[0, model.measurements["tip"]].copy()


def loop_map(payload: float, cells: int) -> dict[str, Any]:
    """Stability of joint PD with delayed measurements on SLIM, over delay and gain."""
    period = 1e-3  # [s] of control
    model = compile_arm("slim", free_parameters=("payload_mass",))
    loaded = Arm(links=model.arm.links, payload=Payload(mass=payload) if payload else None)
    delays = np.unique(np.linspace(0, 40, cells).astype(int))  # control periods
    bandwidths = np.logspace(-0.3, 1.7, cells)  # [rad/s] of the PD on the rigid arm
    zero = np.zeros(model.n)
    inertia = float(model.mass_matrix(zero)[0, 0])
    A, B = compile_arm(loaded).linearize(zero, zero, np.zeros(1))
    step = expm(np.block([[A, B], [np.zeros((1, 2 * model.n + 1))]]) * period)
    grid_delay, grid_gain = np.meshgrid(delays, bandwidths)
    kp, kd = inertia * grid_gain.ravel() ** 2, 1.4 * inertia * grid_gain.ravel()
    stepper = Stepper(model, grid_delay.size, dt=period, substeps=1)
    stepper.parameters[:, 0] = payload
    stepper.q[:, 0] = 1e-3
    history = np.zeros((int(delays.max()) + 1, grid_delay.size, 2))
    history[:, :, 0] = 1e-3
    rows, lag = np.arange(grid_delay.size), grid_delay.ravel().astype(int)
    failed = np.zeros(grid_delay.size, dtype=bool)
    for k in range(int(20.0 / period)):
        history[k % len(history)] = np.stack([stepper.q[:, 0], stepper.v[:, 0]], axis=1)
        measured = history[(k - lag) % len(history), rows]
        stepper.torque[:, 0] = -kp * measured[:, 0] - kd * measured[:, 1]
        stepper.advance()
        failed |= (stepper.status != 0) | (np.abs(stepper.q[:, 0]) > 1e-3 * GROWTH)
        stepper.q[failed], stepper.v[failed] = 0.0, 0.0
    predicted = [delayed_radius(step, p, d, n) > 1.0 for p, d, n in zip(kp, kd, lag, strict=True)]
    return {
        "x": (delays * period * 1e3).tolist(), "y": bandwidths.tolist(),
        "failed": failed.reshape(grid_delay.shape).tolist(),
        "predicted": np.reshape(predicted, grid_delay.shape).tolist(),
        "x_label": "delay [ms]", "y_label": "bandwidth of the joint PD [rad/s]",
        "title": f"SLIM, payload {payload:g} kg: delay against gain",
    }  # fmt: skip


def delayed_radius(step: Array, kp: float, kd: float, delay: int) -> float:
    """Spectral radius of the sampled linear loop, with delayed torques as extra states.

    `step` (n + 1, n + 1) maps state and torque to those one period later.
    """
    n = step.shape[0] - 1
    A, b = step[:n, :n], step[:n, n:]
    feedback = np.zeros((1, n))
    feedback[0, 0], feedback[0, n // 2] = -kp, -kd
    full = np.zeros((n + delay, n + delay))
    full[:n, :n] = A
    if delay == 0:
        full[:n, :n] += b @ feedback
    else:
        full[:n, n + delay - 1 :] = b
        full[n, :n] = feedback
        full[n + 1 :, n : n + delay - 1] = np.eye(delay - 1)
    return float(np.abs(np.linalg.eigvals(full)).max())


# ---- pictures ------------------------------------------------------------------------------------


def draw_maps(maps: list[dict[str, Any]], path: Path) -> None:
    """Draw the failed cells of every map, and the predicted boundary as a line."""
    columns = min(4, len(maps))
    rows = -(-len(maps) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4.6 * columns, 4.0 * rows), squeeze=False, layout="constrained"
    )
    for axis in axes.ravel()[len(maps) :]:
        axis.set_axis_off()
    for axis, data in zip(axes.ravel(), maps, strict=False):
        x, y = np.array(data["x"]), np.array(data["y"])
        failed, predicted = np.array(data["failed"]), np.array(data["predicted"])
        axis.pcolormesh(
            x, y, failed, cmap=ListedColormap([style.STABLE, style.FAILED]), vmin=0, vmax=1,
            shading="nearest", rasterized=True,
        )  # fmt: skip
        if predicted.any() and not predicted.all():
            axis.contour(x, y, predicted.astype(float), levels=[0.5], colors="k", linewidths=2.0)
        agree = float(np.mean(failed == predicted))
        axis.set_title(f"{data['title']}\n{agree:.1%} of cells as predicted", fontsize=12)
        axis.set(xlabel=data["x_label"], ylabel=data["y_label"])
        if "bandwidth" in data["y_label"]:
            axis.set_yscale("log")
    keys = [
        Patch(facecolor=style.STABLE, edgecolor="k", label="stable"),
        Patch(facecolor=style.FAILED, edgecolor="k", label="failed"),
        Line2D([], [], color="k", linewidth=2.0, label="predicted boundary"),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=3, fontsize=12)
    save_figure(figure, path)


def draw_lines(
    data: dict[str, Any], x: str, labels: tuple[str, str], kinds: tuple[str, str], path: Path
) -> None:
    """Draw a panel per second kind of the rows, named "KIND, KIND", with a line per first kind."""
    groups, panels = (sorted({name.split(", ")[k] for name in data["error"]}) for k in (0, 1))
    looks = {
        group: style.method(group) if group in INTEGRATORS else style.series(k)
        for k, group in enumerate(groups)
    }
    figure, axes = plt.subplots(
        1, len(panels), figsize=(4.2 * len(panels), 4.8), sharey=True, layout="constrained"
    )
    for axis, panel in zip(axes, panels, strict=True):
        for k, (group, look) in enumerate(looks.items()):
            errors = np.abs(np.array(data["error"][f"{group}, {panel}"], float))
            axis.loglog(
                data[x], errors, **look, label=group, linewidth=2.0, markersize=8,
                markevery=(k % EVERY, EVERY),
            )  # fmt: skip
        axis.set_title(f"{kinds[1]}: {panel}", fontsize=13)
        axis.set_xlabel(labels[0], fontsize=12)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(labels[1], fontsize=12)
    names = axes[0].get_legend_handles_labels()
    figure.legend(*names, title=kinds[0], loc="outside lower center", ncols=min(6, len(names[1])))
    save_figure(figure, path)


def draw(results: dict[str, Any], folder: Path) -> None:
    """Draw all maps and lines."""
    for name, group in results["maps"].items():
        draw_maps(group, folder / f"stability_{name}")
    draw_lines(
        results["shapes"], "hub", ("rotor inertia over the beam's", "error of the frequency [-]"),
        ("shapes", "modes"), folder / "stability_shapes",
    )  # fmt: skip
    draw_lines(
        results["torques"], "step", ("step x highest frequency [-]", "tip error [m]"),
        ("method", "torque"), folder / "stability_torques",
    )  # fmt: skip


def measure(cells: int) -> dict[str, Any]:
    """Results with maps of `cells` times `cells` environments."""
    results = provenance("numpy", "scipy", "numba", "casadi")
    maps = {
        "methods": [method_map(name, cells) for name in INTEGRATORS],
        "spin": [spin_map(foreshortening, cells) for foreshortening in (False, True)],
        "loop": [loop_map(payload, cells // 2) for payload in (0.0, 0.1, 0.3)],
    }
    for group in maps.values():
        for data in group:
            failed, predicted = np.array(data["failed"]), np.array(data["predicted"])
            print(
                f"{data['title']:44} fails in {failed.mean():6.1%} of the cells, "
                f"{np.mean(failed == predicted):6.1%} as predicted"
            )
    return results | {"maps": maps, "shapes": shape_map(), "torques": torque_map(cells // 3)}


def main() -> None:
    """Compute all maps, print their agreement with prediction, write JSON and pictures."""
    parser = argument_parser("accuracy.stability", __doc__, "stability.json.bz2")
    parser.add_argument("--quick", action="store_true", help="a coarser grid")
    parser.add_argument("--charts", action="store_true", help="only draw the stored results")
    parser.add_argument("--images", type=Path, default=RESULTS)
    options = parser.parse_args()
    if not options.charts:
        results = measure(16 if options.quick else 48)
        text = json.dumps(results, separators=(",", ":")).replace("NaN", "null")
        pack(text, options.out)
    draw(json.loads(unpacked(options.out)), options.images)


if __name__ == "__main__":
    main()
