"""Joint PD control after Yuan, Book and Huggins: the step of SLIM, and the theorem's function V.

V = 1/2 (v'Mv + x'Kx + e'K_P e), with e the joint errors, falls at the rate v'K_D v of the joints if
there is neither gravity nor delay (printed appendix B, with K_D for the misprinted K_P). The
dissipated work is integrated with the motion, and V is computed from M and K afterwards, so the two
balance only if the dynamics is right.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.arms import undamped
from benchmarks.validation.entries import Number, Table
from benchmarks.validation.slim import BEAM, HALF, SLIM, locked, on_hub
from dynamics import ARMS, Arm, Mode, Model, compile_arm
from dynamics.types import Array

CHAPTER = "Yuan, Book and Huggins 1993: joint PD control"
NOTES = {
    CHAPTER: "The paper proves V̇ = -q̇ᵀK_D q̇ without gravity and delay, and plots steps of SLIM "
    "without gains; ours are chosen, and *theirs* is what the theorem says."
}
SECONDS = 1.4  # printed length of the plots


@dataclass(frozen=True, kw_only=True)
class Step:
    """A step of the joints' target, from rest, under tau = -K_P (q - target) - K_D v."""

    title: str
    arm: Arm
    target: tuple[float, ...]  # (n_joint,) [rad]
    K_P: tuple[float, ...]  # (n_joint,) [N m/rad] chosen: the paper prints none
    K_D: tuple[float, ...]  # (n_joint,) [N m s/rad] chosen


