"""Exact derivatives against differences: in fits, predictive control and bounds.

    python -m benchmarks.accuracy.sensitivities

Times every use once by derivatives and once by differences of the same compiled steps, in turn, and
compares what they give. Writes docs/results/sensitivities.json and sensitivities.md. Times are of
the processor (`time.process_time`), medians.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np

from agents.controllers.nmpc import nonlinear
from agents.leaderboard.motions import Episode, Motion, plant
from agents.metrics import make_batch
from agents.tuned import parameters_of
from benchmarks.accuracy.measured_data import (
    GAUGE,
    PRESET,
    RELEASE,
    clean_log,
    noisy,
    pluck_log,
    rig,
)
from benchmarks.output import argument_parser, provenance, save_results, table
from dynamics import compile_arm, load_arm
from dynamics.measured.fit import BOUNDS, Fit, LinkAngle, fit
from dynamics.measured.log_file import Log
from dynamics.measured.motion import LoggedMotion
from dynamics.measured.unknowns import without_friction
from dynamics.simulation.sampled_motion import SampledMotion
from dynamics.types import Array

SCENES = ("OneLink", "TwoLink", "SixLink")
TIMES = 7  # of every call
WIDTH = 1e-5  # [of an unknown's size] half width of the differences of a fit
NUDGE = 1e-3  # [-] change of an action for its effect
TWO_LINKS = "quanser-2dsfl"
RIG = {  # parameters of the rig of two links, and bounds about them
    "stiffness": (1.2, (0.7, 1.6)), "damping": (2.0, (0.0, 20.0)),
    "viscous_1": (1.4, (0.0, 6.0)), "viscous_2": (0.1, (0.0, 2.0)),
    "coulomb_1": (0.9, (0.2, 1.5)), "coulomb_2": (0.25, (0.05, 0.4)),
}  # fmt: skip
OTHERS = {"torque_1": (0.5, 1.2), "torque_2": (0.5, 1.2), "gain_link_angle_1": (0.4, 1.2),
          "gain_link_angle_2": (0.4, 1.2), "delay_link_angle_1": (0.0, 0.1),
          "delay_link_angle_2": (0.0, 0.1)}  # fmt: skip
LATE = 0.02  # [s] of the link angles
FITS = ("log", "unknowns", "Jacobian [ms]", "by differences", "fit [s]", "by differences",
        "parameters differ by")  # fmt: skip
CONTROL = ("environment", "decision [ms]", "linearization", "by derivatives", "entries differ by")
EFFECTS = ("environment", "actions", "by differences [ms]", "by derivatives [ms]", "differ by")


def in_turn(calls: dict[str, Callable[[], Any]], times: int = TIMES) -> dict[str, float]:
    """Median times [s] of calls, each after the others; they have run once before."""
    for call in calls.values():
        call()
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(times):
        for name, call in calls.items():
            start = time.process_time()
            call()
            found[name].append(time.process_time() - start)
    return {name: float(np.median(values)) for name, values in found.items()}


# ---- fits ----------------------------------------------------------------------------------------


def differences(motion: LoggedMotion, x: Array, samples: int | None = None) -> Array:
    """(k, N, c) central differences, in place of `LoggedMotion.slopes`."""
    half = WIDTH * motion.unknowns.size
    ahead, behind = (motion.signals(x + sign * np.diag(half), samples) for sign in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * half[:, None, None]))


def two_links() -> Log:
    """Log of a rig of two links: both joints under square waves, link angles that are late."""
    model = compile_arm(without_friction(load_arm(TWO_LINKS), RIG), free_parameters=tuple(RIG))
    t: Array = 0.005 * np.arange(400.0)
    torque = np.sign(np.sin(np.outer(t, [5.0, 7.0]))) * [8.0, 0.8]
    state = np.concatenate([np.zeros(2 * model.n), [value for value, _ in RIG.values()]])
    path = SampledMotion(model)(np.diff(t) / 20.0, 20, torque[:-1, :, None], state[:, None])[
        :, : model.n, 0
    ]
    q = np.vstack([np.zeros(model.n), path])
    angles = q @ np.array([LinkAngle(link=k).row(model) for k in range(2)]).T
    late = np.stack([np.interp(t - LATE, t, angle) for angle in angles.T], axis=1)
    rng = np.random.default_rng(0)
    return Log(
        t, torque, q @ model.encoders.T + 1e-4 * rng.standard_normal((t.size, 2)),
        late + 1e-4 * rng.standard_normal(late.shape),
    )  # fmt: skip


def fits() -> list[dict[str, Any]]:
    """Times of Jacobians and of whole fits, and the largest change of a parameter."""
    motor = noisy(clean_log(rig()), 0)
    late = replace(motor, gauge=np.vstack([motor.gauge[:1].repeat(4, axis=0), motor.gauge[:-4]]))
    sensors = {"gain_gauge_1": (0.5, 2.0), "delay_gauge_1": (0.0, 0.05)}
    rigid: dict[str, Any] = {"start": "measured", "shooting": 1.0}
    angles = [LinkAngle(link=k) for k in range(2)]
    every = {name: pair for name, (_, pair) in RIG.items()} | OTHERS
    pluck = noisy(pluck_log(rig()).since(RELEASE), 0)
    cases: dict[str, tuple[Any, ...]] = {
        "one link, motor": (PRESET, motor, [GAUGE], BOUNDS, {}),
        "one link, plucked": (PRESET, pluck, [GAUGE], BOUNDS, {"held": {0: None}}),
        "one link, late gauge": (PRESET, late, [GAUGE], BOUNDS | sensors, {}),
        "two links, shooting": (TWO_LINKS, two_links(), angles, every, rigid),
    }
    return [fitted(name, *given[:4], **given[4]) for name, given in cases.items()]


def fitted(
    name: str, arm: str, log: Log, sensors: Any, bounds: Any, **keywords: Any
) -> dict[str, Any]:
    """Times [s] of one case."""
    motion = LoggedMotion(arm, log, sensors, bounds, **keywords)
    motion.substeps = 8
    found: dict[str, Fit] = {}
    middle = np.where(motion.unknowns.asked, motion.unknowns.low, motion.unknowns.nominal)
    x = middle + 0.3 * np.where(motion.unknowns.asked, motion.unknowns.size, 0.0)

    def exact() -> None:
        found["exact"] = fit(arm, log, sensors, bounds, **keywords)

    def rough() -> None:
        with patch.object(LoggedMotion, "slopes", differences):
            found["rough"] = fit(arm, log, sensors, bounds, **keywords)

    jacobians = in_turn(
        {"exact": lambda: motion.slopes(x), "rough": lambda: differences(motion, x)}
    )
    whole = in_turn({"exact": exact, "rough": rough}, 3)
    half = np.ptp(found["exact"].intervals, axis=1) / 2.0
    return {
        "log": name,
        "unknowns": len(x),
        "jacobian": jacobians,
        "fit": whole,
        "apart": float(np.abs((found["rough"].values - found["exact"].values) / half).max()),
    }


# ---- predictive control --------------------------------------------------------------------------


def control(scene: str) -> dict[str, Any]:
    """Times [s] of a decision and of its linearization, by differences and by derivatives."""
    env_id = f"FlexArm/{scene}-Reach-v0"
    envs = make_batch(env_id, 1, {"obs": "state"})
    observation, _ = envs.reset(seed=[0])
    subject = nonlinear(envs, "nmpc", **parameters_of("nmpc", env_id, "state"))
    estimates, _ = subject.observer.observe(observation, None, np.ones(1, dtype=bool))
    law = subject.law
    scene_of = law._scene(estimates)
    moved = law._closed_loop(scene_of)
    found = in_turn({
        "decision": lambda: law(estimates),
        "differences": lambda: law._linearized(scene_of, moved, 0),
        "derivatives": lambda: linearized(law, scene_of, moved),
    }, 51)  # fmt: skip
    pairs = zip(law._linearized(scene_of, moved, 0), linearized(law, scene_of, moved), strict=True)
    envs.close()
    return {
        "scene": env_id,
        "seconds": found,
        "apart": max(float(np.abs(x - y).max() / np.abs(y).max()) for x, y in pairs),
    }


def linearized(law: Any, scene: Any, moved: Any) -> tuple[Array, Array]:
    """A (T, 2r, 2r) and B (T, m, 2r) of the first motion, as `Nonlinear._linearized` has them."""
    shapes, modes, m = scene.shapes[0], scene.modes[0], law.limit.size
    (r, n), none = shapes.shape, np.zeros_like(shapes)
    along = np.vstack([np.block([[shapes, none], [none, shapes]]), np.zeros((m, 2 * n))])
    by = np.vstack([np.zeros((2 * r, m)), np.diag(law.limit)])
    here = np.concatenate([moved.q[:, 0], moved.v[:, 0]], axis=2)
    state = (here + 1j * along).reshape(-1, 2 * n).T
    torque = (law.limit * moved.action[:, 0] + 1j * by).reshape(-1, m).T
    plants = np.full(state.shape[1], scene.plants[0])
    path = law.coarse.motions(plants, state, torque[None])[0].imag.T.reshape(law.steps, -1, 2 * n)
    x = np.concatenate([path[..., :n] @ modes, path[..., n:] @ modes], axis=2)
    return x[:, : 2 * r], x[:, 2 * r :]


# ---- bounds --------------------------------------------------------------------------------------


def effects(scene: str) -> dict[str, Any]:
    """Times [s] of the effects of all actions of an episode, and the largest difference."""
    env_id = f"FlexArm/{scene}-Reach-v0"
    episode = Episode(env_id, plant(env_id, "state"), 10_000, {})
    shape = episode.steps, episode.batch(1)[0].action_space.shape[1]
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, shape)
    motion = episode.follow(actions[None])[0]
    times = in_turn({
        "differences": lambda: nudged(episode, motion),
        "derivatives": lambda: episode.effects(motion),
    }, 3)  # fmt: skip
    rough, exact = nudged(episode, motion), episode.effects(motion)[0]
    return {
        "scene": env_id,
        "actions": int(actions.size),
        "seconds": times,
        "apart": float(np.abs(rough - exact).max() / np.abs(exact).max()),
    }


def nudged(episode: Episode, motion: Motion) -> Array:
    """(T, k, T m) slopes of the errors, from a batch whose environments differ in one action."""
    count = motion.actions.size
    actions = np.tile(motion.actions.ravel(), (count + 1, 1))
    sign = np.where(actions[0] > 0.0, -NUDGE, NUDGE)
    actions[np.arange(count), np.arange(count)] += sign
    *found, here = episode.follow(actions.reshape(-1, *motion.actions.shape))
    return np.stack(
        [(x.errors - here.errors) / s for x, s in zip(found, sign, strict=True)], axis=-1
    )


# ---- the page ------------------------------------------------------------------------------------


def page(results: dict[str, Any]) -> str:
    """Markdown page of the results."""
    machine = results["provenance"]["machine"]
    fitted = [
        [
            x["log"], str(x["unknowns"]),
            *(f"{1e3 * x['jacobian'][k]:.1f}" for k in ("exact", "rough")),
            *(f"{x['fit'][k]:.2f}" for k in ("exact", "rough")),
            f"{x['apart']:.0e} half intervals",
        ]
        for x in results["fits"]
    ]  # fmt: skip
    decided = [
        [
            x["scene"], f"{1e3 * x['seconds']['decision']:.1f}",
            *(
                f"{x['seconds'][k] / x['seconds']['decision']:.0%}"
                for k in ("differences", "derivatives")
            ),
            f"{x['apart']:.0e}",
        ]
        for x in results["control"]
    ]  # fmt: skip
    bounded = [
        [
            x["scene"], str(x["actions"]),
            *(f"{1e3 * x['seconds'][k]:.0f}" for k in ("differences", "derivatives")),
            f"{x['apart']:.0e}",
        ]
        for x in results["effects"]
    ]  # fmt: skip
    return f"""# Exact derivatives against differences

Made by `{results["provenance"]["command"]}` on {machine["processor"]}, {machine["cores"]} cores.
Median times of the processor.

**Fits.** One Jacobian of all samples, and the whole fit. Both step a log in one compiled call.

{table(FITS, fitted, "lr")}

**Predictive control** (`nmpc`). Shares of a decision that the linearization of its horizon takes.

{table(CONTROL, decided, "lr")}

**Bounds.** Effects of every action of an episode on every later tip error.

{table(EFFECTS, bounded, "lr")}
"""


def main() -> None:
    """Command line."""
    parser = argument_parser("accuracy.sensitivities", __doc__, "sensitivities.json")
    a = parser.parse_args()
    results = {
        "fits": fits(),
        "control": [control(scene) for scene in SCENES],
        "effects": [effects(scene) for scene in SCENES],
        "provenance": provenance("numpy", "scipy", "numba"),
    }
    save_results(results, page, a.out)


if __name__ == "__main__":
    main()