STEPS = {
    step.arm.name: step
    for step in (
        Step(
            title="SLIM", arm=undamped(SLIM), target=(0.2,),
            K_P=(12.0,), K_D=(2.0,),
        ),
        Step(
            title="De Luca and Siciliano's two links", arm=undamped(ARMS["deluca-siciliano"]),
            target=(0.5, -0.8), K_P=(4.0, 1.5), K_D=(1.5, 0.5),
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Response:
    """Response to a step, one row per time."""

    t: Array  # (N,) [s]
    q: Array  # (N, n)
    v: Array  # (N, n)
    spent: Array  # (N,) [J] energy dissipated by K_D since the start
    V: Array  # (N,) [J] the theorem's function


@cache
def respond(step: Step, seconds: float = SECONDS) -> Response:
    """Response to a step, by DOP853 at 1e-11."""
    model = compile_arm(step.arm)
    n, joints = model.n, list(step.arm.joint_index)
    target, K_P, K_D = (np.array(x) for x in (step.target, step.K_P, step.K_D))
    program, out = model.program(1, "rk4"), np.empty((1, n))  # as Model.accelerations, in a loop
    w, parameters = model.workspace(program), model.nominal_parameters[None]

    def rates(_: float, x: Array) -> Array:
        q, v = x[:n], x[n : 2 * n]
        tau = -K_P * (q[joints] - target) - K_D * v[joints]
        program.evaluate_states(q[None], v[None], tau[None], parameters, w, out)
        return np.concatenate([v, out[0], [K_D @ v[joints] ** 2]])

    times = np.linspace(0.0, seconds, round(seconds * 500) + 1)
    found = solve_ivp(
        rates, (0.0, seconds), np.zeros(2 * n + 1), "DOP853", times, rtol=1e-11, atol=1e-13
    ).y.T
    q, v = found[:, :n], found[:, n : 2 * n]
    errors = q[:, joints] - target
    spring = 0.5 * (K_P * errors**2).sum(axis=1)
    energy = [sum(model.energy(*state)) for state in zip(q, v, strict=True)]
    return Response(times, q, v, found[:, -1], np.array(energy) + spring)


def strains(model: Model, q: Array) -> Array:
    """(N, 2) [-] of SLIM's gauges at the root and at mid-length."""
    places = (0.0, 0.5 * BEAM.length)
    return np.array([[HALF * float(model.strain(x, 0, at)[2]) for at in places] for x in q])


def balance(step: Step) -> tuple[float, float]:
    """Largest error of V + spent = V(0), and largest rise of V between samples, over V(0)."""
    response = respond(step)
    fault = float(np.abs(response.V + response.spent - response.V[0]).max())
    rise = float(max(0.0, np.diff(response.V).max()))
    return fault / response.V[0], rise / response.V[0]


def stiffened(gains: Sequence[float]) -> Array:
    """(N, 2) [Hz] lowest two frequencies of SLIM, of clamped shapes, its joint on a spring K_P."""
    import scipy.linalg

    modes = tuple(Mode(kind="clamped-tip-mass", index=k, direction="y") for k in (1, 2))
    link = replace(BEAM, modes=modes)
    model = compile_arm(replace(SLIM, links=(link,)))
    M, K = model.mass_matrix(np.zeros(model.n)), model.stiffness
    first = np.diag([1.0, *[0.0] * (model.n - 1)])
    squares = [scipy.linalg.eigvalsh(K + gain * first, M)[:2] for gain in gains]
    return np.sqrt(np.abs(squares)) / (2.0 * pi)


def tables() -> list[Table]:
    """The theorem, and the two limits of the gain."""
    rows: list[Number] = []
    for step in STEPS.values():
        rows += [
            Number(
                quantity=f"{step.title}: fault of V(t) + work of K_D = V(0), over V(0)",
                printed="0", within=1e-8, remark="K_D, misprinted diag[K_P]",
            ),
            Number(
                quantity=f"{step.title}: largest rise of V in 2 ms, over V(0)", printed="0",
                within=1e-10,
            ),
        ]  # fmt: skip
    free = on_hub(BEAM.joint.rotor_inertia, 2)[0]
    return [
        Table(
            chapter=CHAPTER, title="V falls at the rate of the joints' damping, undamped links",
            demand="to the accuracy of the integration", rows=tuple(rows),
            ours=lambda: [x for step in STEPS.values() for x in balance(step)],
        ),
        Table(
            chapter=CHAPTER, title="The gain turns a free joint into a held one",
            demand="within 0.1 % at gains of 1e-6 and 1e6 N m/rad",
            rows=(
                Number(
                    quantity="mode 1, high gain", printed="2.096", unit="Hz", within=2.1e-3,
                    remark="joint held",
                ),
                Number(
                    quantity="mode 2, low gain", printed=f"{free:.3f}", unit="Hz", within=7.4e-3,
                    remark="joint free, hub of 0.01 kg m²",
                ),
            ),
            ours=lambda: [stiffened((1e6,))[0, 0], stiffened((1e-6,))[0, 1]],
        ),
    ]  # fmt: skip


def draw(folder: Path) -> None:
    """Draw the step of SLIM, V of both arms, and frequencies from a free to a locked joint."""
    from benchmarks import style
    from benchmarks.output import save_figure

    plt = style.pyplot()
    step = STEPS["slim"]
    response = respond(step)
    figure, axes = plt.subplots(2, 1, figsize=(7.5, 5.6), sharex=True, layout="constrained")
    axes[0].plot(response.t, response.q[:, 0])
    axes[0].axhline(step.target[0], color="0.5", linestyle="--", linewidth=1)
    axes[0].set_ylabel("joint angle [rad]")
    axes[0].set_title(
        f"SLIM, step of {step.target[0]} rad under joint PD, "
        f"K_P {step.K_P[0]:g} N m/rad, K_D {step.K_D[0]:g} N m s/rad"
    )
    gauges = 1e6 * strains(compile_arm(step.arm), response.q)
    for column, name in enumerate(("at the base", "at mid-length")):
        axes[1].plot(response.t, gauges[:, column], label=name)
    axes[1].set_ylabel("strain [10⁻⁶]")
    axes[1].set_xlabel("time [s]")
    axes[1].legend(loc="upper right")
    for axis in axes:
        axis.grid(alpha=0.3)
    save_figure(figure, folder / "validation_slim_step")

    figure, grid = plt.subplots(1, 2, figsize=(10.5, 4.0), layout="constrained")
    for axis, step in zip(grid, STEPS.values(), strict=True):
        response = respond(step)
        axis.plot(response.t, response.V, label="V, from M, K and K_P")
        left = response.V[0] - response.spent
        axis.plot(response.t, left, "k--", linewidth=1, label="V(0) less the work of K_D")
        axis.set(title=step.title, xlabel="time [s]", ylabel="V [J]", ylim=(0.0, None))
        axis.grid(alpha=0.3)
    grid[0].legend()
    save_figure(figure, folder / "validation_lyapunov")

    gains = np.geomspace(1e-2, 1e4, 121)
    figure, axis = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
    axis.loglog(gains, stiffened(gains.tolist()))
    limits: list[tuple[str, Any]] = [("locked", locked()[:2]), ("free", on_hub(0.01, 2)[:1])]
    for label, values in limits:
        for value in values:
            axis.axhline(value, color="0.5", linestyle="--", linewidth=1)
            axis.text(gains[0], 1.03 * value, f"{label}: {value:.3f} Hz", fontsize=9)
    axis.set(xlabel="joint gain K_P [N m/rad]", ylabel="frequency [Hz]", ylim=(0.1, 30.0))
    axis.set_title("SLIM between a free and a locked joint (hub 0.01 kg m²)")
    axis.grid(alpha=0.3, which="both")
    save_figure(figure, folder / "validation_held_free")
